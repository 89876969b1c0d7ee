"""A config's dataclasses as a schema: fill in defaults, build values, report what is wrong and where."""

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args, get_origin

import draccus
from draccus.utils import DraccusException

from playlearn.config.paths import FileText, unmarked
from playlearn.errors import UsageError

TYPE = "type"


class Problem(Exception):
    """What is wrong with the value at a place of a config; `known` are the names that would have been right."""

    def __init__(self, path: tuple[str, ...], text: str, unknown: str = "", known: Sequence[str] = ()) -> None:
        super().__init__(path, text)
        self.path, self.text, self.unknown, self.known = path, text, unknown, known

    def message(self, root: Any) -> str:
        if not self.unknown:
            return self.text
        if difflib.get_close_matches(self.unknown, self.known, n=1, cutoff=0.6):
            return self.text + nearest(self.unknown, self.known)
        # `--lr` for `optimizer.lr`: the name is right, its place is not.
        elsewhere = [name for name in _flat(complete(root, {})) if name.split(".")[-1] == self.unknown]
        elsewhere = [name for name in elsewhere if name != ".".join(self.path)]
        return self.text + (f"; did you mean `{elsewhere[0]}`?" if elsewhere else nearest(self.unknown, self.known))


def complete(cls: Any, raw: Mapping[str, Any], default: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """`raw` with every default filled in, nested ones too; what is wrong in it stays for `build` to report.

    default: what the enclosing config holds here when nothing is given; it counts unless `raw` is another kind.
    A mapping or a list that is given replaces the default's, only blocks are merged.
    """
    if default is None or raw.get(TYPE, default.get(TYPE)) != default.get(TYPE):
        default = {}
    full = {**default, **raw}
    cls = _kind(cls, full)
    if not dataclasses.is_dataclass(cls):
        return full
    hints = typing.get_type_hints(cls)
    for field in dataclasses.fields(cls):
        name, below = field.name, _default(field)
        if name in default:
            below = default[name]
        elif below is not dataclasses.MISSING:
            below = encode(below)
        nested = _dataclass_in(hints[name])
        if name not in raw and below is not dataclasses.MISSING:
            full[name] = below
        elif nested is not None and isinstance(raw.get(name), dict):
            full[name] = complete(nested, raw[name], below if isinstance(below, dict) else None)
    return full


def encode(value: Any, path: Callable[[Path], str] = str) -> Any:
    """A config or a part of it as JSON (draccus.encode forgets the kinds in a tuple, and of a kind by itself).

    path: how a path is spelled.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        cls: Any = type(value)
        kind = {TYPE: cls.get_choice_name(cls)} if _is_choice(cls) else {}
        return kind | {field.name: encode(getattr(value, field.name), path) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): encode(item, path) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [encode(item, path) for item in value]
    return path(value) if isinstance(value, Path) else value


def build(cls: Any, raw: Any, path: tuple[str, ...]) -> Any:
    """The value of type `cls` that `raw` describes; raises Problem at the first thing that is wrong."""
    origin, arguments = get_origin(cls), get_args(cls)
    if cls is Any:
        return unmarked(raw)
    if origin in (typing.Union, types.UnionType):
        return _build_union(arguments, raw, path)
    if dataclasses.is_dataclass(cls) or _is_choice(cls):
        return _build_dataclass(cls, raw, path)
    if origin in (list, tuple, Sequence):
        return _build_sequence(cls, raw, path)
    if origin in (dict, Mapping) or cls in (dict, Mapping):
        if not isinstance(raw, dict):
            raise Problem(path, f"{_name(path)} must be a mapping, not {format_value(raw)}")
        item = arguments[1] if arguments else Any
        return {str(key): build(item, value, (*path, str(key))) for key, value in raw.items()}
    return _build_leaf(cls, raw, path)


def _build_dataclass(cls: Any, raw: Any, path: tuple[str, ...]) -> Any:
    if not isinstance(raw, dict):
        raise Problem(path, f"{_name(path)} must be a block of fields, not {format_value(raw)}")
    if _is_choice(cls):
        cls, raw = _pick(cls, raw, path)
    hints = typing.get_type_hints(cls)
    fields = {field.name: field for field in dataclasses.fields(cls) if field.init}
    for key in raw:
        if key not in fields:
            raise Problem((*path, str(key)), f"unknown field {_name((*path, str(key)))}", str(key), list(fields))
    for name, field in fields.items():
        if name not in raw and _default(field) is dataclasses.MISSING:
            raise Problem(path, f"{_name((*path, name))} is missing; give it in the file or as `--{name} value`")
    values = {key: build(hints[key], value, (*path, key)) for key, value in raw.items()}
    try:
        return cls(**values)
    except (TypeError, ValueError, UsageError) as error:
        raise Problem(path, f"{_name(path)}: {error}" if path else str(error)) from error


def _pick(cls: Any, raw: dict[str, Any], path: tuple[str, ...]) -> tuple[Any, dict[str, Any]]:
    """The concrete class that `type:` names, and the fields without it."""
    found = _kind(cls, raw)
    names = sorted(cls.get_known_choices())
    if found is None and TYPE not in raw:
        raise Problem(path, f"{_name(path)} needs a `type:`, one of {', '.join(names)}")
    names = [name for name in names if issubclass(cls.get_choice_class(name), cls)]
    if found is None or not issubclass(found, cls):
        text = f"{_name((*path, TYPE))} is unknown: {raw[TYPE]!r}"
        raise Problem((*path, TYPE), text + nearest(str(raw[TYPE]), names))
    return found, {key: value for key, value in raw.items() if key != TYPE}


def _build_union(arguments: tuple[Any, ...], raw: Any, path: tuple[str, ...]) -> Any:
    if raw is None and type(None) in arguments:
        return None
    problems = []
    for argument in arguments:
        if argument is type(None):
            continue
        try:
            return build(argument, raw, path)
        except Problem as problem:
            problems.append(problem)
    # The one that got furthest into the value is about what the user meant.
    raise max(problems, key=lambda problem: len(problem.path))


def _build_sequence(cls: Any, raw: Any, path: tuple[str, ...]) -> Any:
    origin, arguments = get_origin(cls), get_args(cls)
    if not isinstance(raw, list | tuple):
        raise Problem(path, f"{_name(path)} must be a list, not {format_value(raw)}")
    fixed = origin is tuple and Ellipsis not in arguments
    if fixed and len(raw) != len(arguments):
        raise Problem(path, f"{_name(path)} must have {len(arguments)} values, not {len(raw)}")
    kinds = arguments if fixed else (arguments[0],) * len(raw)
    items = [build(kind, value, (*path, str(i))) for i, (kind, value) in enumerate(zip(kinds, raw, strict=True))]
    return items if origin is list else tuple(items)


def _build_leaf(cls: Any, raw: Any, path: tuple[str, ...]) -> Any:
    if isinstance(raw, FileText):
        raw = raw.found() if cls is Path else str(raw)
    # draccus accepts null, true or a list for a number or a text; in a config that is a mistake.
    allowed = {int: (int,), float: (int, float), bool: (bool,), str: (str,), Path: (str, Path)}.get(cls)
    wrong = Problem(path, f"{_name(path)} must be {_expected(cls)}, not {format_value(raw)}")
    if allowed is not None and (not isinstance(raw, allowed) or (isinstance(raw, bool) and cls is not bool)):
        raise wrong
    try:
        value = draccus.decode(cls, raw)
    except (DraccusException, KeyError) as error:
        raise wrong from error
    if isinstance(value, float) and math.isnan(value):
        raise wrong
    return value


def nearest(name: str, known: Sequence[str]) -> str:
    """The end of a message about an unknown name: the nearest known one, or all of them."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    if close:
        return f"; did you mean `{close[0]}`?"
    return f"; known: {', '.join(known)}" if known else ""


def _kind(cls: Any, raw: Any) -> Any:
    """The concrete class of a kind's block, None where it is unknown; other classes are their own."""
    if not _is_choice(cls):
        return cls
    choices = cls.get_known_choices()
    if isinstance(raw, dict) and TYPE in raw:
        return choices.get(raw[TYPE]) if isinstance(raw[TYPE], str) else None
    return cls if cls in choices.values() else choices.get(cls.default_choice_name())


def _is_choice(cls: Any) -> bool:
    return isinstance(cls, type) and issubclass(cls, draccus.ChoiceRegistry)


def _dataclass_in(hint: Any) -> Any:
    """The dataclass or kind that a field holds (`X` or `X | None`), else None."""
    options = get_args(hint) if get_origin(hint) in (typing.Union, types.UnionType) else (hint,)
    found = [option for option in options if isinstance(option, type) and dataclasses.is_dataclass(option)]
    return found[0] if len(found) == 1 else None


def _default(field: "dataclasses.Field[Any]") -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def _flat(raw: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in raw.items():
        yield prefix + key
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")


def _name(path: tuple[str, ...]) -> str:
    return f"`{'.'.join(path)}`" if path else "the config"


def format_value(raw: Any) -> str:
    return "null" if raw is None else f"a {type(raw).__name__}" if isinstance(raw, dict | list) else repr(raw)


def _expected(cls: Any) -> str:
    if get_origin(cls) is typing.Literal:
        return f"one of {', '.join(map(str, get_args(cls)))}"
    names = {int: "a whole number", float: "a number", bool: "true or false", str: "text (in quotes)", Path: "a path"}
    return names.get(cls, getattr(cls, "__name__", str(cls)))
