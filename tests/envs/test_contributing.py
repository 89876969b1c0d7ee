"""What CONTRIBUTING.md shows of adding an environment is true."""

import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from playlearn.config import from_dict
from playlearn.episode import Goal, Observation
from playlearn.oracles import PlayConfig, expert_for, play_policy_for
from playlearn.rollout import rollout
from playlearn.sim import EnvironmentConfig, Task
from tests.shares import often

CONTRIBUTING = Path(__file__).parents[2] / "CONTRIBUTING.md"
HEADING = "## An environment that you registered with robosuite"


@pytest.mark.slow
def test_the_environment_shown_has_tasks_an_expert_and_play() -> None:
    section = CONTRIBUTING.read_text().split(HEADING)[1].split("\n## ")[0]
    blocks = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    assert len(blocks) == 2
    for name, block in zip(("theirs", "brick"), blocks, strict=True):
        module = ModuleType(name)
        sys.modules[name] = module  # dataclasses look their module up
        exec(block, module.__dict__)  # noqa: S102 - our own document
    env = from_dict(EnvironmentConfig, {"type": "brick"}).build()
    expert = expert_for(env)
    assert list(env.tasks) == ["lift_brick", "push_brick", "rotate_brick", "place_brick"]

    def done(task: Task, seed: int) -> bool:
        env.reset(seed)
        start = env.observe().achieved
        goal = task.command(start, np.random.default_rng(seed))

        def solved(_: int, seen: Observation) -> bool:
            return task.judge(start, seen.achieved, goal)

        return rollout([env], expert, [Goal(goal)], seeds=[0], max_steps=200, stop=solved)[0].ended == "stopped"

    def moved(seed: int) -> bool:
        env.reset(seed)
        episode = rollout([env], play_policy_for(env, PlayConfig()), [None], seeds=[seed], max_steps=150)[0].episode
        assert episode is not None
        return bool(np.ptp(episode.achieved[:, :2], axis=0).max() > 0.03)

    for name, task in env.tasks.items():
        assert often((done(task, seed) for seed in range(2, 6)), done=1), name
    assert often((moved(seed) for seed in range(3, 7)), done=1)
