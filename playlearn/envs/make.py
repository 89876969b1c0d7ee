"""From the name of an environment, or its config, to the environment itself."""

from collections.abc import Mapping
from typing import Any

from playlearn.config import from_dict, nearest, to_dict
from playlearn.errors import UsageError
from playlearn.sim.environment import Environment, EnvironmentConfig


def make_env(name_or_config: str | Mapping[str, Any] | EnvironmentConfig, **options: Any) -> Environment:
    """Build an environment: `make_env("lift", robot="UR5e")`.

    name_or_config: a registered `type` ("playtable", "lift", ...), a config, or a config as a mapping with its `type`.
    options: fields of the config, in place of its own; values as in Python or as in YAML.

    Raises:
        UsageError: no such environment or field, a value that does not fit, or a package that is not installed.
    """
    if isinstance(name_or_config, EnvironmentConfig) and not options:
        return name_or_config.build()
    if isinstance(name_or_config, str):
        name_or_config = {"type": name_or_config}
    block = to_dict(name_or_config) | to_dict(options)
    kind, kinds = block.get("type"), sorted(EnvironmentConfig.get_known_choices())
    if kind not in kinds:
        raise UsageError(f"there is no environment {kind!r}{nearest(str(kind), kinds)}")
    return from_dict(EnvironmentConfig, block).build()
