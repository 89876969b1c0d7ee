"""Judge a policy on a suite of start states and goals, beside the expert and chance."""

import playlearn.tasks  # noqa: F401  so that a suite can name any world
from playlearn.evaluate.chains import ChainsConfig
from playlearn.evaluate.contenders import (
    Contender,
    Expert,
    Random,
    Stepwise,
    Trained,
    join_runs,
    scripted,
    trained,
)
from playlearn.evaluate.far import FarConfig
from playlearn.evaluate.heldout import HeldoutConfig
from playlearn.evaluate.job import evaluate
from playlearn.evaluate.posed import PosedConfig
from playlearn.evaluate.suite import Setup, SuiteConfig, SuiteKind, load_suite
from playlearn.evaluate.tasks import TasksConfig

__all__ = [
    "ChainsConfig",
    "Contender",
    "Expert",
    "FarConfig",
    "HeldoutConfig",
    "PosedConfig",
    "Random",
    "Setup",
    "Stepwise",
    "SuiteConfig",
    "SuiteKind",
    "TasksConfig",
    "Trained",
    "evaluate",
    "join_runs",
    "load_suite",
    "scripted",
    "trained",
]
