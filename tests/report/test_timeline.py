"""The timeline of an episode: every settled moment and its label."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from playlearn.errors import StoreError
from playlearn.quantity import Quantities
from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.report.timeline import FRAMES, drawing, timeline
from playlearn.report.view import view_episode
from playlearn.store import NativeStore, StoreSpec
from tests.synthetic import ACHIEVED, FPS, make_episode, make_store


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> NativeStore:
    return make_store(tmp_path_factory.mktemp("line") / "play", np.random.default_rng(0), 2, 300, {"front": (6, 8)})


@pytest.mark.slow
def test_each_moment_is_a_line_through_every_curve_and_named(store: NativeStore) -> None:
    table = RelabelIndex.of_store(store, SettlingConfig(), episodes=[1])
    moments, ends = table.settled(0)
    assert len(moments) >= 4  # segments last 45 to 73 steps
    figure = drawing(store, 1, SettlingConfig())
    curves = [axes for axes in figure.axes if axes.get_ylabel() in (*table.groups(), "gripper", "arm")]
    assert [axes.get_ylabel() for axes in curves] == ["red", "drawer", "lamp", "gripper", "arm"]
    for axes in curves:
        upright = [line.get_xdata()[0] for line in axes.lines if len(line.get_xdata()) == 2]
        np.testing.assert_allclose(upright, moments / FPS)
        spans = [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in axes.patches]
        np.testing.assert_allclose(spans, np.stack([moments, ends], axis=1) / FPS, atol=1e-9)
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    groups = np.array(table.groups())
    for moment, row in zip(moments, table.changed_groups(), strict=True):
        assert f"{moment / FPS:.1f} s: {' + '.join(groups[row])}" in texts
    # The drawer's curve in thresholds of change: 0.2 m is 13.3 times 0.015 m.
    drawn = curves[1].lines[-1].get_ydata()
    opening = store.array(1, "achieved")[:, ACHIEVED.index("drawer.opening")]
    np.testing.assert_allclose(drawn, (opening - opening[0]) / 0.015, rtol=1e-5)


def test_the_frames_are_those_of_the_moments(store: NativeStore) -> None:
    """A synthetic picture's first pixel is its observation's number."""
    moments, _ = RelabelIndex.of_store(store, SettlingConfig(), episodes=[0]).settled(0)
    strip = drawing(store, 0, SettlingConfig()).axes[0]
    shown = [int(cell.images[0].get_array()[0, 0, 0]) for cell in strip.child_axes]
    assert shown == [0, *(moments % 256).tolist()]


def test_a_long_episode_shows_some_of_its_moments(tmp_path: Path) -> None:
    long = make_store(tmp_path / "long", np.random.default_rng(0), 1, 1500, ("front",))
    moments, _ = RelabelIndex.of_store(long, SettlingConfig()).settled(0)
    assert len(moments) > FRAMES
    strip = drawing(long, 0, SettlingConfig()).axes[0]
    assert FRAMES / 2 < len(strip.child_axes) <= FRAMES + 1


def test_view_writes_it_where_a_png_is_asked_for(store: NativeStore, tmp_path: Path) -> None:
    out = tmp_path / "new" / "one.png"
    assert view_episode(store.path, 0, save=out) == out
    with Image.open(out) as picture:
        assert picture.format == "PNG"
        assert picture.width == 1650
    with pytest.raises(StoreError, match="no episode 2"):
        timeline(store, 2, tmp_path / "two.png")


@pytest.mark.slow
def test_what_was_never_seen_achieved_or_settled_can_be_drawn(tmp_path: Path) -> None:
    """A real robot's recording without cameras, in which nothing moved."""
    made = make_episode(np.random.default_rng(0), 60)
    bare = dataclasses.replace(
        made,
        meta=dataclasses.replace(made.meta, achieved_names=(), quantities=Quantities()),
        state=np.zeros_like(made.state),
        achieved=np.zeros((61, 0), np.float32),
    )
    store = NativeStore.create(tmp_path / "bare", StoreSpec.of(bare))
    with store.writer() as writer:
        writer.append(bare)
    figure = drawing(store, 0, SettlingConfig())
    assert [axes.get_ylabel() for axes in figure.axes if axes.get_ylabel()] == ["skill", "gripper", "arm"]
    assert timeline(store, 0, tmp_path / "bare.png").stat().st_size > 1000
