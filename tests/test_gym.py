"""Goal-conditioned episodes under gymnasium's own `make`."""

import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import playlearn.envs  # noqa: F401 - registers them
from playlearn import gym
from playlearn.errors import UsageError
from playlearn.sim import EnvironmentConfig

SUITES = Path(__file__).resolve().parents[1] / "eval" / "suites"


def python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=True)
    return done.stdout.strip()


@pytest.mark.slow
@pytest.mark.parametrize(
    "imports",
    [
        "import gymnasium, playlearn",
        "import playlearn, gymnasium",
        "import importlib.util, playlearn; importlib.util.find_spec('gymnasium'); import gymnasium",
        "import playlearn, gymnasium.envs.registration",
    ],
)
def test_to_import_both_in_any_order_registers(imports: str) -> None:
    check = "assert type(gymnasium.__spec__.loader).__name__ == 'SourceFileLoader' and gymnasium.__loader__"
    assert python(f"{imports}; {check}; print('playlearn/PlayTable-v0' in gymnasium.registry)") == "True"


@pytest.mark.slow
def test_a_module_in_the_name_needs_no_import() -> None:
    code = """
import gymnasium
try:
    gymnasium.make("playlearn.gym:playlearn/PlayTable-v0", suite="nosuch.yaml")
except Exception as error:
    print(error)
"""
    assert python(code).startswith("there is no config nosuch.yaml")


def test_every_environment_has_a_name() -> None:
    kinds = set(EnvironmentConfig.get_known_choices()) - {"point"}  # of tests/fakes.py
    ours = {kind for kind in kinds if EnvironmentConfig.get_choice_class(kind).__module__.startswith("playlearn.")}
    assert set(gym.ENVIRONMENTS.values()) == ours
    for name in gym.ENVIRONMENTS:
        assert gymnasium.spec(f"playlearn/{name}-v0").kwargs == {"environment": gym.ENVIRONMENTS[name]}


def test_a_suite_of_another_environment_is_refused() -> None:
    with pytest.raises(UsageError, match=r"suite playtable_tasks is of environment playtable, not of lift"):
        gymnasium.make("playlearn/Lift-v0", suite=SUITES / "playtable_tasks.yaml")


@pytest.mark.slow
def test_an_environment_without_a_suite_has_all_its_tasks() -> None:
    env = gymnasium.make("playlearn/Lift-v0")
    tasks = {env.reset(seed=seed)[1]["task"] for seed in range(2)}
    assert len(tasks) == 2
    env.close()


@pytest.mark.slow
def test_playtable_is_made_and_stepped() -> None:
    env = gymnasium.make("playlearn/PlayTable-v0", suite=str(SUITES / "playtable_tasks.yaml"), max_steps=3)
    observation, info = env.reset(seed=3)
    assert sorted(observation["pixels"]) == ["front", "goal_front", "goal_wrist", "wrist"]
    again, same = env.reset(seed=3)  # episode 3 of the suite, always the same
    assert same == info
    np.testing.assert_array_equal(again["goal.state"], observation["goal.state"])
    env.action_space.seed(0)
    ended = [env.step(env.action_space.sample())[2:4] for _ in range(3)]
    assert ended == [(False, False), (False, False), (False, True)]  # max_steps
    assert env.render().ndim == 3
    env.close()
