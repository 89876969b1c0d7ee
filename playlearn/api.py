"""The verbs of `import playlearn as pl`. Each imports what it needs when it is called.

    env = pl.make_env("playtable")
    actor = pl.make_actor(pl.load_policy("eval/pretrained/image"), env)
    outcome = pl.run_rollout(env, actor, goal)

What a YAML file says a verb takes as that file, as the config itself, or as a file with `overrides`:
`pl.train("configs/train/playtable_state_diffusion.yaml", "runs/state", overrides={"policy.head.type": "flow"})`.
Paths may be text. Every mistake is a `playlearn.errors.PlaylearnError` whose message says what to do.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

if TYPE_CHECKING:
    from playlearn.collection import CollectConfig
    from playlearn.dagger import DaggerConfig
    from playlearn.data import DataConfig, PlayDataset
    from playlearn.demo.config import DemoConfig
    from playlearn.episode import Goal
    from playlearn.evaluation import SuiteConfig
    from playlearn.experiments.compare import CompareConfig
    from playlearn.policies import Policy
    from playlearn.rollout import Outcome
    from playlearn.sim.environment import Actor, Environment, EnvironmentConfig
    from playlearn.store import Store, StoreConfig
    from playlearn.training import TrainConfig

__all__ = [
    "collect",
    "compare",
    "diagnose",
    "evaluate",
    "export_lerobot",
    "export_policy",
    "load_config",
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

type Where = Path | str
type Overrides = Mapping[str, Any]
type ConfigName = Literal["collect", "train", "suite", "dagger", "compare", "demo"]

CONFIGS: tuple[ConfigName, ...] = ("collect", "train", "suite", "dagger", "compare", "demo")
_NONE: Overrides = {}


# Environments, policies, goals --------------------------------------------------------------------------------


def make_env(name_or_config: "str | EnvironmentConfig", **options: Any) -> "Environment":
    """An environment by its `type:` ("playtable", "lift", "door" ...) or its config.

    options: fields of its config: `make_env("playtable", robot="Sawyer", stacked=0.0)`.

    Raises:
        UsageError: no such environment, an unknown field, or a value of a wrong type.
    """
    import playlearn.envs  # noqa: F401 - registers them
    from playlearn.config import from_dict, to_dict
    from playlearn.sim import EnvironmentConfig

    given = {"type": name_or_config} if isinstance(name_or_config, str) else to_dict(name_or_config)
    return from_dict(EnvironmentConfig, {**given, **options}).build()


def load_policy(run: Where, *, encoder: Where | None = None, device: str = "cpu") -> "Policy":
    """The policy of a training run, ready to act.

    run: the --out folder of `playlearn train`, or a shipped one such as `eval/pretrained/image`.
    encoder: a run behind whose image encoder a state policy then acts.

    Raises:
        CheckpointError: there is no policy, or it is broken or of another version.
        UsageError: the two runs do not fit.
    """
    from playlearn.policies import Policy

    policy = Policy.load(Path(run) / "policy", device)
    return policy if encoder is None else policy.behind(Policy.load(Path(encoder) / "policy", device), Path(encoder))


def make_actor(
    policy: "Policy | Literal['expert', 'random']",
    env: "Environment",
    *,
    goal: Literal["image", "state"] | None = None,
    n_action_steps: int | None = None,
    guidance: float | None = None,
) -> "Actor":
    """Whoever acts in rollouts: a policy that executes its chunks, the scripted expert, or smooth random actions.

    goal: how the policy is shown its goal (None: as it was trained; where both, image).
    n_action_steps: actions of a chunk that are executed before the next plan (None: half of the chunk).
    guidance: weight of the goal (classifier-free guidance; None: no guidance).

    Raises:
        UsageError: the policy lacks something in this environment, or the environment has no expert.
    """
    from playlearn.evaluation.actor_recipes import scripted
    from playlearn.policies import PolicyActor
    from playlearn.rollout import RandomActor

    if policy == "expert":
        return scripted(env)
    if policy == "random":
        return RandomActor(len(env.spec.action_names))
    missing = set(policy.cameras) - set(env.spec.cameras)
    images = {} if missing else env.observe(policy.cameras).images
    policy.check(env.spec, {camera: (image.shape[0], image.shape[1]) for camera, image in images.items()})
    steps = max(1, policy.config.chunk // 2) if n_action_steps is None else n_action_steps
    return PolicyActor(policy, n_action_steps=steps, guidance=guidance, goal=goal)


def make_goal(env: "Environment", cameras: Sequence[str] | None = None) -> "Goal":
    """The environment's present state as a goal: achieved (G,), the robot's state (S,) and an image for each camera.

    cameras: those that show it (None: all).
    """
    from playlearn.evaluation.suite import goal_from

    return goal_from(env, env.spec.cameras if cameras is None else cameras)


def run_rollout(
    env: "Environment",
    actor: "Actor",
    goal: "Goal | None" = None,
    *,
    seed: int = 0,
    max_steps: int = 200,
    cameras: Sequence[str] = (),
) -> "Outcome":
    """Let an actor act from the environment's present state until the goal is reached, or `max_steps` are over.

    seed: the actor's randomness. cameras: those that the recorded episode keeps images of.
    The outcome's `ended` is "stopped" where the goal was reached; for many environments in lockstep see
    `playlearn.rollout.rollout`.
    """
    from playlearn.rollout import rollout

    stop = None if goal is None else lambda _, seen: env.reached(seen.achieved, goal.achieved)
    return rollout([env], actor, [goal], seeds=[seed], max_steps=max_steps, stop=stop, cameras=cameras)[0]


# Play -----------------------------------------------------------------------------------------------------------


def open_store(where: "Where | StoreConfig") -> "Store":
    """The store in a folder, of whatever kind (native, LeRobot); raises StoreError where there is none."""
    from playlearn.store import open_store as run

    return run(where)


def make_dataset(
    store: "Where | Store",
    config: "DataConfig | None" = None,
    *,
    split: Literal["train", "val"] = "train",
    seed: int = 0,
    overrides: Overrides = _NONE,
) -> "PlayDataset":
    """Goal-conditioned training examples cut from a store; `batch(epoch, indices)` gives them as tensors.

    overrides: fields of DataConfig: `{"history": 2, "chunk": 8, "goals.ahead": 2}`.

    Raises:
        UsageError: an unknown field, or a camera that the store lacks.
        StoreError: there is no store, or nothing in it to learn from.
    """
    from playlearn.config import load_config, to_dict
    from playlearn.data import DataConfig
    from playlearn.store import open_store as opened

    if overrides:
        before = {} if config is None else to_dict(config)
        config = load_config(DataConfig, None, [*_as_arguments(before), *_as_arguments(overrides)])
    play = opened(store) if isinstance(store, Path | str) else store
    return (config or DataConfig()).build(play, split, seed)


def collect(
    config: "Where | CollectConfig",
    out: Where,
    *,
    overrides: Overrides = _NONE,
    workers: int | None = None,
    resume: bool = False,
) -> "Store":
    """Record play into a store at `out`, as `playlearn collect` does, and open it.

    workers: processes (None: one a core; 0: this one only). resume: go on with a store that is there.

    Raises:
        UsageError: the config is wrong, or `out` was collected with another one.
        StoreError: `out` is taken and `resume` was not asked for; the disk is full.
        PlaylearnError: episodes failed; the others are kept.
    """
    from playlearn.collection import collect as run

    run(_config("collect", config, overrides), Path(out), workers=workers, resume=resume)
    return open_store(out)


def export_lerobot(
    store: "Where | Store",
    out: Where,
    *,
    goals: str | None = None,
    videos: Literal["av1", "h264"] | None = None,
    subtasks: bool = False,
) -> None:
    """Write a store as a LeRobot v3.0 dataset, with its card.

    goals: relabel with this goal sampler ("settled", "final" ...): each window an episode that carries its goal.
    videos: encode the cameras as video instead of images. subtasks: skills as LeRobot's subtask annotation.

    Raises:
        UsageError: `out` is taken, or the sampler is unknown.
        StoreError: the store is missing or broken; it cannot be written.
    """
    from playlearn.config import load_config
    from playlearn.lerobot.goals import RelabelConfig
    from playlearn.lerobot.share import contents, share
    from playlearn.store import open_store as opened

    relabel = None if goals is None else load_config(RelabelConfig, None, [f"--goals.type={json.dumps(goals)}"])
    play = opened(store) if isinstance(store, Path | str) else store
    share(contents(play, relabel, subtasks=subtasks), Path(out), videos)


# Jobs -----------------------------------------------------------------------------------------------------------


def train(config: "Where | TrainConfig", out: Where, *, overrides: Overrides = _NONE, resume: bool = False) -> "Policy":
    """Train a policy into `out`, as `playlearn train` does, and load it. resume: from the last checkpoint there.

    Raises:
        UsageError: the config is wrong; `out` is taken or, with `resume`, holds no run of this config.
        StoreError: the play is missing or too little.
        NotLearnedError: a fresh policy is no better than before the first update; what was trained is kept.
    """
    from playlearn.training import train as run

    run(_config("train", config, overrides), Path(out), resume=resume)
    return load_policy(out)


def evaluate(
    policy: Where,
    suite: Where,
    out: Where,
    *,
    goal: Literal["image", "state"] = "image",
    encoder: Where | None = None,
    overrides: Overrides = _NONE,
    episodes: int | None = None,
    seed: int | None = None,
    workers: int | None = None,
    baselines: bool = True,
) -> dict[str, Any]:
    """Evaluate a policy on a suite, as `playlearn eval` does; returns what `out`/results.json says.

    policy: the folder of a training run, "expert" or "random". encoder: a run behind whose image encoder a state
    policy acts. overrides: fields of the suite. episodes, seed: instead of the suite's own.
    baselines: the scripted expert and a random policy on the same episodes.

    Raises:
        UsageError: the suite is wrong, or the policy does not read such goals.
        CheckpointError: there is no such run, or it was trained for another environment.
    """
    from playlearn.evaluation import evaluate as run

    baseline = str(policy) in ("expert", "random")
    return run(
        Path(suite),
        out=Path(out),
        run=None if baseline else Path(policy),
        policy=str(policy) if baseline else None,
        encoder=None if encoder is None else Path(encoder),
        goal=goal,
        episodes=episodes,
        seed=seed,
        workers=workers,
        references=baselines,
        overrides=_as_arguments(overrides),
    )


def diagnose(
    run: Where,
    suite: Where,
    out: Where,
    *,
    goal: Literal["image", "state"] = "image",
    overrides: Overrides = _NONE,
    episodes: int | None = None,
    seed: int | None = None,
    workers: int | None = None,
) -> dict[str, Any]:
    """Classify how a run's policy fails on a suite, as `playlearn diagnose` does; returns `out`/diagnosis.json.

    Raises as `evaluate` does.
    """
    from playlearn.evaluation.diagnosis import diagnose as job

    return job(
        Path(run),
        Path(suite),
        Path(out),
        goal=goal,
        episodes=episodes,
        workers=workers,
        seed=seed,
        overrides=_as_arguments(overrides),
    )


def run_dagger(
    config: "Where | DaggerConfig",
    run: Where,
    out: Where,
    *,
    overrides: Overrides = _NONE,
    workers: int | None = None,
    resume: bool = False,
) -> dict[str, Any]:
    """Improve the policy of `run` in rounds of DAgger, as `playlearn dagger` does; returns `out`/results.json.

    Raises:
        UsageError: the config is wrong or does not fit the run, there is no such run, or `out` is taken.
        CheckpointError: the run was trained for another environment.
    """
    from playlearn.dagger import dagger

    given = _config("dagger", config, overrides)
    return dagger(given, Path(run), Path(out), workers=workers, resume=resume)


def compare(
    config: "Where | CompareConfig", out: Where, *, overrides: Overrides = _NONE, workers: int | None = None
) -> list[dict[str, Any]]:
    """Train and evaluate variants of one config, as `playlearn compare` does; returns a row for each.

    Raises:
        UsageError: the config or a variant is wrong, or `out` holds another comparison.
        PlaylearnError: a run failed; the others are kept, and the same call goes on.
    """
    from playlearn.experiments.compare import compare as job

    return job(_config("compare", config, overrides), Path(out), workers)


def export_policy(run: Where, out: Where) -> None:
    """Write a run's policy as one of LeRobot's, for `lerobot-eval --policy.path`.

    Raises:
        CheckpointError: there is no policy in `run`.
        UsageError: `out` is taken.
    """
    from playlearn.lerobot.publish import export_policy as job

    job(Path(run), Path(out))


# Configs --------------------------------------------------------------------------------------------------------


@overload
def load_config(name: Literal["collect"], path: Where | None = None, overrides: Overrides = ...) -> "CollectConfig": ...
@overload
def load_config(name: Literal["train"], path: Where | None = None, overrides: Overrides = ...) -> "TrainConfig": ...
@overload
def load_config(name: Literal["suite"], path: Where | None = None, overrides: Overrides = ...) -> "SuiteConfig": ...
@overload
def load_config(name: Literal["dagger"], path: Where | None = None, overrides: Overrides = ...) -> "DaggerConfig": ...
@overload
def load_config(name: Literal["compare"], path: Where | None = None, overrides: Overrides = ...) -> "CompareConfig": ...
@overload
def load_config(name: Literal["demo"], path: Where | None = None, overrides: Overrides = ...) -> "DemoConfig": ...
def load_config(name: ConfigName, path: Where | None = None, overrides: Overrides = _NONE) -> Any:
    """The config of a command: what the file says, then `overrides`, over the defaults.

    name: whose config. path: a YAML file (None: the defaults). overrides: dotted field -> value,
    `{"policy.head.type": "flow", "steps": 3000}`. `playlearn config NAME` prints all fields.

    Raises:
        UsageError: no such file, an unknown field, a missing one, or a value of a wrong type.
    """
    from playlearn.config import load_config as load

    return load(config_class(name), None if path is None else Path(path), _as_arguments(overrides))


def load_suite(path: Where, overrides: Overrides = _NONE) -> "SuiteConfig":
    """The evaluation suite of a YAML file (eval/suites/); raises UsageError where it is wrong."""
    return load_config("suite", path, overrides)


def config_class(name: ConfigName) -> Any:
    """The config class of a command."""
    if name == "collect":
        from playlearn.collection import CollectConfig

        return CollectConfig
    if name == "train":
        from playlearn.training import TrainConfig

        return TrainConfig
    if name == "suite":
        from playlearn.evaluation import SuiteConfig

        return SuiteConfig
    if name == "dagger":
        from playlearn.dagger import DaggerConfig

        return DaggerConfig
    if name == "compare":
        from playlearn.experiments.compare import CompareConfig

        return CompareConfig
    if name == "demo":
        from playlearn.demo.config import DemoConfig

        return DemoConfig
    raise _unknown_config(name)


def _unknown_config(name: str) -> Exception:
    from playlearn.config import nearest
    from playlearn.errors import UsageError

    return UsageError(f"there is no config {name!r}{nearest(name, CONFIGS)}")


def _config(name: ConfigName, given: Any, overrides: Overrides) -> Any:
    """The config that a verb was handed: itself, or what its file says."""
    from playlearn.errors import UsageError

    if isinstance(given, Path | str):
        return load_config(name, given, overrides)
    if overrides:
        raise UsageError("overrides go with a file; change a config by `dataclasses.replace(config, field=value)`")
    return given


def _as_arguments(overrides: Overrides) -> list[str]:
    """As on the command line; JSON is YAML."""
    return [f"--{name}={json.dumps(value, default=str)}" for name, value in overrides.items()]
