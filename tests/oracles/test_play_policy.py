"""Play is what its config says: probabilities, labels, marks; one cube on a table, an arm that obeys at once."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from playlearn.collection import CollectConfig
from playlearn.config import load_config
from playlearn.episode import Array, Decision, Observation, read_annotation
from playlearn.errors import UsageError
from playlearn.oracles import PlayConfig
from playlearn.oracles.end_effector import CLOSE, OPEN, EndEffector
from playlearn.oracles.play_policy import PlayPolicy
from playlearn.oracles.skill_library import SkillOption
from playlearn.oracles.skills import Carry, Reach, Skill

CONFIGS = Path(__file__).resolve().parents[2] / "configs" / "collect"
NOTHING = PlayConfig(noise=0.0, pause=0.0, idle=0.0, mistake=0.0, slip=0.0)


@dataclass(frozen=True)
class Cube:
    """A `GraspableObject`: achieved (3,) is its center."""

    symmetry: float = 0.0

    def position(self, achieved: Array) -> Array:
        return achieved.astype(float)

    def yaw(self, achieved: Array) -> float:
        return 0.0

    def grasp(self, hand: EndEffector, achieved: Array) -> tuple[Array, float]:
        return self.position(achieved), np.pi / 2

    def held(self, hand: EndEffector, achieved: Array) -> bool:
        return bool(hand.opening < 0.045 and np.linalg.norm(hand.position - achieved) < 0.02)

    def clearance(self, place: Array, height: float) -> float:
        return height


class OneCube:
    """A `SkillLibrary` that carries the cube about and reaches out."""

    idle = ((-0.1, -0.1, 0.1), (0.1, 0.1, 0.2))

    def options(self) -> Sequence[SkillOption]:
        return [
            SkillOption("place", "place", lambda _: True, self.put_down),
            SkillOption("point", "point", lambda _: True, lambda *_: Reach("point", (0.1, 0.1, 0.1)), weight=0.5),
        ]

    def holding(self, hand: EndEffector, achieved: Array) -> bool:
        return Cube().held(hand, achieved)

    def put_down(self, hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
        x, y = rng.uniform(-0.15, 0.15, 2)
        return Carry("place", Cube(), (x, y, 0.0), 0.0)

    def towards(self, hand: EndEffector, achieved: Array, goal: Array) -> Skill:
        return Reach("rest", (0.0, 0.0, 0.1))


def play(config: PlayConfig, steps: int = 2000, seed: int = 0) -> tuple[list[Decision], Array]:
    """Decisions, and the cube's places (steps, 3). The gripper moves a quarter of the action; a cube falls at once."""
    policy = PlayPolicy(OneCube(), config)
    policy.reset([None], [seed])
    hand, opening, cube = np.array([0.0, 0.0, 0.1]), 0.08, np.zeros(3)
    decisions, places = [], []
    for _ in range(steps):
        state = np.array([*hand, 0, 1, 0, 1, 0, 0, opening], np.float32)
        (decision,) = policy.act([Observation(state, cube.astype(np.float32))], [True])
        grip = decision.action[-1]
        within = np.linalg.norm(hand - cube) < 0.02
        held = within and opening < 0.045
        hand = np.maximum(hand + 0.0125 * decision.action[:3], [-9, -9, 0])
        smallest = 0.04 if within else 0.0
        opening = min(0.08, opening + 0.02) if grip == OPEN else max(smallest, opening - 0.02)
        cube = hand.copy() if held and opening < 0.045 else np.array([*cube[:2], 0.0])
        decisions.append(decision)
        places.append(cube)
    return decisions, np.array(places)


def marked(decisions: Sequence[Decision], mark: str) -> Array:
    return np.array([mark in read_annotation(decision.skill)[1] for decision in decisions])


def strayed(decisions: Sequence[Decision]) -> Array:
    return np.array([np.abs(d.action - d.label).max() for d in decisions if d.label is not None])


def test_nothing_asked_for_nothing_done() -> None:
    """Without noise or mistakes what is executed is the label, and no step bears a mark but that it is done again."""
    decisions, places = play(NOTHING)
    assert strayed(decisions).max() == 0
    assert {mark for decision in decisions for mark in read_annotation(decision.skill)[1]} == {"again"}
    assert np.ptp(places[:, :2], axis=0).min() > 0.1, "the cube is carried about"


def test_plans_and_their_noise_are_meant() -> None:
    """An open-loop step is its own label, however bent the plan; and plans, too, carry the cube about."""
    decisions, places = play(dataclasses.replace(NOTHING, open_loop=1.0, path_noise=0.1))
    assert marked(decisions, "open_loop").mean() > 0.6
    assert strayed(decisions).max() == 0
    assert np.ptp(places[:, :2], axis=0).min() > 0.1


@pytest.mark.slow
def test_noise_is_executed_and_not_meant() -> None:
    """AR(1): its std at full speed is the config's, and `noise_autocorrelation` of it stays from step to step."""
    decisions, _ = play(dataclasses.replace(NOTHING, noise=0.1, noise_autocorrelation=0.8), steps=6000)
    noise = np.array([d.action - d.label for d in decisions])[:, 0]
    speed = np.array([np.linalg.norm(d.label[:3]) for d in decisions])
    clipped = np.array([np.abs(d.action[:3]).max() == 1 for d in decisions])
    whole = noise / (0.2 + 0.8 * np.minimum(1, speed))
    pairs = ~clipped[1:] & ~clipped[:-1]
    assert whole[~clipped].std() == pytest.approx(0.1, rel=0.15)
    assert np.corrcoef(whole[1:][pairs], whole[:-1][pairs])[0, 1] == pytest.approx(0.8, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("open_loop", [0.0, 1.0])
def test_a_mistake_is_marked_mended_and_labeled_with_what_was_right(open_loop: float) -> None:
    config = dataclasses.replace(NOTHING, mistake=1.0, open_loop=open_loop)
    decisions, places = play(config)
    wrong = marked(decisions, "mistake")
    assert 0.2 < wrong.mean() < 0.95
    assert strayed(decisions)[wrong].max() > 0.3  # acts on a place 3 cm or more from where objects are
    assert strayed(decisions)[~wrong].max() == 0
    assert np.ptp(places[:, :2], axis=0).min() > 0.1, "every mistake is mended: the cube still gets about"


def test_a_pause_stands_still_as_long_as_it_may() -> None:
    decisions, _ = play(dataclasses.replace(NOTHING, pause=1.0, pause_steps=(6, 9), weights={"point": 0.0}))
    pausing = marked(decisions, "pause")
    assert all(np.abs(d.action[:6]).max() == 0 for d, still in zip(decisions, pausing, strict=True) if still)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], pausing, [0]])))
    lengths = edges[1::2] - edges[::2]
    assert set(lengths[:-1]) == {6, 7, 8}  # from 6, below 9; the last may be cut


def test_a_slip_opens_the_gripper_and_the_label_does_not() -> None:
    decisions, _ = play(dataclasses.replace(NOTHING, slip=1.0))
    slipping = [d for d, slip in zip(decisions, marked(decisions, "slip"), strict=True) if slip]
    assert len(slipping) > 20
    assert all(d.action[-1] == OPEN for d in slipping)
    assert slipping[0].label is not None
    assert slipping[0].label[-1] == CLOSE


@pytest.mark.slow
@pytest.mark.parametrize("open_loop", [0.0, 1.0])
def test_who_gives_up_does_so_for_good(open_loop: float) -> None:
    """Dropped 10 to 59 steps into it, the mark on its last step; what is done before is not dropped."""
    decisions, _ = play(dataclasses.replace(NOTHING, give_up=1.0, open_loop=open_loop))
    names = np.array([read_annotation(decision.skill)[0] for decision in decisions])
    dropped = marked(decisions, "gave_up")
    begins = np.flatnonzero((names[1:] != names[:-1]) | dropped[:-1] | marked(decisions, "again")[1:]) + 1
    lengths = np.diff([0, *begins])
    assert dropped.sum() > 15
    assert lengths.max() <= 59
    assert lengths[dropped[begins - 1]].min() >= 10


def test_weights_decide_how_often_each_kind_is_tried() -> None:
    only, _ = play(dataclasses.replace(NOTHING, weights={"place": 0.0}), steps=300)
    assert {read_annotation(d.skill)[0] for d in only} == {"point"}
    # Once there, each further try is done at its first step.
    assert marked(only, "again")[-100:].all()
    both, _ = play(NOTHING, steps=1500)
    assert {read_annotation(d.skill)[0] for d in both} == {"point", "place"}


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ({"plase": 1.0}, "no kind of skill 'plase' here; did you mean `place`"),
        ({"place": 0.0, "point": 0.0}, "leave nothing to do: give one of place, point a weight above 0"),
    ],
)
def test_weights_that_nobody_can_follow_are_named(weights: dict[str, float], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        PlayPolicy(OneCube(), PlayConfig(weights=weights))


@pytest.mark.parametrize(
    "wrong",
    [
        {"mistake": 1.5},
        {"open_loop": -0.1},
        {"speed": (1.0, 0.5)},
        {"speed": (0.5, 1.5)},
        {"noise_autocorrelation": 1.0},
        {"path_noise": -1.0},
        {"pause_steps": (5, 5)},
        {"weights": {"place": -1.0}},
    ],
)
def test_a_config_that_cannot_be_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(UsageError, match=next(iter(wrong))):
        PlayConfig(**wrong)  # type: ignore[arg-type]


@pytest.mark.slow
def test_the_three_characters_differ_as_they_say() -> None:
    clean, human, noisy = (load_config(CollectConfig, CONFIGS / f"{n}.yaml").play for n in ("clean", "human", "noisy"))
    assert strayed(play(clean)[0]).max() == 0
    assert marked(play(human)[0], "open_loop").mean() > 0.3
    assert marked(play(human)[0], "pause").mean() > 0.03
    assert np.median(strayed(play(noisy)[0])) > 1.3 * np.median(strayed(play(PlayConfig())[0])) > 0
