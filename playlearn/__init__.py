"""Robots that reach any goal you show them, learned from play.

    import playlearn as pl

offers what most people need, each loaded when it is first used, so that the import itself is quick and brings in
neither torch nor a simulator:

    make_env       an environment by name                 load_policy   of a training run, or a shipped one
    make_goal      what an environment shows, as a goal   make_actor    a policy, the expert or a random policy, to act
    run_rollout    act until the goal is reached          open_store    recorded play
    make_dataset   goal-conditioned examples of a store   load_config   a YAML file with overrides
    load_suite     start states and goals to evaluate on  load_goal     a goal from picture files
    collect  train  evaluate  run_dagger  diagnose  compare      the jobs, as their commands do them
    export_lerobot  export_policy                                for LeRobot

`gymnasium.make("playlearn/PlayTable-v0")` works once playlearn is imported (see `playlearn.gym`).
"""

from typing import TYPE_CHECKING, Any

from playlearn import gym

if TYPE_CHECKING:
    from playlearn.api import (
        collect,
        compare,
        diagnose,
        evaluate,
        export_lerobot,
        export_policy,
        load_config,
        load_goal,
        load_policy,
        load_suite,
        make_actor,
        make_dataset,
        make_env,
        make_goal,
        open_store,
        run_dagger,
        run_rollout,
        train,
    )

__version__ = "0.1.0"
# No module of this package may be called like one of these: once imported it would take the verb's place.
__all__ = [
    "collect",
    "compare",
    "diagnose",
    "evaluate",
    "export_lerobot",
    "export_policy",
    "load_config",
    "load_goal",
    "load_policy",
    "load_suite",
    "make_actor",
    "make_dataset",
    "make_env",
    "make_goal",
    "open_store",
    "run_dagger",
    "run_rollout",
    "train",
]

gym.register_when_imported()


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from playlearn import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
