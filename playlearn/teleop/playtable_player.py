"""Unstructured play on PlayTable: skills chained at random, with the mistakes that make it worth learning from.

Every action that is executed may carry noise, a pause or a mistake; the label beside it
(`Decision.label`) is what the same driver, at that very state, meant to do (noise injection as in
DART, Laskey et al. 2017, here with drifting noise).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.sim import playtable_scene as scene
from playlearn.sim.environment import Task
from playlearn.sim.playtable_tasks import BLOCK_NAMES, DRAWER, block, clear, in_tray, playtable_tasks
from playlearn.teleop.hand import OPEN, Hand, Style
from playlearn.teleop.playtable_expert import skill_for, skill_towards
from playlearn.teleop.playtable_skills import Carry, Reach, Skill, holding

_PATIENCE = 170  # steps after which a skill is given up
_HOLD = (14, 24)  # steps for which a lifted block is held still
_OFFSET_STEPS = (25, 45)  # how long a misjudged place is believed in
_SLIP_STEPS = 9


@dataclass(frozen=True)
class PlayConfig:
    """How somebody plays.

    weights: how often each kind of task is tried, where it can be. speed, approach, carry: ranges of
    the driver's style, drawn anew for every skill (share of full speed; metres). noise, drift: spread
    of the noise on the executed motion and its AR(1) memory. pause, aimless: how likely before a
    skill; mistake: how likely a skill begins at a misjudged place; slip: how likely a carried block is
    let go on the way.
    """

    weights: dict[str, float] = field(
        default_factory=lambda: {
            "lift": 0.6,
            "push": 1.0,
            "rotate": 0.8,
            "place": 1.6,
            "stow": 1.2,
            "stack": 1.0,
            "unstack": 2.0,
            "unstow": 2.0,
            "open_drawer": 2.0,
            "close_drawer": 1.2,
            "lamp": 1.6,
        }
    )
    speed: tuple[float, float] = (0.75, 1.0)
    approach: tuple[float, float] = (0.05, 0.09)
    carry: tuple[float, float] = (0.07, 0.11)
    noise: float = 0.2
    drift: float = 0.85
    pause: float = 0.1
    aimless: float = 0.06
    mistake: float = 0.12
    slip: float = 0.05


class PlayTablePlayer:
    """An Actor without goals: it makes its own, one after the other, for as long as it is asked."""

    name = "player"
    cameras: tuple[str, ...] = ()

    def __init__(self, config: PlayConfig) -> None:
        self._config = config
        self._tasks = playtable_tasks()
        self._players: list[_Player] = []

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self._players = [_Player(self._config, self._tasks, np.random.default_rng(seed)) for seed in seeds]

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> Sequence[Decision]:
        nothing = Decision(np.zeros(7))
        return [
            player.act(seen) if running else nothing
            for player, seen, running in zip(self._players, observations, active, strict=True)
        ]


@dataclass
class _Player:
    """One player at one table: what it is doing now, and for how long still."""

    config: PlayConfig
    tasks: Mapping[str, Task]
    rng: np.random.Generator
    skill: Skill | None = None
    style: Style = field(default_factory=Style)
    steps: int = 0
    pausing: int = 0
    holding: int = 0
    offset: Array = field(default_factory=lambda: np.zeros(2))
    misjudged: int = 0
    slip_at: float = 0.0
    slipping: int = 0
    noise: Array = field(default_factory=lambda: np.zeros(6))

    def act(self, seen: Observation) -> Decision:
        hand, achieved = Hand.seen(seen), seen.achieved
        skill = self.skill
        if skill is None or self._over(skill, hand, achieved):
            skill = self._begin(hand, achieved)
        self.steps += 1
        label = skill.act(hand, achieved, self.style)
        action = self._executed(hand, achieved, label, skill)
        return Decision(action, label, skill.name)

    def _over(self, skill: Skill, hand: Hand, achieved: Array) -> bool:
        if self.steps > _PATIENCE:
            return True
        if self.holding > 0 and skill.done(hand, achieved):
            self.holding -= 1
            return self.holding == 0
        return self.holding == 0 and skill.done(hand, achieved)

    def _begin(self, hand: Hand, achieved: Array) -> Skill:
        config, rng = self.config, self.rng
        self.style = Style(rng.uniform(*config.speed), rng.uniform(*config.approach), rng.uniform(*config.carry))
        skill = self.skill = self._next(hand, achieved)
        self.steps = 0
        self.pausing = int(rng.integers(4, 14)) if rng.random() < config.pause else 0
        lifting = isinstance(skill, Carry) and not skill.release
        self.holding = int(rng.integers(*_HOLD)) if lifting else 0
        self.misjudged = int(rng.integers(*_OFFSET_STEPS)) if rng.random() < config.mistake else 0
        angle = rng.uniform(-np.pi, np.pi)
        self.offset = rng.uniform(0.03, 0.055) * np.array([np.cos(angle), np.sin(angle)])
        self.slip_at = scene.TABLE_Z + rng.uniform(0.05, 0.12) if rng.random() < config.slip else 0.0
        self.slipping = 0
        return skill

    def _next(self, hand: Hand, achieved: Array) -> Skill:
        held = [i for i in range(len(BLOCK_NAMES)) if holding(hand, achieved, i)]
        if held:
            return self._put_down(achieved, held[0])
        if self.rng.random() < self.config.aimless:
            low, high = (-0.15, -0.2, scene.TABLE_Z + 0.12), (0.15, 0.2, scene.TABLE_Z + 0.25)
            x, y, z = self.rng.uniform(low, high)
            return Reach("aimless", (x, y, z))
        names, weights = self._possible(achieved)
        name = names[int(self.rng.choice(len(names), p=weights / weights.sum()))]
        goal = self._goal(name, achieved)
        changed = [i for i in range(len(BLOCK_NAMES)) if not np.allclose(block(goal, i), block(achieved, i), atol=1e-4)]
        if not changed and name.split("_")[0] not in ("open", "close", "lamp"):
            return skill_towards(hand, achieved, achieved)  # nowhere to go: the table is full; step back
        return skill_for(name, goal, [] if name.endswith("drawer") else changed, achieved)

    def _possible(self, achieved: Array) -> tuple[list[str], Array]:
        weights: dict[str, float] = {}
        for name, task in self.tasks.items():
            kind = name if name.endswith("drawer") else name.split("_")[0]
            if task.precondition(achieved):
                weights[name] = self.config.weights.get(kind, 0.0)
        for index, name in enumerate(BLOCK_NAMES):
            if in_tray(achieved, index) and achieved[DRAWER] > 0.12 and clear(achieved, index):
                weights[f"unstow_{name}"] = self.config.weights.get("unstow", 0.0)
        return list(weights), np.array([max(weight, 1e-9) for weight in weights.values()])

    def _goal(self, name: str, achieved: Array) -> Array:
        kind, _, which = name.partition("_")
        task = self.tasks[f"place_{which}" if kind == "unstow" else name]
        return task.command(achieved, self.rng)

    def _put_down(self, achieved: Array, index: int) -> Skill:
        which = BLOCK_NAMES[index]
        kinds = ["place"]
        if achieved[DRAWER] > 0.12:
            kinds.append("stow")
        if any(clear(achieved, i) and block(achieved, i)[2] < scene.TABLE_Z + 0.03 for i in range(3) if i != index):
            kinds.append("stack")
        name = f"{kinds[int(self.rng.integers(len(kinds)))]}_{which}"
        goal = self.tasks[name].command(achieved, self.rng)
        return skill_for(name, goal, [index], achieved)

    def _executed(self, hand: Hand, achieved: Array, label: Array, skill: Skill) -> Array:
        config, rng = self.config, self.rng
        spread = config.noise * np.array([1, 1, 0.6, 0.15, 0.15, 0.5])
        self.noise = config.drift * self.noise + np.sqrt(1 - config.drift**2) * spread * rng.standard_normal(6)
        action = label.copy()
        if self.misjudged > 0:  # acts as if everything stood `offset` away from where it is
            self.misjudged -= 1
            away = np.array([*self.offset, 0.0])
            action = skill.act(Hand(hand.position - away, hand.rotation, hand.opening), achieved, self.style)
        if (
            self.slip_at
            and hand.position[2] > self.slip_at
            and any(holding(hand, achieved, i) for i in range(len(BLOCK_NAMES)))
        ):
            self.slip_at, self.slipping = 0.0, _SLIP_STEPS
        # People tremble less where they go slowly and look closely.
        action[:6] += self.noise * (0.2 + 0.8 * min(1.0, float(np.linalg.norm(label[:3]))))
        if self.slipping > 0:
            self.slipping -= 1
            action[-1] = OPEN
        if self.pausing > 0:
            self.pausing -= 1
            action[:6] = 0.0
        return action.clip(-1, 1)
