"""Configs of the commands, from files and overrides."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

if TYPE_CHECKING:
    from playlearn.collection import CollectConfig
    from playlearn.dagger import DaggerConfig
    from playlearn.demo.config import DemoConfig
    from playlearn.evaluation import SuiteConfig
    from playlearn.experiments.compare import CompareConfig
    from playlearn.training import TrainConfig

type Where = Path | str
type Overrides = Mapping[str, Any]
type ConfigName = Literal["collect", "train", "suite", "dagger", "compare", "demo"]

CONFIGS: tuple[ConfigName, ...] = ("collect", "train", "suite", "dagger", "compare", "demo")
NO_OVERRIDES: Overrides = {}


@overload
def load_config(name: Literal["collect"], path: Where | None = None, overrides: Overrides = ...) -> "CollectConfig": ...
@overload
def load_config(name: Literal["train"], path: Where | None = None, overrides: Overrides = ...) -> "TrainConfig": ...
@overload
def load_config(name: Literal["suite"], path: Where | None = None, overrides: Overrides = ...) -> "SuiteConfig": ...
@overload
def load_config(name: Literal["dagger"], path: Where | None = None, overrides: Overrides = ...) -> "DaggerConfig": ...
@overload
def load_config(name: Literal["compare"], path: Where | None = None, overrides: Overrides = ...) -> "CompareConfig": ...
@overload
def load_config(name: Literal["demo"], path: Where | None = None, overrides: Overrides = ...) -> "DemoConfig": ...
def load_config(name: ConfigName, path: Where | None = None, overrides: Overrides = NO_OVERRIDES) -> Any:
    """The config of a command: what the file says, then `overrides`, over the defaults.

    name: whose config. path: a YAML file (None: the defaults). overrides: dotted field -> value,
    `{"policy.head.type": "flow", "steps": 3000}`. `playlearn config NAME` prints all fields.

    Raises:
        UsageError: no such file, an unknown field, a missing one, or a value of a wrong type.
    """
    from playlearn.config import load_config as load

    return load(config_class(name), None if path is None else Path(path), as_arguments(overrides))


def load_suite(path: Where, overrides: Overrides = NO_OVERRIDES) -> "SuiteConfig":
    """The evaluation suite of a YAML file (eval/suites/); raises UsageError where it is wrong."""
    return load_config("suite", path, overrides)


def config_class(name: ConfigName) -> Any:
    """The config class of a command."""
    if name == "collect":
        from playlearn.collection import CollectConfig

        return CollectConfig
    if name == "train":
        from playlearn.training import TrainConfig

        return TrainConfig
    if name == "suite":
        from playlearn.evaluation import SuiteConfig

        return SuiteConfig
    if name == "dagger":
        from playlearn.dagger import DaggerConfig

        return DaggerConfig
    if name == "compare":
        from playlearn.experiments.compare import CompareConfig

        return CompareConfig
    if name == "demo":
        from playlearn.demo.config import DemoConfig

        return DemoConfig
    raise _unknown_config(name)


def _unknown_config(name: str) -> Exception:
    from playlearn.config import nearest
    from playlearn.errors import UsageError

    return UsageError(f"there is no config {name!r}{nearest(name, CONFIGS)}")


def resolve(name: ConfigName, given: Any, overrides: Overrides) -> Any:
    """The config that a verb was handed: itself, or what its file says."""
    from playlearn.errors import UsageError

    if isinstance(given, Path | str):
        return load_config(name, given, overrides)
    if overrides:
        raise UsageError("overrides go with a file; change a config by `dataclasses.replace(config, field=value)`")
    return given


def as_arguments(overrides: Overrides) -> list[str]:
    """As on the command line; JSON is YAML."""
    return [f"--{name}={json.dumps(value, default=str)}" for name, value in overrides.items()]
