"""What CONTRIBUTING.md shows of adding a task is true."""

import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

from playlearn.config import from_dict
from playlearn.episode import Goal
from playlearn.rollout import rollout
from playlearn.sim import EnvironmentConfig
from playlearn.teleop import PlayConfig, expert_for, player_for

CONTRIBUTING = Path(__file__).parents[2] / "CONTRIBUTING.md"
HEADING = "## A task that you registered with robosuite"


def test_the_task_shown_can_be_driven_and_played() -> None:
    section = CONTRIBUTING.read_text().split(HEADING)[1].split("\n## ")[0]
    blocks = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    assert len(blocks) == 2
    module = ModuleType("brick")
    sys.modules["brick"] = module  # dataclasses look their module up
    for block in blocks:
        exec(block, module.__dict__)  # noqa: S102 - our own document
    world = from_dict(EnvironmentConfig, {"type": "brick"}).build()
    expert = expert_for(world)
    assert list(world.tasks) == ["lift_brick", "push_brick", "rotate_brick", "place_brick"]
    for name, task in world.tasks.items():
        world.reset(2)
        start = world.observe().achieved
        goal = task.command(start, np.random.default_rng(1))

        def done(_: int, seen: object, task=task, start=start, goal=goal) -> bool:
            return task.judge(start, seen.achieved, goal)

        outcome = rollout([world], expert, [Goal(goal)], seeds=[0], max_steps=200, stop=done)[0]
        assert outcome.ended == "stopped", name
    world.reset(3)
    episode = rollout([world], player_for(world, PlayConfig()), [None], seeds=[3], max_steps=150)[0].episode
    assert episode is not None
    assert np.ptp(episode.achieved[:, :2], axis=0).max() > 0.03
