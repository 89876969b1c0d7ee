"""A robot observes no goals and has larger cameras: the goal is read from a file, images are scaled as play's were."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from playlearn.errors import UsageError
from playlearn.lerobot.publish import export_policy
from playlearn.picture import resized
from tests.policies.parts import SPEC, policy

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]  # LeRobot's and the packages' below it
JOINTS = ("eef.x", "eef.y", "gripper")


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy that sees 16x16 images, of goals too."""
    folder = tmp_path_factory.mktemp("run")
    policy("cnn", encoder_options={"cameras": ["front", "wrist"], "goal_camera": "front"}).save(folder / "policy")
    export_policy(folder, folder / "exported")
    return folder / "exported"


@pytest.fixture(scope="module")
def goal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("goal") / "goal.png"
    Image.fromarray(np.random.default_rng(1).integers(0, 255, (48, 48, 3)).astype(np.uint8)).save(path)
    return path


def loaded(exported: Path, **settings: Any) -> Any:
    from playlearn.lerobot.configuration_playlearn import PlaylearnConfig
    from playlearn.lerobot.modeling_playlearn import PlaylearnPolicy

    config = PlaylearnConfig.from_pretrained(exported)
    for name, value in settings.items():
        setattr(config, name, value)
    return PlaylearnPolicy.from_pretrained(exported, config=config, strict=True)


def observed(size: int) -> dict[str, torch.Tensor]:
    large = np.random.default_rng(0).integers(0, 255, (2, 32, 32, 3)).astype(np.uint8)
    images = [torch.from_numpy(resized(image, (size, size)).copy()).permute(2, 0, 1)[None] for image in large]
    return {
        "observation.state": torch.zeros(1, len(JOINTS)),
        "observation.images.front": images[0],
        "observation.images.wrist": images[1],
    }


def test_a_goal_from_a_file_is_the_goal_that_is_observed(exported: Path, goal: Path) -> None:
    small = resized(np.asarray(Image.open(goal)), (16, 16)).copy()
    given = {"observation.images.goal_front": torch.from_numpy(small).permute(2, 0, 1)[None]}
    expected = loaded(exported).predict_action_chunk(observed(16) | given)
    robot = loaded(exported, goal=str(goal))
    assert set(robot.config.input_features) == set(observed(16))
    assert torch.equal(robot.predict_action_chunk(observed(32)), expected)
    assert torch.equal(robot.predict_action_chunk(observed(32) | {k: 0 * v for k, v in given.items()}), expected)


def test_what_is_no_goal_is_refused_before_a_robot_moves(exported: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"none.png cannot be read"):
        loaded(exported, goal=str(tmp_path / "none.png"))
    folder = tmp_path / "run"
    policy("state").save(folder / "policy")
    export_policy(folder, tmp_path / "state")
    with pytest.raises(UsageError, match=r"shown goals as states: leave it out"):
        loaded(tmp_path / "state", goal=str(tmp_path / "none.png"))


def test_an_image_of_another_shape_is_refused(exported: Path, goal: Path) -> None:
    wide = {"observation.images.front": torch.zeros(1, 3, 32, 48)}
    with pytest.raises(UsageError, match=r"trained on observation.images.front of shape \(3, 16, 16\), here it is"):
        loaded(exported, goal=str(goal)).predict_action_chunk(observed(32) | wide)


def test_lerobots_own_rollout_drives_a_robot_to_it(exported: Path, goal: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With an arm that only remembers what it was sent; LeRobot's command as it is."""
    from lerobot.robots import Robot, RobotConfig
    from lerobot.scripts import lerobot_rollout
    from lerobot.utils.import_utils import register_third_party_plugins

    sent: list[dict[str, float]] = []

    @RobotConfig.register_subclass("remembering_arm")
    @dataclass
    class RememberingArmConfig(RobotConfig):
        pass

    class RememberingArm(Robot):
        config_class, name = RememberingArmConfig, "remembering_arm"
        is_connected = is_calibrated = True
        action_features = dict.fromkeys((f"{joint}.pos" for joint in JOINTS), float)
        observation_features = action_features | dict.fromkeys(("front", "wrist", "side"), (32, 32, 3))

        def connect(self, calibrate: bool = True) -> None: ...
        def calibrate(self) -> None: ...
        def configure(self) -> None: ...
        def disconnect(self) -> None: ...

        def get_observation(self) -> dict[str, Any]:
            images = {name: np.full((32, 32, 3), 90, np.uint8) for name in ("front", "wrist", "side")}
            return {f"{joint}.pos": 0.0 for joint in JOINTS} | images

        def send_action(self, action: dict[str, float]) -> dict[str, float]:
            sent.append(action)
            return action

    monkeypatch.setattr("lerobot.rollout.context.make_robot_from_config", RememberingArm)
    settings = {
        "robot.type": "remembering_arm",
        "policy.path": exported,
        "policy.goal": goal,
        "duration": 1,
        "fps": 10,
        "device": "cpu",
        "return_to_initial_position": "false",
        "play_sounds": "false",
    }
    monkeypatch.setattr(sys, "argv", ["lerobot-rollout", *(f"--{name}={value}" for name, value in settings.items())])
    register_third_party_plugins()
    lerobot_rollout.rollout()
    assert sent
    assert set(sent[0]) == {f"{joint}.pos" for joint in JOINTS}
    assert SPEC.cameras["front"] == (16, 16)
