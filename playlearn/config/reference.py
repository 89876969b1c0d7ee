"""Every field of a config as annotated YAML: default, type, choices and its line of the class's docstring.

A docstring says `field: meaning`, one field a line, continuation lines indented. Several fields on a line
(`one: ... . two: ...`) and several names for one meaning (`one, two: ...`) are understood as well.
"""

import dataclasses
import inspect
import re
import textwrap
import types
import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args, get_origin

import draccus

from playlearn.config.load import to_yaml
from playlearn.config.schema import TYPE, encode

WIDTH = 100  # of a line of documentation
INDENT = "  "
_NAMES: dict[Any, str] = {
    int: "int",
    float: "float",
    bool: "true or false",
    str: "text",
    Path: "path",
    Any: "any value",
}


def describe(config: Any) -> str:
    """The config as YAML that `load_config` reads back to the same config, each field with its documentation."""
    return "\n".join(_fields(type(config), config, expand=True)) + "\n"


def field_choices(config: Any, prefix: str = "") -> dict[str, tuple[str, ...]]:
    """What `--field value` can set in this config: dotted name -> the values it may have, where they are few."""
    choices: dict[str, tuple[str, ...]] = {}
    hints = typing.get_type_hints(type(config))
    for field in dataclasses.fields(config):
        value, name, hint = getattr(config, field.name), prefix + field.name, hints[field.name]
        if not dataclasses.is_dataclass(value):
            choices[name] = _values(hint)
            continue
        if _is_kind(type(value)):
            choices[f"{name}.{TYPE}"] = tuple(kinds(_declared(value, hint)))
        choices |= field_choices(value, f"{name}.")
    return choices


def field_docs(cls: type) -> dict[str, str]:
    """Field -> its meaning, from the docstrings of the class and its bases; a field that none mentions is left out."""
    meanings: dict[str, str] = {}
    for base in cls.__mro__:
        if dataclasses.is_dataclass(base):
            meanings = _parse(base)[1] | meanings
    return meanings


def summary(cls: type) -> str:
    """What a class's docstring says before its fields; empty where there is none."""
    return _parse(cls)[0] if dataclasses.is_dataclass(cls) else ""


def type_name(hint: Any) -> str:
    """A field's type in words: `int or null`, `one of image, state`, `list of text`."""
    origin, arguments = get_origin(hint), get_args(hint)
    if hint is type(None):
        return "null"
    if origin in (typing.Union, types.UnionType):
        return " or ".join(map(type_name, arguments))
    if origin is typing.Literal:
        return f"one of {', '.join(map(str, arguments))}"
    if origin in (list, tuple, Sequence):
        if origin is tuple and Ellipsis not in arguments:
            return f"[{', '.join(map(type_name, arguments))}]"
        return f"list of {type_name(arguments[0])}"
    if origin in (dict, Mapping):
        return f"mapping of {type_name(arguments[0])} to {type_name(arguments[1])}"
    if _is_kind(hint):
        return f"block of type {', '.join(kinds(hint))}"
    return "block" if dataclasses.is_dataclass(hint) else _NAMES.get(hint, getattr(hint, "__name__", str(hint)))


def kinds(cls: Any) -> list[str]:
    """The names that `type:` may have in a block of this class."""
    return [name for name in sorted(cls.get_known_choices()) if issubclass(cls.get_choice_class(name), cls)]


def _fields(cls: Any, config: Any, *, expand: bool) -> Iterator[str]:
    """The lines of a block. config: the values, None for the defaults. expand: show what a null block would hold."""
    docs, hints = field_docs(cls), typing.get_type_hints(cls)
    for field in dataclasses.fields(cls):
        hint = hints[field.name]
        value = getattr(config, field.name) if config is not None else _default(field)
        yield from _comment(docs.get(field.name, ""))
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            yield f"{field.name}:" + ("" if _is_kind(type(value)) else _optional(hint))
            yield from _indented(_block(value, hint, expand=expand))
        elif value is dataclasses.MISSING:
            yield f"{field.name}:  # required; {type_name(hint)}"
        else:
            yield f"{field.name}: {to_yaml(encode(value))}  # {type_name(hint)}"
            if expand and value in (None, (), {}):
                yield from _what_it_may_hold(field.name, hint)


def _block(value: Any, hint: Any, *, expand: bool) -> Iterator[str]:
    """The fields of a nested block; of a kind, its `type` first."""
    cls = type(value)
    if _is_kind(cls):
        yield from _comment(summary(cls))
        choices = ", ".join(kinds(_declared(value, hint)))
        yield f"{TYPE}: {cls.get_choice_name(cls)}  # one of {choices}{_optional(hint)}"
    yield from _fields(cls, value, expand=expand)


def _what_it_may_hold(name: str, hint: Any) -> Iterator[str]:
    """As comments: the fields of the block that could stand where nothing does."""
    for cls in _classes(hint):
        if _is_kind(cls):
            continue
        lines = list(_fields(cls, None, expand=False))
        if get_origin(hint) in (list, tuple, Sequence):
            first = next(i for i, line in enumerate(lines) if not line.startswith("#"))
            lines = [("- " if i == first else INDENT) + line for i, line in enumerate(lines)]
        elif get_origin(hint) in (dict, Mapping):
            lines = ["NAME:", *_indented(lines)]
        yield f"# {name}:"
        yield from (f"# {INDENT}{line}" for line in lines)


def _declared(value: Any, hint: Any) -> Any:
    """The class of kinds that a field was annotated with, of which `value` is one."""
    return next((cls for cls in _classes(hint) if isinstance(value, cls)), type(value))


def _values(hint: Any) -> tuple[str, ...]:
    """All that a type allows, where that is little."""
    if hint is bool:
        return ("true", "false")
    if get_origin(hint) is typing.Literal:
        return tuple(map(str, get_args(hint)))
    if hint is type(None):
        return ("null",)
    if get_origin(hint) in (typing.Union, types.UnionType):
        each = [_values(option) for option in get_args(hint)]
        return tuple(value for values in each for value in values) if all(each) else ()
    return ()


def _optional(hint: Any) -> str:
    rest = [option for option in get_args(hint) if not dataclasses.is_dataclass(option)]
    union = get_origin(hint) in (typing.Union, types.UnionType)
    return f"  # or {' or '.join(map(type_name, rest))}" if union and rest else ""


def _comment(text: str) -> Iterator[str]:
    for line in textwrap.wrap(text, WIDTH, break_long_words=False, break_on_hyphens=False):
        yield f"# {line}"


def _indented(lines: Iterable[str]) -> Iterator[str]:
    return (INDENT + line for line in lines)


def _parse(cls: Any) -> tuple[str, dict[str, str]]:
    """What a class's own docstring says before its fields, and of each field."""
    text = inspect.cleandoc(cls.__dict__.get("__doc__") or "")
    if text.startswith(f"{cls.__name__}("):  # dataclass made it up
        return "", {}
    name = "|".join(re.escape(field.name) for field in dataclasses.fields(cls)) or "(?!)"
    # A name at the start of a line, or after a sentence's end where one line says several.
    heads = list(re.finditer(rf"(?:^|(?<=[.)]\s))((?:{name})(?:, (?:{name}))*): ", text, re.MULTILINE))
    ends = [*(head.start() for head in heads), len(text)][1:]
    meanings = {}
    for head, end in zip(heads, ends, strict=True):
        for field in head.group(1).split(", "):
            meanings[field] = _paragraph(text[head.end() : end])
    return _paragraph(text[: heads[0].start()] if heads else text), meanings


def _paragraph(text: str) -> str:
    """The first paragraph, on one line."""
    return " ".join(text.strip().split("\n\n")[0].split())


def _default(field: "dataclasses.Field[Any]") -> Any:
    return field.default_factory() if field.default_factory is not dataclasses.MISSING else field.default


def _classes(hint: Any) -> list[Any]:
    """The dataclasses that a type is made of."""
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return [hint]
    return [cls for argument in get_args(hint) for cls in _classes(argument)]


def _is_kind(cls: Any) -> bool:
    return isinstance(cls, type) and issubclass(cls, draccus.ChoiceRegistry)
