"""The errors a user can meet; each message says what is wrong and what to do next."""


class PlaylearnError(Exception):
    """Something a user can mend: shown as one message, never as a traceback (exit code 1)."""


class UsageError(PlaylearnError):
    """A wrong command line or config, or what it names is not there; found before any work starts (exit code 2)."""


class EpisodeError(PlaylearnError):
    """An episode that breaks its own contract: lengths, finiteness, time, types."""


class StoreError(PlaylearnError):
    """A store that is missing, broken, or without what was asked of it."""


class DiskError(PlaylearnError):
    """The disk of a folder is full or cannot be written; what was there is as it was."""


class BusyError(PlaylearnError):
    """A folder that another process is writing."""


class MissingStoreError(StoreError, UsageError):
    """No store, dataset or file of recordings is where one was named (exit code 2)."""


class CheckpointError(PlaylearnError):
    """A run that is missing, broken, or made for another environment or action space."""


class MissingRunError(CheckpointError, UsageError):
    """No run or policy is where one was named (exit code 2)."""


class ActionError(PlaylearnError):
    """An action that is not finite, of the wrong shape, or outside [-1, 1]."""


class SimulationDiverged(PlaylearnError):
    """The simulator left physics (NaN, warning counters, time going back); the episode ends here."""


class RenderError(PlaylearnError):
    """Images were asked for where no headless GL can be had."""


class TrainingDiverged(PlaylearnError):
    """A loss, a gradient or a weight is no longer finite; what was saved before stays as it is."""


class NotLearnedError(PlaylearnError):
    """A training went through and left a policy that is no better than it began."""
