"""`import playlearn as pl`: quick, typed, and its verbs are never taken by a module of the same name."""

import importlib
import inspect
import pkgutil
import subprocess
import sys
import typing
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

import playlearn as pl
from playlearn import api
from playlearn.api import configs
from playlearn.errors import CheckpointError, PlaylearnError, StoreError, UsageError
from tests import fakes

ROOT = Path(__file__).resolve().parents[1]
SAMPLE, POLICY = ROOT / "datasets" / "sample", ROOT / "eval" / "pretrained" / "state"
SUITE = ROOT / "eval" / "suites" / "playtable_tasks.yaml"
ROOMS = [module.name for module in pkgutil.iter_modules(pl.__path__)]


def python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=True)
    return done.stdout.strip()


def refused(kind: type[Exception], call: Callable[[], object]) -> None:
    with pytest.raises(kind):
        call()


def quick_calls(out: Path) -> Mapping[str, Callable[[], object]]:
    """One call of each verb: a whole one where that is quick, else one that finds at once that something is missing."""
    env = fakes.PointConfig().build()
    env.reset(0)
    nowhere = out / "nowhere"
    return {
        "make_env": lambda: pl.make_env("point", diverge_at=3).step(np.zeros(3, np.float32)),
        "load_policy": lambda: pl.load_policy(POLICY).cameras,
        "make_actor": lambda: pl.make_actor("random", env).reset([None], [0]),
        "make_goal": lambda: pl.make_goal(env, ["front"]).images["front"].shape,
        "run_rollout": lambda: pl.run_rollout(env, pl.make_actor("random", env), max_steps=2),
        "open_store": lambda: len(pl.open_store(SAMPLE)),
        "make_dataset": lambda: len(pl.make_dataset(SAMPLE, overrides={"chunk": 2})),
        "load_config": lambda: pl.load_config("train", overrides={"policy.head.type": "flow"}).policy.head,
        "load_goal": lambda: refused(UsageError, lambda: pl.load_goal(pl.load_policy(POLICY), {"top": nowhere})),
        "load_suite": lambda: pl.load_suite(SUITE, {"episodes": 3}),
        "collect": lambda: refused(UsageError, lambda: pl.collect(nowhere, out)),
        "train": lambda: refused(
            StoreError, lambda: pl.train(pl.load_config("train", None, {"store": str(nowhere)}), out)
        ),
        "evaluate": lambda: refused(CheckpointError, lambda: pl.evaluate(nowhere, SUITE, out)),
        "diagnose": lambda: refused(CheckpointError, lambda: pl.diagnose(nowhere, SUITE, out)),
        "run_dagger": lambda: refused(UsageError, lambda: pl.run_dagger(pl.load_config("dagger"), nowhere, out)),
        "compare": lambda: refused(UsageError, lambda: pl.compare(nowhere, out)),
        "export_lerobot": lambda: refused(StoreError, lambda: pl.export_lerobot(nowhere, out)),
        "export_policy": lambda: refused(CheckpointError, lambda: pl.export_policy(nowhere, out)),
    }


def test_the_import_brings_in_nothing_heavy() -> None:
    heavy = "{'torch', 'numpy', 'mujoco', 'robosuite', 'gymnasium', 'lerobot', 'yaml', 'draccus'}"
    assert python(f"import sys, playlearn; dir(playlearn); print({heavy} & set(sys.modules))") == "set()"


def test_every_verb_works_twice_and_again_when_every_room_is_imported(tmp_path: Path) -> None:
    calls = quick_calls(tmp_path)
    assert sorted(calls) == sorted(pl.__all__)
    for _ in range(2):
        for call in calls.values():
            call()
    for room in ROOMS:
        importlib.import_module(f"playlearn.{room}")
        for name in pl.__all__:
            assert getattr(pl, name) is getattr(api, name), f"{name} after playlearn.{room}"
    for call in calls.values():
        call()


def test_no_module_is_called_like_a_verb() -> None:
    assert len(ROOMS) > 20
    assert not set(ROOMS) & set(pl.__all__)


def test_the_package_hands_on_exactly_the_verbs_with_their_documentation() -> None:
    assert sorted(api.__all__) == sorted(pl.__all__)
    assert set(pl.__all__) <= set(dir(pl))
    for name in pl.__all__:
        verb = getattr(pl, name)
        assert inspect.isfunction(verb)
        assert len(verb.__doc__ or "") > 40
        assert name in (pl.__doc__ or "")
        parameters = inspect.signature(verb).parameters.values()
        assert all(one.annotation is not inspect.Parameter.empty for one in parameters)
        assert inspect.signature(verb).return_annotation is not inspect.Signature.empty
    with pytest.raises(AttributeError, match="no attribute 'trian'"):
        pl.trian  # noqa: B018


def test_a_type_checker_sees_the_signatures() -> None:
    """The names that `__getattr__` resolves are imported under TYPE_CHECKING, from where they are defined."""
    source = inspect.getsource(pl)
    block = source.split("if TYPE_CHECKING:")[1].split("__version__")[0]
    assert all(f"        {name},\n" in block for name in pl.__all__)
    assert set(typing.get_args(configs.ConfigName.__value__)) == set(configs.CONFIGS)


def test_an_actor_reaches_a_goal_and_the_rollout_stops_there() -> None:
    env = fakes.PointConfig().build()
    env.reset(0)  # the hand is far from the button and the puck, so that nothing changes at random
    goal = pl.make_goal(env)
    assert sorted(goal.images) == ["front", "wrist"]  # all cameras of the environment
    outcome = pl.run_rollout(env, pl.make_actor("random", env), goal, max_steps=50)
    assert (outcome.ended, outcome.steps) == ("stopped", 1)  # it had been there from the start
    assert pl.run_rollout(env, pl.make_actor("random", env), max_steps=7).steps == 7  # nothing to stop for


def test_a_policy_is_refused_an_environment_of_other_numbers() -> None:
    env = fakes.PointConfig().build()
    env.reset(0)
    refused(PlaylearnError, lambda: pl.make_actor(pl.load_policy(POLICY), env))


def test_overrides_are_those_of_the_command_line() -> None:
    config = pl.load_config("train", overrides={"policy.head.type": "flow", "policy.head.blocks": 2, "steps": 7})
    assert (type(config.policy.head).__name__, config.steps) == ("FlowConfig", 7)
    with pytest.raises(UsageError, match="no config 'trian'; did you mean `train`"):
        pl.load_config("trian")  # type: ignore[call-overload]
    with pytest.raises(UsageError, match="overrides go with a file"):
        pl.train(config, "out", overrides={"steps": 8})


def test_a_dataset_is_cut_as_its_overrides_say() -> None:
    play = pl.make_dataset(pl.open_store(SAMPLE), overrides={"history": 2, "chunk": 4, "goals.ahead": 2})
    batch = play.batch(0, play.epoch_indices(0)[:3])
    assert batch.action.shape[:2] == (3, 4)
    assert batch.state.shape[:2] == (3, 2)


@pytest.mark.slow
def test_the_jobs_run_one_after_the_other(tmp_path: Path) -> None:
    """Play, training, evaluation, in Python alone."""
    collecting = pl.load_config("collect", overrides={"episodes": 2, "steps": 20})
    assert len(pl.collect(collecting, tmp_path / "play", workers=0)) == 2
    fields = {"steps": 2, "val_every": 2, "data.val_fraction": 0.0, "policy.encoder.hidden": 16, "warmup": 1}
    training = pl.load_config("train", overrides={"store": str(SAMPLE), **fields})
    policy = pl.train(training, tmp_path / "run")
    assert policy.config.encoder.hidden == 16
    assert pl.load_policy(tmp_path / "run").spec == policy.spec
    results = pl.evaluate(
        tmp_path / "run", SUITE, tmp_path / "eval", goal="state", episodes=1, workers=0, baselines=False
    )
    assert results["episodes"] == 1
