"""A store's report in a real browser, as film strips and as card: complete, self-contained and correct."""

import dataclasses
import io
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

from playlearn import cli
from playlearn.errors import RenderError, UsageError
from playlearn.report.lerobot_card import CardFacts, lerobot_card
from playlearn.report.play import SkillAttempt, figures
from playlearn.report.store_page import HEIGHT, WIDTH, heat_map, outline
from playlearn.report.store_report import write_report
from playlearn.report.strips import COLORS, FRAMES, choose, picture, stored_images, strips
from playlearn.rollout import rollout
from playlearn.sim import Environment
from playlearn.store import NativeStore, StoreSpec
from tests.fakes import PointConfig, PointEnv, PointPlayPolicy
from tests.synthetic import make_episode, make_store

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
CHROMIUM = shutil.which("chromium")
SKILLS = ("push <red>", "open drawer:open_loop:mistake", "flip lamp:slip")


def no_environment() -> Environment:
    raise RenderError("no headless OpenGL")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> NativeStore:
    path = tmp_path_factory.mktemp("stores") / "play"
    rng = np.random.default_rng(0)
    episodes = [make_episode(rng, cameras={"front": (24, 36), "wrist": (16, 16)}, seed=seed) for seed in range(3)]
    made = NativeStore.create(path, StoreSpec.of(episodes[0]))
    with made.writer() as writer:
        for episode in episodes:
            writer.append(dataclasses.replace(episode, meta=dataclasses.replace(episode.meta, skills=SKILLS)))
    return made


@pytest.fixture(scope="module")
def written(store: NativeStore, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    for name in ("play.html", "play.json", "play.png", "README.md"):
        write_report(store, folder / name, no_environment)
    return folder


@pytest.fixture(scope="module")
def tab(written: Path) -> Iterator[tuple[Any, list[str]]]:
    """The page, and its errors and network requests."""
    playwright = pytest.importorskip("playwright.sync_api", reason="the playwright package is not installed")
    if CHROMIUM is None:
        pytest.skip("no chromium on the PATH; on Debian: apt-get install chromium")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        opened, complaints = browser.new_page(viewport={"width": 1200, "height": 900}), []
        opened.on("console", lambda message: complaints.append(message.text))
        opened.on("pageerror", lambda error: complaints.append(str(error)))
        opened.on("request", lambda request: complaints.append(request.url))
        opened.goto((written / "play.html").as_uri(), wait_until="load")
        yield opened, [line for line in complaints if not line.startswith(("file:", "data:"))]
        browser.close()


@pytest.mark.slow
def test_it_loads_without_errors_or_requests(tab: tuple[Any, list[str]]) -> None:
    assert tab[1] == []


@pytest.mark.slow
def test_the_tables_match_the_statistics(tab: tuple[Any, list[str]], written: Path, store: NativeStore) -> None:
    play = json.loads((written / "play.json").read_text())
    assert play == json.loads(json.dumps(figures(store)))
    for name, row in play["changes"].items():
        assert tab[0].inner_text(f"#changed [data-group={name}] .count") == str(row["count"])
    for name, row in play["mishaps"].items():
        assert tab[0].inner_text(f"#mishaps [data-mishap={name}] td:nth-child(2)") == str(row["count"])
    assert tab[0].locator("#skills tbody tr").count() == len(play["skills"]) == 3


@pytest.mark.slow
def test_every_picture_is_there(tab: tuple[Any, list[str]]) -> None:
    """Heat maps of the red block and the end effector, 24 random moments, and up to eight strips of ten images each."""
    sizes = tab[0].eval_on_selector_all("img", "all => all.map(i => [i.naturalWidth, i.naturalHeight])")
    assert all(width > 0 for width, _ in sizes)
    assert tab[0].locator("#maps img").count() == 2
    assert tab[0].locator("#moments img").count() == 24
    # Ten pictures 36 wide with 9 gaps of 2; two cameras one above the other and a stripe of 5.
    strips_ = tab[0].eval_on_selector_all("#strips img", "all => all.map(i => [i.naturalWidth, i.naturalHeight])")
    assert strips_ == [[10 * 36 + 9 * 2, 24 + 16 + 5]] * 8


@pytest.mark.slow
def test_it_fits_a_phone(tab: tuple[Any, list[str]]) -> None:
    tab[0].set_viewport_size({"width": 390, "height": 800})
    assert tab[0].evaluate("document.documentElement.scrollWidth") <= 390


def test_text_is_escaped(written: Path) -> None:
    page = (written / "play.html").read_text()
    assert "push &lt;red&gt;" in page
    assert "<red>" not in page


def test_the_card_is_one_that_the_hub_reads(written: Path, store: NativeStore) -> None:
    """YAML between two lines of dashes, then a row for every column of the store."""
    _, front, body = (written / "README.md").read_text().split("---\n", 2)
    facts = yaml.safe_load(front)
    assert facts["license"] == "apache-2.0"
    assert facts["size_categories"] == ["n<1K"]  # 600 steps
    for key, array in store.read(0).arrays().items():
        assert f"| `{key}` |" in body
        assert str(array.dtype) in body


def test_a_card_of_other_peoples_recordings_does_not_call_them_ours(store: NativeStore, tmp_path: Path) -> None:
    """Neither scripted, nor made again by `collect`; those that were collected are both."""
    theirs = dataclasses.replace(store.read(0), meta=dataclasses.replace(store.meta(0), versions={}, actor="unknown"))
    imported = NativeStore.create(tmp_path / "imported", StoreSpec.of(theirs))
    with imported.writer() as writer:
        writer.append(theirs)
    for one, ours in ((store, True), (imported, False)):
        write_report(one, tmp_path / "README.md", no_environment)
        cards = (tmp_path / "README.md").read_text(), lerobot_card(one, {}, {}, CardFacts("play", 1, False, False))
        assert [("Unstructured play" in card) for card in cards] == [ours, ours]
        assert ("collect.yaml" in cards[0]) == ours
        assert ("Recorded elsewhere and imported; by unknown. A policy" in cards[0]) != ours


def test_a_card_of_rewards_needs_no_names(store: NativeStore) -> None:
    features = {"next.reward": {"dtype": "float32", "shape": (1,), "names": None}}
    card = lerobot_card(store, features, {}, CardFacts("play", 2, goals=False, has_picture=False))
    assert "| `next.reward` | (1) | float32 | as it was recorded |" in card
    assert "- `next.reward`" not in card


def test_a_sheet_is_small_and_shows_the_stripes(written: Path) -> None:
    data = (written / "play.png").read_bytes()
    assert len(data) < 300_000
    colors = {color for _, color in Image.open(io.BytesIO(data)).convert("RGB").getcolors(1 << 20) or []}
    for mark in ("slip", "mistake", ""):
        # A palette of 256 may move a color a little.
        assert min(np.abs(np.subtract(color, COLORS[mark])).max() for color in colors) < 12, mark


def test_a_strip_shows_its_own_attempt_from_first_to_last(store: NativeStore) -> None:
    """`tests.synthetic` writes the observation's index into the top left pixel."""
    for strip in strips(store, stored_images(store), ["front"], 4, np.random.default_rng(1)):
        assert strip.steps[0] == strip.attempt.begin
        assert strip.steps[-1] == strip.attempt.end - 1
        assert [int(image[0, 0, 0]) for image in strip.rows[0]] == list(strip.steps)
        assert {int(image[0, 0, 1]) for image in strip.rows[0]} == {strip.attempt.episode}
        assert picture(strip).shape == (24 + 5, 378, 3)


def test_every_mark_that_occurs_is_chosen_once_before_any_twice() -> None:
    marks = [frozenset[str]()] * 30 + [frozenset({"slip"})] * 3 + [frozenset({"mistake"})]
    skill_attempts = [SkillAttempt(k, 0, FRAMES, "x", own, truncated=False) for k, own in enumerate(marks)]
    chosen = choose(skill_attempts, 4, np.random.default_rng(0))
    assert sorted(sorted(one.marks) for one in chosen) == [[], ["mistake"], ["slip"], ["slip"]]
    assert len(choose(skill_attempts, 100, np.random.default_rng(0))) == 34


def test_states_are_rendered_if_there_are_no_images(tmp_path: Path) -> None:
    env = PointEnv(PointConfig())
    env.reset(0)
    outcome = rollout([env], PointPlayPolicy(), [None], seeds=[0], max_steps=80)[0]
    assert outcome.episode is not None
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(outcome.episode))
    with store.writer() as writer:
        writer.append(outcome.episode)
    write_report(store, tmp_path / "drawn.html", lambda: PointEnv(PointConfig()))
    assert 'id="moments"' in (tmp_path / "drawn.html").read_text()


def test_without_a_renderer_it_has_a_note(tmp_path: Path) -> None:
    store = make_store(tmp_path / "play", np.random.default_rng(0), episodes=1)
    write_report(store, tmp_path / "play.html", no_environment)
    page = (tmp_path / "play.html").read_text()
    assert "no headless OpenGL" in page
    assert 'id="moments"' not in page
    with pytest.raises(UsageError, match="no headless OpenGL"):
        write_report(store, tmp_path / "play.png", no_environment)


def test_another_kind_of_file_is_refused(store: NativeStore, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"\*\.html.*\*\.md"):
        write_report(store, tmp_path / "play.pdf", no_environment)


def test_a_heat_map_is_darkest_where_visited_most() -> None:
    image = np.asarray(Image.open(io.BytesIO(heat_map([[0, 1], [100, 25]])))).astype(int).sum(axis=2)
    assert image[1, 0] < image[1, 1] < image[0, 1] < image[0, 0]


def test_an_outline_goes_up_to_the_count_and_back_to_the_ground() -> None:
    """Counts 1 and 2 of at most 2: half the height, then all of it."""
    half, whole = f"{HEIGHT / 2:.1f}", "0.0"
    middle, end, ground = f"{WIDTH / 2:.1f}", f"{WIDTH:.1f}", f"{HEIGHT:.1f}"
    assert outline([1, 2]) == (f"0.0,{ground} 0.0,{half} {middle},{half} {middle},{whole} {end},{whole} {end},{ground}")


def test_the_command_writes_every_requested_report(
    store: NativeStore, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, numbers = tmp_path / "new" / "play.html", tmp_path / "play.json"
    assert cli.main(["info", str(store.path), "--report", str(page), "--report", str(numbers)]) == 0
    assert page.exists()
    assert json.loads(numbers.read_text())["store"]["episodes"] == 3
    assert cli.main(["info", str(store.path), "--report", str(tmp_path / "play.pdf")]) == 2
    assert "*.html" in capsys.readouterr().err
