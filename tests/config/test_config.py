import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import draccus
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from playlearn.config import atomic_write, from_dict, git_revision, load_config, save_config, to_dict, versions
from playlearn.errors import DiskError, UsageError


@dataclass(frozen=True)
class HeadConfig(draccus.ChoiceRegistry):
    pass


@HeadConfig.register_subclass("mean")
@dataclass(frozen=True)
class MeanConfig(HeadConfig):
    width: int = 64


@HeadConfig.register_subclass("flow")
@dataclass(frozen=True)
class FlowConfig(HeadConfig):
    width: int = 128
    steps: int = 10

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"steps must be 1 or more, not {self.steps}")


@dataclass(frozen=True)
class PolicyConfig:
    head: HeadConfig = field(default_factory=lambda: FlowConfig(width=99))
    second: HeadConfig | None = None
    guidance: float | None = None
    rate: float = 1e-3


@dataclass(frozen=True)
class CameraConfig:
    height: int = 64
    width: int = 64


@dataclass(frozen=True)
class RunConfig:
    store: Path
    policy: PolicyConfig = field(default_factory=lambda: PolicyConfig(rate=2e-3))
    cameras: dict[str, CameraConfig] = field(
        default_factory=lambda: {"front": CameraConfig(), "wrist": CameraConfig(48)}
    )
    precision: Literal["no", "bf16"] = "no"
    seeds: tuple[int, ...] = (1, 2)
    betas: tuple[float, float] = (0.9, 0.95)
    heads: tuple[HeadConfig, ...] = (MeanConfig(), FlowConfig())
    notes: Mapping[str, Any] = field(default_factory=dict)
    shuffle: bool = True
    name: str = "x"


heads = st.builds(MeanConfig, width=st.integers()) | st.builds(FlowConfig, width=st.integers(), steps=st.integers(1))
numbers = st.floats(allow_nan=False, allow_infinity=False)
texts = st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "Zs")))
runs = st.builds(
    RunConfig,
    store=texts.filter(bool).map(Path),
    policy=st.builds(PolicyConfig, head=heads, second=st.none() | heads, guidance=st.none() | numbers, rate=numbers),
    cameras=st.dictionaries(texts, st.builds(CameraConfig, height=st.integers(), width=st.integers())),
    precision=st.sampled_from(["no", "bf16"]),
    seeds=st.lists(st.integers()).map(tuple),
    betas=st.tuples(numbers, numbers),
    heads=st.lists(heads).map(tuple),
    notes=st.dictionaries(texts, st.none() | st.booleans() | st.integers() | texts),
    shuffle=st.booleans(),
    name=texts,
)

# How long an example takes says nothing about a config, only about what else the machine does.
any_speed = settings(deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow])


def load(*overrides: str) -> RunConfig:
    return load_config(RunConfig, None, ["--store", "s", *overrides])


@any_speed
@given(runs)
def test_dict_and_json_hold_the_whole_config(run: RunConfig) -> None:
    assert from_dict(RunConfig, json.loads(json.dumps(to_dict(run)))) == run


@pytest.mark.slow
@any_speed
@given(run=runs)
def test_a_saved_config_is_read_back(run: RunConfig, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("config") / "config.yaml"
    save_config(run, path)
    read = load_config(RunConfig, path)
    assert read.store.resolve() == run.store.resolve(), "the same place, from any folder"
    assert replace(read, store=run.store) == run


def test_a_kind_by_itself_keeps_its_name() -> None:
    assert to_dict(FlowConfig()) == {"type": "flow", "width": 128, "steps": 10}
    assert from_dict(HeadConfig, to_dict(FlowConfig(steps=3))) == FlowConfig(steps=3)
    assert from_dict(FlowConfig, to_dict(FlowConfig(steps=3))) == FlowConfig(steps=3)
    with pytest.raises(UsageError, match="flow"):
        from_dict(FlowConfig, to_dict(MeanConfig()))


def test_what_is_left_out_keeps_the_default_of_the_enclosing_config(tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text("store: s\npolicy:\n  guidance: 2\n  head: {steps: 4}\n")
    # 99 and 2e-3 are RunConfig's and PolicyConfig's own defaults, not FlowConfig's 128 or PolicyConfig's 1e-3.
    assert load_config(RunConfig, path).policy == PolicyConfig(head=FlowConfig(99, 4), guidance=2.0, rate=2e-3)


def test_an_override_wins_over_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text("store: s\npolicy: {rate: 1}\ncameras: {side: {height: 8}}\n")
    run = load_config(RunConfig, path, ["--policy.rate", "3e-4", "--cameras.side.width=16", "--store=t"])
    assert (run.policy.rate, run.cameras, run.store) == (3e-4, {"side": CameraConfig(8, 16)}, Path("t"))


def test_an_override_inside_a_default_mapping_keeps_its_other_entries() -> None:
    assert load("--cameras.front.height", "96").cameras == {"front": CameraConfig(96, 64), "wrist": CameraConfig(48)}


def test_a_mapping_in_a_file_replaces_the_default_mapping(tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text("store: s\ncameras: {front: {}}\n")
    assert load_config(RunConfig, path).cameras == {"front": CameraConfig()}


@pytest.mark.parametrize(
    "order",
    [("--policy.head.type=mean", "--policy.head.width=7"), ("--policy.head.width=7", "--policy.head.type=mean")],
)
def test_another_type_starts_its_block_afresh(order: tuple[str, str], tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text("store: s\npolicy: {head: {type: flow, steps: 3}}\n")
    assert load_config(RunConfig, path, order).policy.head == MeanConfig(7)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("no", "no"),
        ("on", "on"),
        ("2026-11-22", "2026-11-22"),
        ("1:30", "1:30"),
        ("007", "007"),
        ("'12'", "12"),
        ("''", ""),
    ],
)
def test_plain_words_are_text(text: str, value: str) -> None:
    assert load("--name", text).name == value  # YAML 1.1 makes a boolean, a date, 90 or 7 of them


@pytest.mark.parametrize(
    ("text", "value"), [("1e-4", 1e-4), ("3", 3.0), ("-.5", -0.5), (".inf", float("inf")), ("1E3", 1e3)]
)
def test_numbers_are_numbers(text: str, value: float) -> None:
    assert load("--policy.rate", text).policy.rate == value


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--polcy.head.width", "5"], ["`polcy`", "did you mean `policy`?"]),
        (["--policy.head.widht", "5"], ["`policy.head.widht`", "did you mean `width`?"]),
        (["--rate", "5"], ["`rate`", "did you mean `policy.rate`?"]),
        (["--zzz", "5"], ["`zzz`", "known: store, policy"]),
        (["--policy.head.type", "flaw"], ["`policy.head.type`", "'flaw'", "did you mean `flow`?"]),
        (["--policy.head.type", "[1]"], ["`policy.head.type`", "flow, mean"]),
        (["--policy.second.width", "5"], ["`policy.second`", "`type:`", "flow, mean"]),
        (["--heads", "[{type: flow, stepps: 1}]"], ["`heads.0.stepps`", "did you mean `steps`?"]),
        (["--policy.head.width", "wide"], ["`policy.head.width`", "whole number", "'wide'"]),
        (["--policy.head.width", "1.5"], ["`policy.head.width`", "whole number", "1.5"]),
        (["--policy.head.width", "true"], ["`policy.head.width`", "whole number"]),
        (["--policy.head.width", "null"], ["`policy.head.width`", "null"]),
        (["--policy.head.width.x", "1"], ["`policy.head.width`", "whole number"]),
        (["--policy.rate", ".nan"], ["`policy.rate`", "nan"]),
        (["--policy.guidance", "much"], ["`policy.guidance`", "a number"]),
        (["--policy.head.steps", "0"], ["`policy.head`", "1 or more"]),
        (["--policy", "3"], ["`policy`", "block of fields"]),
        (["--precision", "fp8"], ["`precision`", "one of no, bf16"]),
        (["--seeds", "[1, x]"], ["`seeds.1`", "whole number"]),
        (["--seeds", "1"], ["`seeds`", "a list"]),
        (["--betas", "[1]"], ["`betas`", "2 values"]),
        (["--cameras", "[front]"], ["`cameras`", "a mapping"]),
        (["--cameras.front.hight", "1"], ["`cameras.front.hight`", "did you mean `height`?"]),
        (["--shuffle", "yes"], ["`shuffle`", "true or false"]),
        (["--name", "12"], ["`name`", "quotes"]),
        (["--shuffle"], ["`--shuffle`", "needs a value"]),
        (["--shuffle", "--name", "y"], ["`--shuffle`", "needs a value"]),
        (["stray"], ["'stray'"]),
        (["--name", "[a"], ["--name", "YAML"]),
    ],
)
def test_a_mistake_names_the_field_and_what_would_be_right(arguments: list[str], expected: list[str]) -> None:
    with pytest.raises(UsageError) as caught:
        load(*arguments)
    for text in expected:
        assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_field_is_named() -> None:
    with pytest.raises(UsageError, match="`store` is missing"):
        load_config(RunConfig, None)


def test_a_mistake_in_a_file_names_the_file_and_one_on_the_command_line_does_not(tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text("store: s\npolicy: {rte: 1}\n")
    with pytest.raises(UsageError, match=r"run\.yaml: unknown field `policy\.rte`; did you mean `rate`\?"):
        load_config(RunConfig, path)
    path.write_text("store: s\n")
    with pytest.raises(UsageError, match=r"^unknown field `policy\.rte`"):
        load_config(RunConfig, path, ["--policy.rte", "1"])


@pytest.mark.parametrize(
    "text", ["- a\n", "a: [\n", "store: a\nstore: b\n", "store: !!python/object/apply:os.getcwd []\n", "\x00"]
)
def test_a_file_that_is_no_config_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text(text)
    with pytest.raises(UsageError, match=re.escape(str(path))):
        load_config(RunConfig, path)


def test_an_empty_file_is_all_defaults(tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text("# nothing\n")
    assert load_config(RunConfig, path, ["--store", "s"]) == RunConfig(store=Path("s"))


def test_a_missing_file_names_its_nearest_neighbor(tmp_path: Path) -> None:
    (tmp_path / "demo.yaml").write_text("store: s\n")
    with pytest.raises(UsageError, match=r"there is no config .*dmo\.yaml; did you mean `demo\.yaml`\?"):
        load_config(RunConfig, tmp_path / "dmo.yaml")
    with pytest.raises(UsageError, match="there is no config"):
        load_config(RunConfig, tmp_path / "nowhere" / "demo.yaml")


def test_a_write_that_fails_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    atomic_write(path, b"old")

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("os.fsync", full)
        with pytest.raises(DiskError, match=f"{tmp_path}: the disk is full"):
            atomic_write(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
    atomic_write(path, b"new")
    assert path.read_bytes() == b"new"


def test_versions_are_those_of_the_imported_packages() -> None:
    import numpy as np

    import playlearn

    found = versions()
    assert found["playlearn"] == playlearn.__version__
    assert found["numpy"] == np.__version__
    assert {"python", "torch", "mujoco", "robosuite", "lerobot", "diffusers", "transformers"} <= set(found)


def test_the_git_revision_is_a_commit_or_nothing() -> None:
    revision = git_revision()
    assert revision is None or re.fullmatch(r"[0-9a-f]{40}(-dirty)?", revision)
