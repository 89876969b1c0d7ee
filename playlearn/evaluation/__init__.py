"""Evaluate a policy on a suite of start states and goals, beside the expert and the random policy."""

import playlearn.envs  # noqa: F401  so that a suite can name any environment
from playlearn.evaluation.actor_recipes import (
    ActorRecipe,
    ExpertRecipe,
    HierarchicalRecipe,
    RandomRecipe,
    TrainedRecipe,
    join_runs,
    scripted,
    trained,
)
from playlearn.evaluation.job import evaluate
from playlearn.evaluation.suite import EvalEpisode, SuiteConfig, SuiteKind, load_suite
from playlearn.evaluation.suites.chains import ChainsConfig
from playlearn.evaluation.suites.fixed_tasks import FixedTasksConfig
from playlearn.evaluation.suites.multi_change import MultiChangeConfig
from playlearn.evaluation.suites.tasks import TasksConfig
from playlearn.evaluation.suites.val_play import ValPlayConfig

__all__ = [
    "ActorRecipe",
    "ChainsConfig",
    "EvalEpisode",
    "ExpertRecipe",
    "FixedTasksConfig",
    "HierarchicalRecipe",
    "MultiChangeConfig",
    "RandomRecipe",
    "SuiteConfig",
    "SuiteKind",
    "TasksConfig",
    "TrainedRecipe",
    "ValPlayConfig",
    "evaluate",
    "join_runs",
    "load_suite",
    "scripted",
    "trained",
]
