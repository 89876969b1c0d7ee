"""Recordings of real arms: each becomes a policy, or ends before training with one sentence that says what to do."""

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from playlearn.config import load_config
from playlearn.episode import Array
from playlearn.errors import StoreError, UsageError
from playlearn.policies import Policy
from playlearn.privileges import Privileges
from playlearn.training import TrainConfig, train
from tests.lerobot_dataset import add_column, encoded, image, vector, write_dataset
from tests.real_robot import JOINTS, NAMES, arm, pictures, recorded

ROOT = Path(__file__).parents[2]
SMALL = ("steps: 3", "warmup: 1", "val_batches: 0", "batch_size: 8", "policy.trunk.width: 16", "policy.trunk.layers: 1")


def settings(name: str, root: Path, *more: str) -> TrainConfig:
    """A shipped config on a dataset, made small."""
    given = {"store.root": str(root), "store.cache": str(root.parent / "frames"), "cpu": "true"}
    pairs = [f"--{key}={value}" for key, value in given.items()]
    pairs += [f"--{text.replace(': ', '=', 1)}" for text in (*SMALL, *more)]
    return load_config(TrainConfig, ROOT / "configs" / "train" / f"{name}.yaml", pairs)


def arms(seconds: float = 5, fps: float = 30, count: int = 2, **more: Any) -> list[Array]:
    return [arm(seconds, fps, seed, **more) for seed in range(count)]


def still(count: int = 60) -> Array:
    return np.repeat(arm(1, 30)[:1], count, axis=0)


def without_gripper(root: Path) -> Path:
    return recorded(root, [one[:, :5] for one in arms()], names=JOINTS)


def two_arms(root: Path) -> Path:
    names = [f"{side}_{name}" for side in ("left", "right") for name in NAMES]
    return recorded(root, [np.concatenate([one, arm(5, 30, 7)], axis=1) for one in arms()], names=names)


def constant(root: Path) -> Path:
    episodes = arms()
    for one in episodes:
        one[:, 4] = 3.0
    return recorded(root, episodes)


def partly_still(root: Path) -> Path:
    return recorded(root, [*arms(), still()])


def dotted(root: Path) -> Path:
    return recorded(root, arms(), names=["arm.left.1", "arm.left.2", "x.", ".y", "a b", "my.gripper.pos"])


DATASETS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "no gripper": (without_gripper, r"no gripper \(\*gripper\*\): every stop of the arm"),
    "two arms": (two_arms, r"one gripper is read, and not right_gripper\.pos: `data\.settling\.robot\.gripper`"),
    "a constant column": (constant, r"gripper \(gripper\.pos\) has opened"),
    "an episode that settles nowhere": (partly_still, r"1 of 3 episodes have no settled moment: 2\n"),
    "10 fps": (lambda root: recorded(root, arms(fps=10), fps=10), r"closed where it reads low"),
    "50 fps": (lambda root: recorded(root, arms(fps=50), fps=50), r"closed where it reads low"),
    "names with dots": (dotted, r"the gripper \(my\.gripper\.pos\) has opened .* the arm \(arm\.left\.1, "),
}


@pytest.mark.parametrize("name", DATASETS)
def test_numbers_alone_become_a_policy(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make, said = DATASETS[name]
    train(settings("lerobot", make(tmp_path / "data"), "data.val_fraction: 0"), tmp_path / "run")
    assert Policy.load(tmp_path / "run" / "policy").config.encoder.uses_goal_proprio
    assert str(Privileges.of_run(tmp_path / "run")) == "none"
    heard = capsys.readouterr().err
    assert re.search(said, heard), heard


@pytest.mark.parametrize(("closed", "opened"), [(100.0, 0.0), (0.0, 100.0), (1.2, -0.1), (0.0, 0.04)])
def test_moments_are_where_the_gripper_has_opened(closed: float, opened: float, tmp_path: Path) -> None:
    """In percent, radians or meters, whichever way it closes: once that is said, they are the same."""

    def moments(gripper: Sequence[float], closes: str) -> list[int]:
        root = tmp_path / f"{gripper[0]:g}"
        if not root.exists():
            recorded(root, arms(8, gripper=gripper))
        config = settings("lerobot", root, f"data.settling.robot.gripper_closes: {closes}", "data.val_fraction: 0")
        table = config.data.build(config.store.build(), "train", 0).table  # type: ignore[union-attr]
        return [int(moment) for moment in table.moments]

    found, usual = moments((closed, opened), "high" if closed > opened else "low"), moments((5.0, 60.0), "low")
    assert len(usual) == 4
    np.testing.assert_allclose(found, usual, atol=3)  # observations, of 30 a second


REFUSED: dict[str, tuple[Callable[[Path], Path], Sequence[str], str]] = {
    "nothing settles": (
        lambda root: recorded(root, [still()] * 2),
        ("data.val_fraction: 0",),
        r"no train step has a goal .* 0 settled moments\); settled where the gripper .*`--data\.goals\.type future`",
    ),
    "the gripper has another name": (
        lambda root: recorded(root, [still()] * 2, names=[*JOINTS, "jaw"]),
        ("data.val_fraction: 0",),
        r"no gripper \(\*gripper\*\): .*unless `data\.settling\.robot\.gripper` names it",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_shows_no_goal_is_told_before_training(name: str, tmp_path: Path) -> None:
    make, more, said = REFUSED[name]
    with pytest.raises(StoreError, match=said):
        train(settings("lerobot", make(tmp_path / "data"), *more), tmp_path / "run")
    assert not (tmp_path / "run" / "config.yaml").exists()


CAMERAS = ("policy.encoder.goal_camera: up", "store.image_size: null", "policy.encoder.features: 16")


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras of different sizes; beside them depth, one channel, and four."""
    root, episodes = tmp_path_factory.mktemp("filmed") / "data", arms(4)
    rows = np.concatenate(episodes)
    frames = {"up": pictures(rows, 24, 32), "hand": pictures(rows, 20, 20)}
    gray = frames["up"][..., 0]
    others = {
        "depth": ({**image(24, 32, 1), "info": {"is_depth_map": True}}, encoded(gray.astype(np.uint16) * 100)),
        "gray": (image(24, 32, 1), encoded(gray)),
        "rgba": (image(24, 32, 4), encoded(np.concatenate([frames["up"], gray[..., None]], axis=-1))),
    }
    features: dict[str, Any] = {"observation.state": vector(list(NAMES)), "action": vector(list(NAMES))}
    columns: dict[str, Any] = {"observation.state": rows.tolist(), "action": rows.tolist()}
    for name, own in frames.items():
        features[f"observation.images.{name}"] = image(*own.shape[1:])
        columns[f"observation.images.{name}"] = encoded(own)
    for name, (feature, cells) in others.items():
        features[f"observation.images.{name}"], columns[f"observation.images.{name}"] = feature, cells
    return write_dataset(root, features, columns, [len(one) for one in episodes], fps=30)


def test_images_of_two_sizes_become_a_policy_of_goal_images(filmed: Path, tmp_path: Path) -> None:
    config = settings("lerobot_image", filmed, *CAMERAS, "policy.encoder.cameras: [up, hand]", "data.val_fraction: 0")
    train(config, tmp_path / "run")
    policy = Policy.load(tmp_path / "run" / "policy")
    assert policy.spec.cameras == {"up": (24, 32), "hand": (20, 20)}
    assert policy.config.encoder.goals == ("image",)
    assert json.loads((tmp_path / "run" / "run.json").read_text())["privileged"] == Privileges().to_dict()


@pytest.mark.parametrize(("camera", "why"), [("depth", "a depth map"), ("gray", "one channel"), ("rgba", "4 channels")])
def test_a_camera_that_is_no_color_camera_is_refused_with_the_reason(
    camera: str, why: str, filmed: Path, tmp_path: Path
) -> None:
    more = ("store.image_size: null", f"policy.encoder.cameras: [{camera}]", f"policy.encoder.goal_camera: {camera}")
    said = (
        rf"no images of {camera} \(it has: up 24x32, hand 20x20\); observation\.images\.{camera} is left out: .*{why}"
    )
    with pytest.raises(UsageError, match=rf"{said}.*--policy\.encoder\.cameras '\[up, hand\]'"):
        train(settings("lerobot_image", filmed, *more), tmp_path / "run")


def test_what_a_blind_run_does_not_read_may_be_broken(tmp_path: Path) -> None:
    """Objects that are not finite, and all relative to the hand; a rule of success for rewards that are not there."""
    root = recorded(tmp_path / "data", arms())
    states = [row for one in arms() for row in one[:, :2].tolist()]
    states[3][0] = float("nan")
    add_column(root, "observation.environment_state", vector(["cup.x", "cup.y"]), states)
    with pytest.raises(StoreError, match=r"observation\.environment_state is not finite at frame 3"):
        train(settings("lerobot_objects", root), tmp_path / "refused")
    config = settings("lerobot", root, "data.val_fraction: 0", "store.success: reward>=1")
    train(config, tmp_path / "run")
    assert Policy.load(tmp_path / "run" / "policy").spec.achieved_names == ()


def test_what_is_predicted_is_not_shown(tmp_path: Path) -> None:
    root = recorded(tmp_path / "data", arms())
    for part in ("state", "achieved"):
        with pytest.raises(
            StoreError, match=rf"'action' is named as `action` and as `{part}`: a policy would be shown"
        ):
            train(settings("lerobot_objects", root, f"store.{part}: action"), tmp_path / "run")


def test_a_robot_whose_state_is_not_one_vector_is_told_so(tmp_path: Path) -> None:
    rows = np.concatenate(arms())
    parts = {"observation.state.arm": rows[:, :5], "observation.state.hand": rows[:, 5:]}
    features = {key: vector(None, own.shape[1]) for key, own in parts.items()} | {"action": vector(list(NAMES))}
    columns = {key: own.tolist() for key, own in parts.items()} | {"action": rows.tolist()}
    several = write_dataset(tmp_path / "several", features, columns, [len(one) for one in arms()], fps=30)
    with pytest.raises(
        StoreError, match=r"it has observation\.state\.arm, observation\.state\.hand: set `state` to one"
    ):
        train(settings("lerobot", several), tmp_path / "run")
    alone = {"action": vector(list(NAMES))}, {"action": rows.tolist()}
    none = write_dataset(tmp_path / "none", *alone, [len(one) for one in arms()], fps=30)
    with pytest.raises(StoreError, match=r"no feature 'observation\.state' .*no other vector of numbers"):
        train(settings("lerobot", none), tmp_path / "run")


def test_one_episode_and_images_of_a_few_pixels_are_told_what_to_do(tmp_path: Path) -> None:
    one = recorded(tmp_path / "one", arms(4, count=1), cameras={"up": (4, 4)})
    with pytest.raises(StoreError, match=r"no train episodes among its 1: .*`data\.val_fraction: 0`"):
        train(settings("lerobot", one), tmp_path / "run")
    tiny = (*CAMERAS, "policy.encoder.cameras: [up]", "data.val_fraction: 0")
    with pytest.raises(UsageError, match=r"images of 4x4 pixels are too small .*`image_size`"):
        train(settings("lerobot_image", one, *tiny), tmp_path / "run")
    assert not (tmp_path / "run" / "config.yaml").exists()


def test_the_config_that_fits_is_named(filmed: Path, tmp_path: Path) -> None:
    bare = recorded(tmp_path / "bare", arms())
    with pytest.raises(UsageError, match=r"records none: .*configs/train/lerobot\.yaml.*configs/train/lerobot_image"):
        train(settings("lerobot_objects", bare), tmp_path / "run")
    with pytest.raises(UsageError, match=r"no images of front, wrist \(it has: none\); .*configs/train/lerobot\.yaml"):
        train(settings("lerobot_image", bare), tmp_path / "run")
    with pytest.raises(UsageError, match=r"it has: none\); observation\.images\.up is left out: `without_images`"):
        train(settings("lerobot_image", filmed, *CAMERAS, "store.without_images: true"), tmp_path / "run")
    assert not (tmp_path / "run" / "config.yaml").exists()
