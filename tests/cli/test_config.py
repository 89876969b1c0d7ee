"""`playlearn config`: what it prints is a config, complete and explained."""

import dataclasses
import re
import subprocess
import sys
import typing
from pathlib import Path
from typing import Any, Literal

import draccus
import pytest

from playlearn import cli
from playlearn.api.configs import CONFIGS, config_class
from playlearn.cli.config import EXAMPLES, load
from playlearn.config import load_config
from playlearn.config.reference import describe, field_choices, field_docs, summary, type_name

SHOWN = {
    "collect": ["environment", "play"],
    "train": ["policy.encoder", "policy.trunk", "policy.head", "data.goals"],
    "suite": ["environment", "kind"],
    "dagger": ["goals", "beta", "gate"],
    "compare": [],
    "demo": [],
}


def every_kind() -> list[tuple[str, str, str]]:
    """(config, block, type) of every registered kind that needs no further field."""
    found = []
    for name, blocks in SHOWN.items():
        choices = field_choices(load(name))
        found += [(name, block, kind) for block in blocks for kind in choices[f"{block}.type"]]
    return found


@pytest.mark.parametrize(("name", "block", "kind"), every_kind())
def test_what_is_printed_reads_back_as_what_was_asked_for(name: str, block: str, kind: str, tmp_path: Path) -> None:
    asked = [f"--{block}.type", kind]
    if (block, kind) == ("policy.encoder", "keypoints"):
        asked += ["--policy.encoder.use_estimated_state", "true"]
    if kind == "mixture":
        asked += [f"--{block}.samplers", "[{goals: {type: settled}, weight: 1.0}]"]
    if (block, kind) == ("policy.encoder", "transformers"):
        asked += ["--policy.encoder.name", "facebook/dinov2-small"]
    config = load(name, None, asked)
    (tmp_path / "printed.yaml").write_text(describe(config))
    assert load_config(config_class(name), tmp_path / "printed.yaml") == config


@pytest.mark.parametrize("name", CONFIGS)
def test_every_field_is_printed_with_its_type(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["config", name]) == 0
    printed = capsys.readouterr().out
    for field in field_choices(load(name)):
        assert re.search(rf"^ *{re.escape(field.split('.')[-1])}: .*# \S", printed, re.MULTILINE), field


def test_a_file_is_printed_completed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.yaml").write_text("policy: {history: 2}\n")
    arguments = ["config", "train", "--config", str(tmp_path / "mine.yaml"), "--policy.head.type", "flow"]
    assert cli.main(arguments) == 0
    (tmp_path / "whole.yaml").write_text(capsys.readouterr().out)
    config = load_config(config_class("train"), tmp_path / "whole.yaml")
    assert (config.policy.history, type(config.policy.head).__name__) == (2, "FlowConfig")


def test_a_strangers_config_from_one_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A flow head, history 2, goals two settled moments ahead."""
    fields = ["--policy.head.type", "flow", "--policy.history", "2", "--data.goals.ahead", "2"]
    assert cli.main(["config", "train", *fields]) == 0
    (tmp_path / "mine.yaml").write_text(capsys.readouterr().out)
    config = load_config(config_class("train"), tmp_path / "mine.yaml").resolved()
    assert (config.data.history, config.data.goals.ahead) == (2, 2)  # the policy decides the data's history


def test_a_mistake_names_the_nearest_field(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["config", "train", "--policy.histroy", "2"]) == 2
    out, errors = capsys.readouterr()
    assert "did you mean `history`" in errors
    assert out == ""


def test_examples_stand_only_where_a_field_has_no_default() -> None:
    for name in CONFIGS:
        required = {
            field.name
            for field in dataclasses.fields(config_class(name))
            if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        }
        assert {field.split(".")[0] for field in EXAMPLES.get(name, {})} == required


@dataclasses.dataclass(frozen=True)
class Inner:
    """size: in meters."""

    size: float


@dataclasses.dataclass(frozen=True)
class Documented:
    """What it is about.

    one: the first. Note: this is no field; nor is
        two: at the start of a continuation line.
    two, three: share a meaning.
    four: is on a line. five: with another one.

    Raises UsageError where one: is wrong.
    """

    one: int | None = None
    two: Literal["a", "b"] = "a"
    three: tuple[float, float] = (0.0, 1.0)
    four: tuple[Inner, ...] = ()
    five: Inner | None = None
    six: dict[str, Inner] = dataclasses.field(default_factory=dict)
    seven: bool = False


def test_docstrings_are_read_field_by_field() -> None:
    docs = field_docs(Documented)
    assert docs["one"] == "the first. Note: this is no field; nor is two: at the start of a continuation line."
    assert docs["two"] == docs["three"] == "share a meaning."
    assert (docs["four"], docs["five"]) == ("is on a line.", "with another one.")
    assert "six" not in docs
    assert summary(Documented) == "What it is about."
    assert (summary(Inner), field_docs(Inner)) == ("", {"size": "in meters."})


def test_types_are_said_in_words() -> None:
    hints: dict[str, Any] = typing.get_type_hints(Documented)
    said = {name: type_name(hint) for name, hint in hints.items()}
    assert said == {
        "one": "int or null",
        "two": "one of a, b",
        "three": "[float, float]",
        "four": "list of block",
        "five": "block or null",
        "six": "mapping of text to block",
        "seven": "true or false",
    }


def test_what_is_empty_shows_what_it_may_hold_as_comments_that_can_be_uncommented(tmp_path: Path) -> None:
    shown = describe(Documented())
    for name in ("four", "five", "six"):  # the value goes, the comment comes, and the required field is filled in
        shown = re.sub(rf"^{name}: .*\n", "", shown, flags=re.MULTILINE)
    text = re.sub(r"^# (four|five|six|  .*)", r"\1", shown, flags=re.MULTILINE)
    text = text.replace("size:  # required; float", "size: 1.5").replace("NAME", "left")
    (tmp_path / "uncommented.yaml").write_text(text)
    config = load_config(Documented, tmp_path / "uncommented.yaml")
    assert config == Documented(four=(Inner(1.5),), five=Inner(1.5), six={"left": Inner(1.5)})


def test_fields_with_few_values_say_which() -> None:
    choices = field_choices(load("train"))
    assert choices["precision"] == ("float32", "bf16")
    assert choices["tracker"] == ("tensorboard", "wandb", "null")
    assert choices["cpu"] == ("true", "false")
    assert choices["lr"] == choices["max_minutes"] == ()
    assert "flow" in choices["policy.head.type"]
    assert issubclass(type(load("train").policy.head), draccus.ChoiceRegistry)


def test_config_starts_without_a_simulator() -> None:
    """Printing the help of `config` is as quick as any help."""
    heavy = "{'torch', 'numpy', 'mujoco', 'yaml', 'draccus'}"
    code = (
        f"import sys; from playlearn.cli import main; main(['config', '-h']); sys.exit(str({heavy} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=False)
    assert done.stderr.strip() == "set()"
