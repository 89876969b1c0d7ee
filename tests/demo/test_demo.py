"""Laws of the demo: stages that are done once, side by side, estimated, and checked."""

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from playlearn.config import load_config
from playlearn.dagger import DaggerConfig
from playlearn.demo import DemoConfig, demo, job
from playlearn.demo.checks import success_problem, training_problem
from playlearn.demo.commands import Done, run_together
from playlearn.demo.config import Cost
from playlearn.demo.job import STAGES
from playlearn.demo.reference import Reference
from playlearn.errors import PlaylearnError, UsageError
from playlearn.training import TrainConfig

ROOT = Path(__file__).parents[2]
PYTHON = (sys.executable, "-c")


def test_commands_run_side_by_side_and_are_heard(tmp_path: Path) -> None:
    """Each waits for a file that the other one makes: one after the other they would never end."""

    def meet(mine: str, other: str) -> str:
        paths = f"Path({str(tmp_path / mine)!r}).touch(); other = Path({str(tmp_path / other)!r})"
        wait = "while not other.exists(): time.sleep(0.01)"
        return f"import time; from pathlib import Path; {paths}\n{wait}\nprint({mine!r})"

    heard: list[str] = []
    ticks: list[int] = []
    commands = {"a": [meet("one", "two")], "b": [meet("two", "one")]}
    done = run_together(commands, heard.append, lambda: ticks.append(1), PYTHON)
    assert {name: one.code for name, one in done.items()} == {"a": 0, "b": 0}
    assert sorted(heard) == ["a | one", "b | two"]
    assert ticks
    assert all(one.core_seconds > 0 for one in done.values())


@pytest.mark.slow
def test_where_one_fails_the_others_are_stopped() -> None:
    done = run_together(
        {"bad": ["raise SystemExit(3)"], "long": ["import time; time.sleep(10_000)"]},
        lambda _: None,
        lambda: None,
        PYTHON,
    )
    assert done["bad"].code == 3
    assert done["long"].code == -15


@pytest.mark.slow
def test_what_is_optional_may_fail_alone() -> None:
    commands = {"film": ["raise SystemExit(3)"], "play": ["import time; time.sleep(1)"]}
    done = run_together(commands, lambda _: None, lambda: None, PYTHON, optional=("film",))
    assert {name: one.code for name, one in done.items()} == {"film": 3, "play": 0}


def metrics(run: Path, *losses: float, every: int = 10) -> None:
    run.mkdir(parents=True, exist_ok=True)
    lines = [json.dumps({"step": every * i, "val/head": loss, "val/achieved": loss}) for i, loss in enumerate(losses)]
    (run / "metrics.jsonl").write_text("\n".join(lines) + "\n")


def test_a_training_is_checked_by_its_last_loss(tmp_path: Path) -> None:
    metrics(tmp_path / "run", 1.0, 0.2)
    assert training_problem("the policy", tmp_path / "run", "head", 0.2, 10) is None
    why = training_problem("the policy", tmp_path / "run", "head", 0.1, 5000)
    assert why is not None
    assert "held-out loss is 0.2; above 0.1 no goal is reached" in why
    assert "it made 10 updates, the demo's config asks for 5000" in why
    assert "too little play" in str(training_problem("the policy", tmp_path / "run", "head", 0.1, 10))
    assert training_problem("the policy", tmp_path / "run", "head", float("inf"), 10) is None
    metrics(tmp_path / "run", 1.0, float("nan"))
    assert training_problem("the policy", tmp_path / "run", "head", 0.5, 10) is not None


def evaluated(success: tuple[float, float, float], random: tuple[float, float, float]) -> dict[str, Any]:
    def rates(rate: tuple[float, float, float]) -> dict[str, Any]:
        return {"success_rate": rate[0], "ci95": list(rate[1:]), "episodes": 102}

    return {**rates(success), "references": {"random": rates(random)}}


def test_a_policy_no_better_than_random_is_reported() -> None:
    """By the intervals: 4.9 % (2.1 to 11.0) is not above a random policy at 3.9 % (1.5 to 9.7)."""
    why = success_problem(evaluated((0.049, 0.021, 0.11), (0.039, 0.015, 0.097)))
    assert why is not None
    assert "4.9% of 102 goal images, a random policy 3.9%" in why
    assert success_problem(evaluated((0.6, 0.5, 0.7), (0.039, 0.015, 0.097))) is None


class Commands:
    """Stands in for `run_together`: writes what the commands would leave."""

    def __init__(self, out: Path, state: float = 0.08, encoder: float = 0.2, success: float = 0.8) -> None:
        self.out, self.losses, self.success = out, {"state": state, "encoder": encoder}, success
        self.called: list[list[str]] = []
        self.given: dict[str, list[str]] = {}

    def __call__(
        self, commands: Mapping[str, Sequence[str]], say: Callable[[str], None], tick: Callable[[], None], **_: object
    ) -> dict[str, Done]:
        self.called.append(sorted(commands))
        self.given |= {name: list(arguments) for name, arguments in commands.items()}
        if "policy" in commands:
            for name, loss in self.losses.items():
                metrics(self.out / name, 1.0, loss, every=50)
        if "film" in commands:
            (self.out / "preview").mkdir()
            (self.out / "preview" / "report.html").touch()
        if "eval" in commands:
            (self.out / "eval").mkdir()
            rate = (self.success, self.success - 0.1, self.success + 0.1)
            results = evaluated(rate, (0.03, 0.01, 0.08))
            (self.out / "eval" / "results.json").write_text(json.dumps(results))
        tick()
        return {name: Done(0, 2.0, 3.0) for name in commands}


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., tuple[Commands, list[str]]]:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(job, "measure", lambda: Reference(2.0, 1.0))
    monkeypatch.setattr(job, "join_runs", lambda *_: None)
    monkeypatch.setattr(job, "available_cores", lambda: 2)

    def go(steps: int | None = None, **how: float) -> tuple[Commands, list[str]]:
        fake, printed = Commands(tmp_path / "demo", **how), list[str]()
        monkeypatch.setattr(job, "run_together", fake)
        costs = {name: Cost(simulation=10, learning=20) for name in STAGES}
        config = DemoConfig(state_loss=0.1, encoder_loss=0.5, costs=costs)
        try:
            demo(config, tmp_path / "demo", steps=steps, say=printed.append)
        except PlaylearnError as error:
            printed.append(f"ERROR {error}")
        return fake, printed

    return go


def test_every_stage_is_done_once(run: Callable[..., Any], tmp_path: Path) -> None:
    first, printed = run()
    assert first.called == [["film", "play"], ["encoder", "policy"], ["dagger"], ["eval"]]
    record = json.loads((tmp_path / "demo" / "demo.json").read_text())
    assert list(record["stages"]) == list(STAGES)
    assert record["stages"]["train"]["core_seconds"] == {"policy": 3.0, "encoder": 3.0}
    assert any("preview/report.html" in line for line in printed), "the film is announced while play is collected"
    again, printed = run()
    assert again.called == []
    assert sum("done already" in line for line in printed) == len(STAGES)


def test_one_that_was_interrupted_in_its_first_stage_goes_on(
    run: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some play lies there and no stage is done: that is still a demo's folder."""

    def interrupted(*_: object, **__: object) -> None:
        (tmp_path / "demo" / "play").mkdir()
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.chdir(ROOT)
        patch.setattr(job, "measure", lambda: Reference(2.0, 1.0))
        patch.setattr(job, "run_together", interrupted)
        costs = {name: Cost(simulation=10, learning=20) for name in STAGES}
        with pytest.raises(KeyboardInterrupt):
            demo(DemoConfig(state_loss=0.1, encoder_loss=0.5, costs=costs), tmp_path / "demo", say=lambda _: None)
    fake, printed = run()
    assert len(fake.called) == len(STAGES)
    assert not printed[-1].startswith("ERROR")


def test_the_time_is_estimated_from_the_reference(run: Callable[..., Any]) -> None:
    """10 times 2 s and 20 times 1 s of core are 20 s on two cores, for each of four stages."""
    _, printed = run()
    assert any("train" in line and "about 20 s" in line for line in printed)
    assert any("all" in line and "about 80 s, on 2 cores" in line for line in printed)


@pytest.mark.parametrize(
    ("how", "stages", "message"),
    [
        ({"state": 0.11}, 2, "the demo stops here: the state policy: its held-out loss is 0.11"),
        ({"encoder": 0.7}, 2, "the demo stops here: the image encoder"),
        ({"success": 0.1}, 4, "it is no better than random"),
    ],
)
def test_a_stage_that_came_to_nothing_ends_in_an_error(
    how: dict[str, float], stages: int, message: str, run: Callable[..., Any]
) -> None:
    fake, printed = run(**how)
    assert len(fake.called) == stages
    assert message in printed[-1]
    assert printed[-1].startswith("ERROR")


def test_fewer_updates_are_handed_on(run: Callable[..., Any]) -> None:
    fake, _ = run(steps=50)
    assert "--steps=50" in fake.given["policy"]
    assert "--steps=50" in fake.given["encoder"]
    assert "--updates=50" in fake.given["dagger"]


def test_another_config_or_a_strange_folder_is_refused(run: Callable[..., Any], tmp_path: Path) -> None:
    run()
    _, printed = run(steps=7)
    assert "begun with another steps" in printed[-1]
    (tmp_path / "strange").mkdir()
    (tmp_path / "strange" / "x").touch()
    with pytest.raises(UsageError, match="holds no demo"):
        demo(DemoConfig(), tmp_path / "strange", say=lambda _: None)


def test_the_shipped_config_is_whole() -> None:
    """Every stage has a cost, every config it names loads, state policy and encoder fit together."""
    config = load_config(DemoConfig, ROOT / "configs" / "demo.yaml")
    assert set(config.costs) == set(STAGES)
    state, encoder = (load_config(TrainConfig, ROOT / path) for path in (config.state, config.encoder))
    assert state.policy.trunk == encoder.policy.trunk
    assert state.policy.head == encoder.policy.head
    assert state.policy.chunk == encoder.policy.chunk
    assert state.max_minutes is None
    assert encoder.max_minutes is None
    assert load_config(DaggerConfig, ROOT / config.dagger).goal == "image"
    assert (ROOT / config.preview / "policy").is_dir()
    assert 0 < config.state_loss < 1
    assert 0 < config.encoder_loss < 10
