"""Frozen dataclasses from YAML and the command line, what a run records of itself, and the folder it goes into.

A config stands beside the class it builds. A kind (head, goal sampler, environment) is a `draccus.ChoiceRegistry`
picked by `type:`. What a file leaves out keeps the default that the enclosing config gives it, in nested blocks too;
`--a.b value` comes last. Every mistake is a UsageError that names the field and the nearest right name.
"""

from playlearn.config.load import from_dict, load_config, save_config, to_dict
from playlearn.config.record import atomic_write, git_revision, sync_folder, versions
from playlearn.config.run_folder import RunFolder
from playlearn.config.schema import nearest

__all__ = [
    "RunFolder",
    "atomic_write",
    "from_dict",
    "git_revision",
    "load_config",
    "nearest",
    "save_config",
    "sync_folder",
    "to_dict",
    "versions",
]
