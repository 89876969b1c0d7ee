"""From YAML and the command line to frozen dataclasses, and back."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from playlearn.config.paths import found, from_file, moved, spelled_from
from playlearn.config.record import atomic_write
from playlearn.config.schema import TYPE, Problem, build, complete, encode, format_value, nearest
from playlearn.errors import UsageError


def load_config[T](cls: type[T], path: Path | None, overrides: Sequence[str] = ()) -> T:
    """The config that a YAML file and `--a.b value` (or `--a.b=value`) overrides describe.

    Values of overrides are YAML. Giving a block another `type` starts that block afresh.

    Raises:
        UsageError: no such file, not YAML, an unknown field or kind, a missing field, a value of a wrong type.
    """
    raw = {} if path is None else _read(path)
    where = "" if path is None else f"{path}: "
    given = _parse(overrides)
    try:
        raw = complete(cls, raw)
        # A new kind first, so that the other overrides find the fields of that kind.
        for keys, value in sorted(given, key=lambda item: (item[0][-1] != TYPE, len(item[0]))):
            raw = complete(cls, _replace(raw, keys, value))
    except Problem as problem:
        raise UsageError(f"{where}{problem.message(cls)}") from problem
    try:
        config: T = build(cls, raw, ())
    except Problem as problem:
        raise UsageError(f"{_blame(problem, given, where)}{problem.message(cls)}") from problem
    return config


def to_dict(config: Any, folder: Path | None = None) -> dict[str, Any]:
    """The config as JSON: every field, kinds with their `type`. folder: of the file that it is for, see `paths`."""
    encoded: dict[str, Any] = encode(config, str if folder is None else spelled_from(folder))
    return encoded


def from_dict[T](cls: type[T], raw: Mapping[str, Any]) -> T:
    """The config that `to_dict` described; raises UsageError like `load_config`."""
    try:
        config: T = build(cls, complete(cls, dict(raw)), ())
    except Problem as problem:
        raise UsageError(problem.message(cls)) from problem
    return config


def save_config(config: Any, path: Path) -> None:
    """Write the resolved config as YAML that `load_config` reads back, its paths as `paths` says."""
    atomic_write(path, _dump(to_dict(config, path.parent)))


def copy_config(source: Path, target: Path) -> None:
    """Copy a file that `save_config` wrote, so that its paths mean the same in the other folder."""
    raw = _yaml(source.read_text(encoding="utf-8"), str(source))
    atomic_write(target, _dump(moved(raw, source.parent, target.parent)))


def read_config(path: Path) -> dict[str, Any]:
    """The mapping in a config file, its paths found; for one of which only a part is wanted.

    Raises:
        UsageError: no such file, not YAML, not a mapping.
    """
    raw: dict[str, Any] = found(_read(path))
    return raw


def _read(path: Path) -> dict[str, Any]:
    try:
        raw = _yaml(path.read_text(encoding="utf-8"), str(path))
    except FileNotFoundError:
        siblings = sorted(file.name for file in path.parent.glob("*.yaml")) if path.parent.is_dir() else []
        raise UsageError(f"there is no config {path}{nearest(path.name, siblings)}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot read the config {path}: {error}") from error
    if raw is None and not path.stat().st_size:
        raise UsageError(f"{path} is empty: was the disk full when it was written? A config without fields is `{{}}`")
    if raw is None:
        return {}
    if not isinstance(raw, dict):
        raise UsageError(f"{path}: a config is a mapping of fields, not {format_value(raw)}")
    marked: dict[str, Any] = from_file(path.parent, raw)
    return marked


def to_yaml(value: Any) -> str:
    """A part of what `to_dict` returns as one line of YAML that `load_config` reads back."""
    text: str = yaml.dump(
        value, Dumper=_Dumper, default_flow_style=True, sort_keys=False, allow_unicode=True, width=float("inf")
    )
    return text.removesuffix("...\n").strip()


def _blame(problem: Problem, given: Sequence[tuple[tuple[str, ...], Any]], where: str) -> str:
    """The name of the file, unless an override is what was wrong."""
    return "" if any(keys[: len(problem.path)] == problem.path for keys, _ in given) else where


def _dump(raw: Mapping[str, Any]) -> bytes:
    text: str = yaml.dump(raw, Dumper=_Dumper, sort_keys=False, allow_unicode=True)
    return text.encode()


def _yaml(text: str, source: str) -> Any:
    try:
        return yaml.load(text, _Loader)  # noqa: S506 - a SafeLoader
    except yaml.YAMLError as error:
        raise UsageError(f"{source}: not valid YAML: {' '.join(str(error).split())}") from error


def _parse(overrides: Sequence[str]) -> list[tuple[tuple[str, ...], Any]]:
    """`--a.b=1 --c 2` -> [(("a", "b"), 1), (("c",), 2)]."""
    given: list[tuple[tuple[str, ...], Any]] = []
    left = list(overrides)
    while left:
        name = left.pop(0)
        if not re.match(r"--[A-Za-z_]", name):
            raise UsageError(f"unexpected argument {name!r}; a config field is set with `--field value`")
        name, equals, value = name[2:].partition("=")
        if not equals:
            if not left or re.match(r"--[A-Za-z_]", left[0]):
                raise UsageError(f"`--{name}` needs a value (`--{name} true` for a switch)")
            value = left.pop(0)
        given.append((tuple(name.split(".")), _yaml(value, f"--{name}")))
    return given


def _replace(raw: Mapping[str, Any], keys: tuple[str, ...], value: Any) -> dict[str, Any]:
    """`raw` with the value at `keys` put in; another `type` drops the fields of the kind that stood there."""
    key, rest = keys[0], keys[1:]
    if rest:
        inner = raw.get(key)
        return {**raw, key: _replace(inner if isinstance(inner, dict) else {}, rest, value)}
    if key == TYPE and raw.get(TYPE) != value:
        return {TYPE: value}
    return {**raw, key: value}


class _Loader(yaml.SafeLoader):
    """Safe YAML with 1.2's plain scalars: `no` is text, `1e-4` a number; a repeated key is an error."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                raise yaml.constructor.ConstructorError(None, None, f"`{key}` is given twice", node.start_mark)
        return super().construct_mapping(node, deep)


class _Dumper(yaml.SafeDumper):
    """Puts in quotes what `_Loader` would not read back as text."""


_SCALARS = (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?(0|[1-9][0-9]*)", list("-+0123456789")),
    ("float", r"[-+]?(\.[0-9]+|(0|[1-9][0-9]*)(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.inf|\.nan", list("-+.0123456789")),
    ("merge", r"<<", ["<"]),
)
for _class in (_Loader, _Dumper):
    _class.yaml_implicit_resolvers = {}
    for _tag, _pattern, _first in _SCALARS:
        _class.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), _first)
