"""Benchmarks measure what their names say; the figures themselves are not tested."""

import json
import math
import os
from dataclasses import replace
from inspect import isgenerator
from pathlib import Path

import numpy as np
import pytest

from playlearn.bench import BENCHMARKS, Figure, Size, run
from playlearn.bench import collect as recording
from playlearn.bench import data as reading
from playlearn.bench.base import rates
from playlearn.bench.envs import actions
from playlearn.bench.render import ssim
from playlearn.cli import main
from playlearn.collection import collect, job
from playlearn.data import DataConfig, PlayDataset
from playlearn.errors import PlaylearnError, UsageError
from playlearn.relabeling import UniformConfig
from playlearn.store import NativeStore
from tests.bench.rows import breaks, two_rows
from tests.fakes import PointConfig, PointPlayPolicy

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample"
SLOW = ("collect", "data", "render", "start", "threads", "train", "workers")
APART = (
    "collect",
    "render",
)  # robosuite draws in them; the others are measured in this process, which has LeRobot's imports
TINY = Size(steps=2, rounds=1, episodes=4, envs=("lift",), store=SAMPLE)


@pytest.mark.filterwarnings("ignore")  # what LeRobot and the packages below it warn of is theirs to fix
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in sorted(BENCHMARKS)]
)
def test_every_figure_is_beside_its_peer_and_its_limit(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    size, heard = replace(TINY, out=tmp_path), list[Figure]()
    if name in APART:
        monkeypatch.delenv("MUJOCO_GL", raising=False)  # as before any rendering
        figures = run([name], size, heard.append)
        assert heard == figures
    else:
        if name == "workers":  # how many there are makes no difference to the figure's form
            monkeypatch.setattr(
                "playlearn.bench.workers.collect", lambda config, out, workers: collect(config, out, workers=0)
            )
        figures = list(BENCHMARKS[name](size))
    assert figures
    for figure in figures:
        assert math.isfinite(figure.value)
        assert figure.value > 0
        for other, ratio in ((figure.peer_value, figure.ratio), (figure.limit_value, figure.of_limit)):
            assert (other is None) == (ratio is None)
            assert other is None or ratio == pytest.approx(figure.value / other)
        assert figure.line().startswith(figure.name)
    if name == "render":
        alike = [figure for figure in figures if figure.unit == "SSIM"]
        assert len(alike) == 2  # two cameras
        assert min(figure.value for figure in alike) > 0.85  # a wrong light or a missing part is worse than this
        assert {path.name for path in tmp_path.iterdir()} == {"lift.png"}


def test_nothing_is_measured_before_it_is_requested() -> None:
    for measure in BENCHMARKS.values():
        assert isgenerator(measure(TINY))


def test_what_is_recorded_is_counted_in_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job, "play_policy_for", lambda *_: PointPlayPolicy())
    config = replace(recording.collect_config((), TINY), environment=PointConfig())
    collect(config, tmp_path / "play", workers=0)
    steps, seconds = recording._ours(config, tmp_path / "play")
    assert steps == 2
    assert seconds > 0


def test_batches_are_full_and_go_on_with_the_next_epoch() -> None:
    dataset = PlayDataset(NativeStore.open(SAMPLE), DataConfig(goals=UniformConfig(horizon=5.0), val_fraction=0))
    batches = reading._our_batches(dataset)
    epoch = len(dataset) // reading.EXAMPLES
    sizes = {len(next(batches).action) for _ in range(epoch + 1)}
    assert sizes == {reading.EXAMPLES}


def test_each_figure_is_reported_as_it_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Also within one benchmark, across processes; stderr says what is being measured."""
    monkeypatch.setitem(BENCHMARKS, "rows", two_rows)
    shown = run(["rows"], Size(out=tmp_path), lambda _: (tmp_path / "heard").touch())
    assert [figure.name for figure in shown] == ["first", "second"]
    assert shown[0].value != os.getpid()
    assert shown[1].value == 1.0, "it had been heard before the second was measured"
    assert "bench: rows" in capfd.readouterr().err


def test_a_failing_benchmark_is_reported_with_its_earlier_figures(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(BENCHMARKS, "rows", breaks)
    heard: list[Figure] = []
    with pytest.raises(PlaylearnError, match="exit code 1"):
        run(["rows"], Size(), heard.append)
    assert [figure.name for figure in heard] == ["first"]
    assert "ZeroDivisionError: in the benchmark" in capfd.readouterr().err


def test_stopping_early_leaves_no_process_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BENCHMARKS, "rows", two_rows)
    processes: list[int] = []

    def leave(figure: Figure) -> None:
        processes.append(int(figure.value))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(["rows"], Size(out=tmp_path), leave)
    with pytest.raises(ProcessLookupError):
        os.kill(processes[0], 0)


def test_rates_are_medians_and_the_first_turn_only_warms_up() -> None:
    seconds = iter([100.0, 1.0, 2.0, 4.0])
    assert rates({"ours": lambda: (8, next(seconds))}, rounds=3) == {"ours": 4.0}


def test_ssim_of_an_image_with_itself_is_one_and_falls_with_what_is_lost() -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (32, 32, 3), dtype=np.uint8)
    assert ssim(image, image) == pytest.approx(1.0)
    brighter = np.clip(image.astype(int) + 20, 0, 255).astype(np.uint8)
    assert ssim(image, image[::-1]) < 0.3 < ssim(image, brighter) < 1.0


def test_the_actions_are_the_same_for_all_and_within_bounds() -> None:
    np.testing.assert_array_equal(actions(50), actions(50))
    assert np.abs(actions(200)).max() <= 1


def test_an_unknown_benchmark_is_named_with_the_nearest() -> None:
    with pytest.raises(UsageError, match=r"'rendr'.*render"):
        run(["rendr"], TINY, lambda _: None)


def test_the_command_prints_json(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    made = Figure.beside("speed", "m/s", {"ours": 6.0, "peer": 2.0, "limit": 12.0}, "a snail", "light")
    monkeypatch.setattr("playlearn.bench.run", lambda _names, _size, say: (say(made), [made])[1])
    assert main(["bench", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == [
        {
            "name": "speed",
            "value": 6.0,
            "unit": "m/s",
            "peer": "a snail",
            "peer_value": 2.0,
            "ratio": 3.0,
            "limit": "light",
            "limit_value": 12.0,
            "of_limit": 0.5,
        }
    ]
    assert main(["bench"]) == 0
    assert "3.00 x a snail (2)" in capsys.readouterr().out
