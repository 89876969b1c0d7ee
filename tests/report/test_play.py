"""The statistics of a store, each in a case that can be counted by hand."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from playlearn.episode import Array, Episode, EpisodeMeta
from playlearn.errors import UsageError
from playlearn.quantity import Quantities
from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.report.play import SkillAttempt, attempts, figures
from playlearn.store import NativeStore, StoreSpec
from tests.synthetic import make_episode, make_store

STATE = ("eef.x", "eef.y", "eef.z", "gripper.opening")
ACTION = ("dx", "dy", "dz", "gripper")


def episode(skill: Sequence[str], **arrays: Array) -> Episode:
    """An episode in which nothing moves, with these annotations; arrays replace its fields."""
    steps, skills = len(skill), tuple(dict.fromkeys(skill))
    meta = EpisodeMeta(
        environment={"type": "none"},
        state_names=STATE,
        achieved_names=("red.x", "red.y", "lamp.on"),
        action_names=ACTION,
        fps=10.0,
        seed=0,
        actor="player",
        skills=skills,
    )
    fields: dict[str, Any] = {
        "state": np.zeros((steps + 1, 4), np.float32),
        "achieved": np.zeros((steps + 1, 3), np.float32),
        "sim_state": np.zeros((steps + 1, 1)),
        "time": np.arange(steps + 1) / 10,
        "action": np.zeros((steps, 4), np.float32),
        "expert_action": np.zeros((steps, 4), np.float32),
        "intervention": np.zeros(steps, np.bool_),
        "skill": np.array([skills.index(name) for name in skill], np.int16),
    }
    return Episode(meta=meta, **{**fields, **arrays})


def stored(path: Path, *episodes: Episode) -> NativeStore:
    store = NativeStore.create(path, StoreSpec.of(episodes[0]))
    with store.writer() as writer:
        for one in episodes:
            writer.append(one)
    return store


def test_an_attempt_is_a_skill_from_its_first_step_to_its_last(tmp_path: Path) -> None:
    """Marks do not split an attempt; giving up and starting again do. A truncated attempt has not failed."""
    annotations = ["lift", "lift:mistake", "lift", "place:open_loop", "place:open_loop:gave_up", "place", "place:again"]
    found = attempts(stored(tmp_path / "play", episode(annotations)))
    assert found == [
        SkillAttempt(0, 0, 3, "lift", frozenset({"mistake"}), truncated=False),
        SkillAttempt(0, 3, 5, "place", frozenset({"open_loop", "gave_up"}), truncated=False),
        SkillAttempt(0, 5, 6, "place", frozenset(), truncated=False),
        SkillAttempt(0, 6, 7, "place", frozenset(), truncated=True),
    ]
    play = figures(stored(tmp_path / "again", episode(annotations)))
    assert play["attempts"] == {"count": 4, "succeeded": 2, "failed": 1, "truncated": 1, "unknown": 0}
    assert play["mishaps"]["mistake"] == {"count": 1, "succeeded": 1, "failed": 0, "truncated": 0, "unknown": 0}
    assert play["skills"]["place"]["marks"]["open_loop"] == 1
    assert play["store"]["skills"] == {"lift": 1, "place": 1}, "`playlearn info` names skills, not marks"
    assert play["skills"]["place"]["seconds"]["high"] == pytest.approx(0.2), "two steps at 10 Hz"
    assert play["steps"] == pytest.approx({"mistake": 1 / 7, "open_loop": 2 / 7})


@pytest.mark.parametrize(
    ("grip", "opening", "missed"),
    [
        ([-1, 1, 1, 1, -1, -1], [0.08, 0.08, 0.03, 0.0, 0.0, 0.04, 0.08], True),  # closed on nothing, opened again
        ([-1, 1, 1, 1, -1, -1], [0.08, 0.08, 0.05, 0.04, 0.04, 0.06, 0.08], False),  # held something and let it go
        ([1, 1, 1, 1, 1, 1], [0.0] * 7, False),  # travels with closed fingers, as for a push
    ],
)
def test_a_grasp_is_missed_where_fingers_close_on_nothing_and_open_again(
    tmp_path: Path, grip: list[int], opening: list[float], missed: bool
) -> None:
    action, state = np.zeros((6, 4), np.float32), np.zeros((7, 4), np.float32)
    action[:, 3], state[:, 3] = grip, opening
    store = stored(tmp_path / "play", episode(["lift"] * 6, action=action, state=state))
    assert ("missed_grasp" in attempts(store)[0].marks) == missed


def test_changes_are_those_of_relabeling(tmp_path: Path) -> None:
    store = make_store(tmp_path / "play", np.random.default_rng(0), episodes=3)
    play = figures(store)
    table = RelabelIndex.of_store(store, SettlingConfig())
    assert {name: row["count"] for name, row in play["changes"].items()} == table.change_counts()
    assert play["settled"]["moments"] == len(table.moments) > 5
    # Three episodes of 200 steps at 20 Hz are half a minute.
    assert play["settled"]["per_minute"] == pytest.approx(2 * len(table.moments))
    assert sum(play["settled"]["histogram"]["counts"]) == len(table.moments)


def test_seconds_between_changes_are_counted_from_one_to_the_next(tmp_path: Path) -> None:
    """A lamp that goes on at 2 s, off at 5 s and on at 9 s: 3 s and 4 s lie between."""
    achieved = np.zeros((121, 3), np.float32)
    achieved[20:50, 2] = achieved[90:, 2] = 1
    between = figures(stored(tmp_path / "play", episode(["x"] * 120, achieved=achieved)))["changes"]
    assert between["lamp"]["count"] == 3
    assert (between["lamp"]["seconds_between"]["low"], between["lamp"]["seconds_between"]["high"]) == (3, 4)
    assert between["red"]["count"] == 0
    assert between["red"]["seconds_between"]["median"] is None


def test_a_map_has_y_upwards_and_x_to_the_right(tmp_path: Path) -> None:
    """The red block spends 30 moments at the left top and 11 at the right bottom; the end effector stays in between."""
    achieved = np.zeros((41, 3), np.float32)
    achieved[:30, :2], achieved[30:, :2] = (-0.2, 0.1), (0.2, -0.1)
    play = figures(stored(tmp_path / "play", episode(["x"] * 40, achieved=achieved)))["heat_maps"]
    red, hand = (np.array(play["maps"][name]["counts"]) for name in ("red", "end effector"))
    assert (red[0, 0], red[-1, -1], red.sum()) == (30, 11, 41)
    assert hand.sum() == hand.max() == 41
    assert play["maps"]["red"]["coverage"] == pytest.approx(2 / 3), "two of the three cells where anything was"
    # Twice as wide as high, in square cells.
    assert red.shape == (14, 28)


def test_an_end_effector_that_stands_still_is_idle(tmp_path: Path) -> None:
    """30 of 40 steps at rest, then 10 of 1 cm at 10 Hz: 0.1 m/s."""
    state = np.zeros((41, 4), np.float32)
    state[31:, 0] = 0.01 * np.arange(1, 11)
    play = figures(stored(tmp_path / "play", episode(["x"] * 40, state=state)))["end_effector"]
    assert play["idle"] == pytest.approx(0.75)
    assert play["speed"]["high"] == pytest.approx(0.1, rel=1e-4)
    assert play["speed"]["mean"] == pytest.approx(0.025, rel=1e-4)


def test_noise_is_the_executed_action_minus_the_label(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    play = figures(make_store(tmp_path / "play", rng, episodes=4))["actions"]
    # `tests.synthetic` adds a spread of 0.05 and clips, which takes a little of it away.
    assert [row["noise"] for row in play["dimensions"].values()] == pytest.approx([0.05] * 4, rel=0.1)
    assert all(sum(row["executed"]) == sum(row["label"]) == 800 for row in play["dimensions"].values())
    assert all(row["edges"] == [-1.0, 1.0] for row in play["dimensions"].values())


def test_actions_of_any_unit_are_all_counted(tmp_path: Path) -> None:
    """In degrees, of which most lie beyond 1."""
    played = make_episode(np.random.default_rng(0))
    meta = dataclasses.replace(played.meta, quantities=Quantities())
    degrees = {name: getattr(played, name) * np.float32(90) for name in ("action", "expert_action")}
    play = figures(stored(tmp_path / "play", dataclasses.replace(played, meta=meta, **degrees)))
    for row in play["actions"]["dimensions"].values():
        assert sum(row["executed"]) == sum(row["label"]) == 200
        assert row["edges"][1] > 45


def test_a_store_without_annotations_or_end_effector_has_the_other_statistics(tmp_path: Path) -> None:
    played = make_episode(np.random.default_rng(0))
    meta = dataclasses.replace(played.meta, skills=(), state_names=("a", "b", "c", "d"))
    play = figures(stored(tmp_path / "play", dataclasses.replace(played, meta=meta, skill=np.zeros(200, np.int16))))
    assert play["skills"] == {}
    assert play["end_effector"] == {}
    assert set(play["heat_maps"]["maps"]) == {"red"}


def test_an_empty_store_is_refused(tmp_path: Path) -> None:
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(make_episode(np.random.default_rng(0))))
    with pytest.raises(UsageError, match="no episodes yet"):
        figures(store)
