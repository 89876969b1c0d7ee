"""The verbs of `import playlearn as pl`. Each imports what it needs when it is called.

    env = pl.make_env("playtable")
    actor = pl.make_actor(pl.load_policy("eval/pretrained/image"), env)
    outcome = pl.run_rollout(env, actor, goal)

What a YAML file says a verb takes as that file, as the config itself, or as a file with `overrides`:
`pl.train("configs/train/playtable_state_diffusion.yaml", "runs/state", overrides={"policy.head.type": "flow"})`.
Paths may be text. Every mistake is a `playlearn.errors.PlaylearnError` whose message says what to do.
"""

from playlearn.api.acting import load_goal, load_policy, make_actor, make_env, make_goal, run_rollout
from playlearn.api.configs import load_config, load_suite
from playlearn.api.jobs import compare, diagnose, evaluate, export_policy, run_dagger, train
from playlearn.api.play import collect, export_lerobot, make_dataset, open_store

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
