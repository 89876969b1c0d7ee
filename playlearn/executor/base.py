"""What every executor is given, gives back and promises."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, Self

import draccus

from playlearn.errors import PlaylearnError


class LostError(PlaylearnError):
    """A job whose worker died or hung every time it was tried. why: how it ended, in words."""

    def __init__(self, job: "Job", tries: int, why: str) -> None:
        super().__init__(
            f"job {job.key} (seed {job.seed}) was lost {tries} times: its worker process {why}. "
            "Is memory short (see dmesg)? Run only it with --workers 1, or with --workers 0 to see it fail here."
        )
        self.why = f"its worker process {why} (tries: {tries})"


@dataclass(frozen=True)
class Job:
    """`function(**kwargs)`, to be called in some process.

    key: names the job in results and messages. function: importable by name (module level).
    seed: the seed the job is keyed by, for the message when it cannot be done.
    """

    key: Any
    function: Callable[..., Any]
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None

    def __post_init__(self) -> None:
        if "<" in getattr(self.function, "__qualname__", "<"):
            raise ValueError(f"{self.function} cannot be imported by name: a job's function stands at module level")


@dataclass(frozen=True)
class Result:
    """What a job gave. error: why it could not be done (then value is None). tries: 1 unless a worker was lost."""

    key: Any
    value: Any
    seconds: float
    tries: int = 1
    error: Exception | None = None


class Executor(Protocol):
    """Runs jobs somewhere, `workers` at a time. In a `with` block its workers live on from one `run` to the next."""

    @property
    def workers(self) -> int: ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...

    def run(self, jobs: Iterable[Job], *, keep_going: bool = False) -> Iterator[Result]:
        """Yield results as they are finished, each job exactly once.

        A job whose worker died or hung runs again with the same arguments. With `keep_going`, what
        could not be done is yielded as a Result with `error` instead of being raised.

        Raises:
            LostError: a job was lost more often than it is tried again; names its key and seed.
            Exception: what a job's function raised, with the worker's traceback as a note.
        """
        ...


@dataclass(frozen=True)
class ExecutorConfig(draccus.ChoiceRegistry):
    """The base of every executor's config; `type:` in a YAML picks the kind."""

    def build(self) -> Executor:
        raise NotImplementedError
