"""Laws of the estimated time: it is right early, shown soon, and in minutes if it is long."""

import heapq
import re
from collections.abc import Iterator

import pytest

from playlearn.report import progress as module
from playlearn.report.progress import Pace, Progress, format_seconds


class Clock:
    now = 1000.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[Clock]:
    fake = Clock()
    monkeypatch.setattr(module, "time", fake)
    return fake


def left(line: str) -> float:
    """The seconds left in a line."""
    found = re.search(r"about (\d+) (s|min) left", line)
    assert found is not None, line
    return float(found[1]) * (60 if found[2] == "min" else 1)


def test_the_first_line_comes_soon_and_the_others_now_and_then(
    clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    """A piece a second, 40 of them: lines after 5, 20 and 35 seconds and at the end, each right to the second."""
    with Progress("work", 40, "piece") as progress:
        for done in range(1, 41):
            clock.now += 1
            progress.to(done, "well")
    assert capsys.readouterr().err.splitlines() == [
        "work: 5 of 40 pieces, well, about 35 s left",
        "work: 20 of 40 pieces, well, about 20 s left",
        "work: 35 of 40 pieces, well, about 5 s left",
        "work: 40 of 40 pieces, well, took 40 s",
    ]


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_the_start_of_workers_spoils_no_estimate(
    workers: int, clock: Clock, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """10 s of imports, pieces of 4 to 6 s: every estimate is right to a piece and the fifth by which they differ."""
    monkeypatch.setattr(module, "EVERY", 0.0)
    begun, pieces = clock.now, 60
    free = [begun + 10.0] * workers
    ends = []
    for piece in range(pieces):
        took = 4.0 + piece % 3
        start = heapq.heappop(free)
        heapq.heappush(free, start + took)
        ends.append((start + took, took))
    estimates: list[tuple[float, float]] = []
    with Progress("collect", pieces, "episode", workers=workers) as progress:
        for done, (end, took) in enumerate(sorted(ends), 1):
            clock.now = end
            progress.to(done, seconds=took)
            line = capsys.readouterr().err
            if done < pieces:
                estimates.append((left(line), max(ends)[0] - end))
    for estimate, truth in estimates:
        assert abs(estimate - truth) <= 6 + 0.2 * truth + (30 if truth > 120 else 0), "rounded to a minute above two"


def test_by_the_clock_alone_the_start_counts_no_more_after_the_second_piece(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """20 s until the first of 11, then 2 s each, after an earlier run's 5 which say nothing of the pace."""
    monkeypatch.setattr(module, "EVERY", 0.0)
    with Progress("work", 16, "piece", begun=5) as progress:
        clock.now += 20
        progress.to(6)
        assert left(capsys.readouterr().err) == pytest.approx(10 * 20, abs=30)  # in minutes
        clock.now += 2
        progress.to(7)
    assert left(capsys.readouterr().err) == 9 * 2


def test_who_knows_better_says_what_is_left(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    with Progress("train", 100.0, "%") as progress:
        clock.now += 6
        progress.to(1.0, "step 3", left=1234.0)
        clock.now += 60
        progress.to(1.0, "step 3", left=float("nan"))
    assert capsys.readouterr().err.splitlines() == [
        "train: 1 %, step 3, about 21 min left",
        "train: 1 %, step 3, time left not known yet",
    ]


def test_a_pace_forgets_the_first_ones_and_what_was_held_up() -> None:
    """The first two take 30 and 3 s, the others 0.1 s but one of an hour, which counts as ten of them."""
    pace = Pace(warmup=2)
    assert pace.seconds() != pace.seconds(), "not a number while nothing is known"
    pace.add(30.0)
    assert pace.seconds() == 30.0
    pace.add(3.0)
    for _ in range(9):
        pace.add(0.1)
    assert pace.seconds() == pytest.approx(0.1)
    pace.add(3600.0)
    assert pace.seconds() == pytest.approx((9 * 0.1 + 1.0) / 10)
    for _ in range(100):
        pace.add(0.2)
    assert pace.seconds() == pytest.approx(0.2), "the machine is slower now"


def test_time_is_said_as_people_say_it() -> None:
    assert [format_seconds(seconds) for seconds in (0.4, 119.6, 121.0, 5400.0)] == ["0 s", "120 s", "2 min", "90 min"]
