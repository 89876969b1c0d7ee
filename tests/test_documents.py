"""What README.md and CONTRIBUTING.md show runs as it stands there, and they name every room."""

import contextlib
import io
import pkgutil
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import gymnasium
import numpy as np
import pytest
import torch

import playlearn
from playlearn.policies.heads import HeadConfig
from playlearn.relabeling import GoalSamplerConfig
from tests.shares import often

ROOT = Path(__file__).resolve().parents[1]
README, CONTRIBUTING = (ROOT / name for name in ("README.md", "CONTRIBUTING.md"))


def blocks(document: Path, heading: str) -> list[str]:
    """The Python of a section."""
    section = document.read_text().split(f"## {heading}\n")[1].split("\n## ")[0]
    return re.findall(r"```python\n(.*?)```", section, re.DOTALL)


def run(code: str, name: str = "shown") -> dict[str, object]:
    """Execute a block in a module of its own, with nothing in it."""
    module = ModuleType(name)
    sys.modules[name] = module  # dataclasses look their module up
    exec(code, module.__dict__)  # noqa: S102 - our own text
    return module.__dict__


@pytest.fixture
def registries() -> Iterator[None]:
    """What a block registers is known in this test only."""
    yield
    GoalSamplerConfig.get_known_choices().pop("half", None)
    HeadConfig.get_known_choices().pop("linear", None)


@pytest.mark.usefixtures("registries")
def test_the_goal_sampler_that_contributing_shows_works() -> None:
    (code,) = blocks(CONTRIBUTING, "A goal sampler in ten lines")
    run(code)
    half = GoalSamplerConfig.get_choice_class("half")().build()
    # Seven and two steps remain of ten: the goal is 1 + 3 and 1 + 0 steps ahead.
    index = SimpleNamespace(lengths=np.array([10]))
    assert half.draw(index, np.array([0, 0]), np.array([3, 8]), np.zeros((2, 4))).tolist() == [7, 9]


@pytest.mark.usefixtures("registries")
def test_the_head_that_contributing_shows_works() -> None:
    (code,) = blocks(CONTRIBUTING, "A head in ten lines")
    run(code)
    linear = HeadConfig.get_choice_class("linear")().build(8, 4, 2)
    chunk = linear.sample(torch.zeros(3, 8), torch.Generator())
    assert chunk.shape == (3, 4, 2)
    loss, _ = linear.loss(torch.zeros(3, 8), chunk.detach(), torch.ones(3, 4, dtype=torch.bool), torch.Generator())
    assert loss.item() == 0.0  # its own prediction is what it is asked to predict


@pytest.mark.parametrize(
    ("document", "ignored"),
    [(README, "INP001,F401"), (CONTRIBUTING, "INP001,ANN")],  # an import that registers; methods of robosuite's
    ids=["README", "CONTRIBUTING"],
)
def test_what_is_shown_would_pass_the_linter(document: Path, ignored: str, tmp_path: Path) -> None:
    shown = re.findall(r"```python\n(.*?)```", document.read_text(), re.DOTALL)
    assert len(shown) >= 3
    for number, code in enumerate(shown):
        (tmp_path / f"shown_{number}.py").write_text(code)
    ours = 'lint.isort.known-first-party=["playlearn"]'
    config = ["--config", str(ROOT / "pyproject.toml"), "--config", ours]
    command = [sys.executable, "-m", "ruff", "check", *config, "--ignore", ignored, "."]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_the_loop_that_readme_shows_reaches_its_goal_image(monkeypatch: pytest.MonkeyPatch) -> None:
    """As printed, and from other starts: an open drawer and a lit lamp, through a dozen contacts."""
    monkeypatch.chdir(ROOT)
    loop, *_ = blocks(README, "In Python")
    assert loop.count("seed=0") == 1

    def reached(seed: int) -> bool:
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            run(loop.replace("seed=0", f"seed={seed}"))
        return bool(re.fullmatch(r"goal reached after \d+ steps\n", printed.getvalue()))

    assert often(map(reached, range(5)))


def test_the_training_examples_that_readme_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    _, code, _ = blocks(README, "In Python")
    assert run(code)["batch"].action.shape[:2] == (64, 8)  # type: ignore[attr-defined]


@pytest.mark.slow
def test_the_gymnasium_environment_that_readme_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    *_, code = blocks(README, "In Python")
    shown = run(code)
    assert isinstance(shown["env"], gymnasium.Env)
    assert "goal_front" in shown["observation"]["pixels"]  # type: ignore[index]


def rooms() -> set[str]:
    return {module.name for module in pkgutil.iter_modules(playlearn.__path__)}


def test_readme_has_every_room_in_its_table() -> None:
    table = README.read_text().split("## Where things are\n")[1]
    rows = [row.split("|")[1] for row in table.splitlines() if row.startswith("| `playlearn/")]
    named = [name.removeprefix("playlearn/") for row in rows for name in re.findall(r"`([^`]+)`", row)]
    assert sorted(named) == sorted(rooms())


def test_contributing_draws_the_layers_that_import_linter_holds() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    (contract,) = project["tool"]["importlinter"]["contracts"]
    drawn = re.findall(
        r"^    (\S.*)$", CONTRIBUTING.read_text().split("import-linter holds it:\n")[1].split("A new")[0], re.MULTILINE
    )
    assert drawn == [re.sub(r"[()]", "", layer) for layer in contract["layers"]]


def test_the_commands_that_readme_shows_are_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each line of the tour is understood, and names files that are there."""
    from playlearn.cli import parse

    monkeypatch.chdir(ROOT)
    tour = README.read_text().split("## Commands\n")[1].split("```")[1]
    lines = [line.split("#")[0].split(">")[0].split() for line in tour.splitlines() if line.startswith("playlearn ")]
    assert len(lines) > 20
    for words in lines:
        arguments = parse(words[1:])
        for name in ("config", "suite"):
            path = getattr(arguments, name, None)
            assert path is None or path.name == "my.yaml" or path.is_file(), words
