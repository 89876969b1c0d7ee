"""The report in a real browser: complete, self-contained, and consistent with results.json."""

import io
import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from playlearn.report.intervals import wilson
from playlearn.report.page import Shown, page
from playlearn.report.pictures import beside, draw, encode_film
from tests.fakes import PointConfig, PointEnv

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
CHROMIUM = shutil.which("chromium")


PRIVILEGED = {"training": ["clean labels"], "relabeling": ["object poses"], "goal": []}


def row(episodes: int, won: int, strict: int) -> dict[str, Any]:
    return {
        "episodes": episodes,
        "success_rate": won / episodes,
        "ci95": list(wilson(won, episodes)),
        "strict_rate": strict / episodes,
        "strict_ci95": list(wilson(strict, episodes)),
    }


def policy_rows(*tasks: tuple[int, int, int]) -> dict[str, Any]:
    totals = [sum(column) for column in zip(*tasks, strict=True)]
    named = {name: row(*task) for name, task in zip(("lamp_on", "move <puck>"), tasks, strict=True)}
    return {**row(*totals), "crashed": 0, "tasks": named, "privileged": PRIVILEGED}


RESULTS: dict[str, Any] = {
    "suite": "point_tasks",
    "goal_modality": "image",
    **policy_rows((7, 5, 4), (6, 1, 0)),
    "references": {"expert": policy_rows((7, 7, 7), (6, 6, 5)), "random": policy_rows((7, 1, 0), (6, 0, 0))},
    "redraws": 3,
    "seed": 0,
    "renderer": "numpy",
    "versions": {"playlearn": "0"},
    "git_revision": None,
    "policy": {"name": "policy", "type": "trained", "run": "runs/<script>alert(1)</script>"},
    "config": {"success_hold_steps": 5, "max_steps": 60, "kind": {"type": "tasks"}},
    "seconds": 12.0,
}
CURVES = {"policy": [0.0, 0.2, 0.46], "expert": [0.0, 0.5, 1.0], "random": [0.0, 0.0, 0.08]}


def shown() -> list[Shown]:
    env = PointEnv(PointConfig())
    items = []
    for episode, success in enumerate((True, False, False)):
        env.reset(episode)
        states = [np.array(env.sim_state())]
        for _ in range(12):
            env.step(np.array([0.5, 0.2, 0.0]))
            states.append(np.array(env.sim_state()))
        pictures = draw(env, np.stack(states), states[-1], "front", 96, film=episode < 2)
        reason = "reached" if success else "the puck fell off the table"
        items.append(Shown(episode, "lamp_on", success, reason, 12, pictures))
    return items


@pytest.fixture(scope="module")
def html() -> str:
    return page(RESULTS, CURVES, 10.0, shown(), "")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="the playwright package is not installed")
    if CHROMIUM is None:
        pytest.skip("no chromium on the PATH; on Debian: apt-get install chromium")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def opened(browser: Any, html: str, tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, list[str], list[str]]:
    """The page, its errors, and its network requests."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(html)
    tab, complaints, requests = browser.new_page(viewport={"width": 1200, "height": 900}), [], []
    tab.on("console", lambda message: complaints.append(message.text))
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.on("request", lambda request: requests.append(request.url))
    tab.goto(path.as_uri(), wait_until="load")
    return tab, complaints, [url for url in requests if not url.startswith(("file:", "data:"))]


@pytest.mark.slow
def test_it_loads_without_errors_or_requests(opened: tuple[Any, list[str], list[str]]) -> None:
    _, complaints, requests = opened
    assert complaints == []
    assert requests == []


@pytest.mark.slow
def test_every_picture_is_there(opened: tuple[Any, list[str], list[str]]) -> None:
    """3 episodes of 3 stills each and 2 films: 11 pictures, in the camera's own shape of 24 x 32."""
    sizes = opened[0].eval_on_selector_all("img", "all => all.map(i => [i.naturalWidth, i.naturalHeight])")
    assert len(sizes) == 11
    assert sizes.count([128, 96]) == 9
    assert sizes.count([128 * 2 + 4, 96]) == 2, "films have the goal beside the episode"


@pytest.mark.slow
def test_the_table_matches_the_results(opened: tuple[Any, list[str], list[str]]) -> None:
    """5 of 7, 1 of 6 and 6 of 13, with one decimal; the references beside them."""
    cells = opened[0].eval_on_selector_all(
        "#tasks tbody tr", "all => all.map(r => [...r.cells].map(c => c.innerText.trim()))"
    )
    assert cells == [
        ["lamp_on", "7", "71.4 %", "", "35.9 % – 91.8 %", "57.1 %", "100 %", "14.3 %"],
        ["move <puck>", "6", "16.7 %", "", "3 % – 56.4 %", "0 %", "100 %", "0 %"],
        ["all", "13", "46.2 %", "", "23.2 % – 70.9 %", "30.8 %", "100 %", "7.7 %"],
    ]
    assert opened[0].inner_text("#success .rate") == "46.2 %"
    assert opened[0].inner_text("[data-reference=expert] .rate") == "100 %"
    width, whole = opened[0].eval_on_selector(
        "tr[data-task=''] .bar",
        "b => [b.querySelector('i').getBoundingClientRect().width, b.getBoundingClientRect().width]",
    )
    assert width / whole == pytest.approx(6 / 13, abs=0.01)


@pytest.mark.slow
def test_curves_end_where_the_rates_are(opened: tuple[Any, list[str], list[str]]) -> None:
    """One line a policy; the expert's ends at the top of the plot, above all others."""
    ends = opened[0].eval_on_selector_all(
        "#curves polyline", "all => all.map(l => l.points.getItem(l.points.numberOfItems - 1).y)"
    )
    policy, expert, random = ends
    assert expert == pytest.approx(12, abs=0.1)
    assert expert < policy < random


@pytest.mark.slow
def test_failures_have_pictures_and_reasons(opened: tuple[Any, list[str], list[str]]) -> None:
    tab = opened[0]
    assert tab.locator("#failures figure").count() == 2
    assert tab.locator("#failures figcaption").first.inner_text().endswith("the puck fell off the table")
    assert tab.locator("#successes figure").count() == 1


@pytest.mark.slow
def test_it_fits_a_phone(browser: Any, html: str, tmp_path: Path) -> None:
    """Nothing but the table, which scrolls in its own panel, is wider than a narrow screen."""
    (tmp_path / "report.html").write_text(html)
    tab = browser.new_page(viewport={"width": 390, "height": 800})
    tab.goto((tmp_path / "report.html").as_uri())
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
    tab.close()


def test_text_is_escaped(html: str) -> None:
    assert "<script" not in html
    assert "move &lt;puck&gt;" in html


def test_without_pictures_it_has_a_note() -> None:
    text = page(RESULTS, CURVES, 10.0, [], "No pictures: no headless GL here")
    assert "No pictures: no headless GL here" in text
    assert "<img" not in text


def test_a_film_plays_in_real_time() -> None:
    """5 frames of 0.1 s; the last one stays for a second."""
    frames = [np.full((8, 8, 3), 40 * k, np.uint8) for k in range(5)]
    film = Image.open(io.BytesIO(encode_film(frames, 0.1)))
    assert getattr(film, "n_frames") == 5  # noqa: B009 - PIL gives it to those with several
    durations = []
    for k in range(5):
        film.seek(k)
        film.load()
        durations.append(film.info["duration"])
    assert durations == [100, 100, 100, 100, 1000]


def test_beside_keeps_both_pictures() -> None:
    left, right = np.zeros((4, 5, 3), np.uint8), np.ones((4, 6, 3), np.uint8)
    joined = beside(left, right, gap=2)
    assert joined.shape == (4, 13, 3)
    np.testing.assert_array_equal(joined[:, :5], left)
    np.testing.assert_array_equal(joined[:, 7:], right)


@pytest.mark.parametrize(("won", "tried"), [(0, 10), (1, 10), (5, 10), (10, 10), (64, 100)])
def test_wilson_is_where_the_score_test_rejects(won: int, tried: int) -> None:
    """By definition: at a bound p inside (0, 1), |won/n - p| is 1.96 standard errors of p itself."""
    low, high = wilson(won, tried)
    assert 0 <= low <= won / tried <= high <= 1
    for p in {low, high} - {0.0, 1.0}:
        assert abs(won / tried - p) / math.sqrt(p * (1 - p) / tried) == pytest.approx(1.96, abs=1e-3)
    assert wilson(tried - won, tried) == pytest.approx((1 - high, 1 - low)), "losing is winning, mirrored"


def test_wilson_without_trials_is_the_whole_interval() -> None:
    assert wilson(0, 0) == (0.0, 1.0)
    with pytest.raises(ValueError, match="3 successes in 2 trials"):
        wilson(3, 2)
