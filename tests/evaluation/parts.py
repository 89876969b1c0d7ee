"""Parts of the tests of evaluation: a suite in the point environment, its play, and specs of policies."""

from pathlib import Path

import yaml

from playlearn.config import to_dict
from playlearn.evaluation import ExpertRecipe, SuiteConfig, TasksConfig
from playlearn.policies import PolicySpec
from playlearn.rollout import rollout
from playlearn.store import NativeStore, StoreSpec
from tests.fakes import PointConfig, PointEnv, PointPlayPolicy, point_expert

SUITE = SuiteConfig(
    name="point_tasks",
    environment=PointConfig(),
    kind=TasksConfig(),
    episodes=10,
    max_steps=50,
    success_hold_steps=3,
    num_envs=4,
)
EXPERT = ExpertRecipe(point_expert)


def write(suite: SuiteConfig, folder: Path) -> Path:
    path = folder / f"{suite.name}.yaml"
    raw = {**to_dict(suite)}
    path.write_text(yaml.safe_dump(raw))
    return path


def spec(env: type[PointEnv] = PointEnv) -> PolicySpec:
    names = env.spec
    sizes = {"front": (24, 32), "wrist": (16, 16)}
    return PolicySpec(names.state_names, names.achieved_names, names.action_names, names.fps, sizes)


def play(folder: Path, episodes: int = 12) -> NativeStore:
    envs = [PointEnv(PointConfig()) for _ in range(episodes)]
    for seed, env in enumerate(envs):
        env.reset(seed)
    outcomes = rollout(envs, PointPlayPolicy(), [None] * episodes, seeds=range(episodes), max_steps=300)
    made = [outcome.episode for outcome in outcomes if outcome.episode is not None]
    store = NativeStore.create(folder, StoreSpec.of(made[0]))
    with store.writer() as writer:
        for episode in made:
            writer.append(episode)
    return NativeStore.open(folder)
