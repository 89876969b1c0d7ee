"""Training, evaluation and DAgger, as their commands do them."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from playlearn.api.acting import load_policy
from playlearn.api.configs import NO_OVERRIDES, Overrides, Where, as_arguments, resolve

if TYPE_CHECKING:
    from playlearn.dagger import DaggerConfig
    from playlearn.experiments.compare import CompareConfig
    from playlearn.policies import Policy
    from playlearn.training import TrainConfig


def train(
    config: "Where | TrainConfig", out: Where, *, overrides: Overrides = NO_OVERRIDES, resume: bool = False
) -> "Policy":
    """Train a policy into `out`, as `playlearn train` does, and load it.

    resume: from the last checkpoint in `out`.

    Raises:
        UsageError: the config is wrong; `out` is taken or, with `resume`, holds no run of this config.
        StoreError: the play is missing or too little, or holds a number that is not finite.
        TrainingDiverged: a loss, a gradient or a weight is not finite; what was saved before is kept.
        NotLearnedError: a fresh policy is no better than before the first update; what was trained is kept.
    """
    from playlearn.training import train as run

    run(resolve("train", config, overrides), Path(out), resume=resume)
    return load_policy(out)


def evaluate(
    policy: Where,
    suite: Where,
    out: Where,
    *,
    goal: Literal["image", "state"] = "image",
    encoder: Where | None = None,
    overrides: Overrides = NO_OVERRIDES,
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
        overrides=as_arguments(overrides),
    )


def diagnose(
    run: Where,
    suite: Where,
    out: Where,
    *,
    goal: Literal["image", "state"] = "image",
    overrides: Overrides = NO_OVERRIDES,
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
        overrides=as_arguments(overrides),
    )


def run_dagger(
    config: "Where | DaggerConfig",
    run: Where,
    out: Where,
    *,
    overrides: Overrides = NO_OVERRIDES,
    workers: int | None = None,
    resume: bool = False,
) -> dict[str, Any]:
    """Improve the policy of `run` in rounds of DAgger, as `playlearn dagger` does; returns `out`/results.json.

    Raises:
        UsageError: the config is wrong or does not fit the run, there is no such run, or `out` is taken.
        CheckpointError: the run was trained for another environment.
    """
    from playlearn.dagger import dagger

    given = resolve("dagger", config, overrides)
    return dagger(given, Path(run), Path(out), workers=workers, resume=resume)


def compare(
    config: "Where | CompareConfig", out: Where, *, overrides: Overrides = NO_OVERRIDES, workers: int | None = None
) -> list[dict[str, Any]]:
    """Train and evaluate variants of one config, as `playlearn compare` does; returns a row for each.

    Raises:
        UsageError: the config or a variant is wrong, or `out` holds another comparison.
        PlaylearnError: a run failed; the others are kept, and the same call goes on.
    """
    from playlearn.experiments.compare import compare as job

    return job(resolve("compare", config, overrides), Path(out), workers)


def export_policy(run: Where, out: Where) -> None:
    """Write a run's policy as one of LeRobot's, for `lerobot-eval --policy.path`.

    Raises:
        CheckpointError: there is no policy in `run`, or its weights are not finite.
        UsageError: `out` is taken, or the policy does not act.
    """
    from playlearn.lerobot.publish import export_policy as job

    job(Path(run), Path(out))
