"""Frozen dataclasses from YAML and the command line, what a run records of itself, and the folder it goes into.

A config stands beside the class it builds. A kind (head, goal sampler, environment) is a `draccus.ChoiceRegistry`
picked by `type:`. What a file leaves out keeps the default that the enclosing config gives it, in nested blocks too;
`--a.b value` comes last. Every mistake is a UsageError that names the field and the nearest right name.
"""

from playlearn.config.digests import Digests, digest, file_digest, json_digest
from playlearn.config.disk import disk_errors, disk_problem
from playlearn.config.held import built_beside, held
from playlearn.config.load import copy_config, from_dict, load_config, read_config, save_config, to_dict
from playlearn.config.paths import spelled_from
from playlearn.config.record import (
    append_line,
    atomic_write,
    atomic_write_all,
    git_revision,
    make_folder,
    sync_folder,
    versions,
)
from playlearn.config.run_folder import RunFolder
from playlearn.config.schema import nearest

__all__ = [
    "Digests",
    "RunFolder",
    "append_line",
    "atomic_write",
    "atomic_write_all",
    "built_beside",
    "copy_config",
    "digest",
    "disk_errors",
    "disk_problem",
    "file_digest",
    "from_dict",
    "git_revision",
    "held",
    "json_digest",
    "load_config",
    "make_folder",
    "nearest",
    "read_config",
    "save_config",
    "spelled_from",
    "sync_folder",
    "to_dict",
    "versions",
]
