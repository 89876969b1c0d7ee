"""Our policies under LeRobot's own commands: what `--policy.type=playlearn` and `--policy.path=...` read.

LeRobot finds the parts by their names: `configuration_playlearn`, `modeling_playlearn`, `processor_playlearn`.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.configs.policies import PreTrainedConfig
from lerobot.optim import AdamWConfig

from playlearn.config import from_dict, load_config
from playlearn.episode import IMAGES
from playlearn.errors import UsageError
from playlearn.layout import ObjectLayout
from playlearn.lerobot.goals import GOAL_IMAGES, GOAL_PROPRIO, GOAL_STATE
from playlearn.policies import PolicyConfig, PolicySpec
from playlearn.training import TrainConfig

STATE, ACHIEVED = "observation.state", "observation.environment_state"


@PreTrainedConfig.register_subclass("playlearn")
@dataclass
class PlaylearnConfig(PreTrainedConfig):  # type: ignore[misc]
    """LeRobot's config of a policy.

    recipe: YAML file of `playlearn train` whose `policy:` block is used (null: defaults).
    built: config and spec of a policy, as JSON; written by playlearn, and used instead of the recipe.
    n_action_steps: actions of a chunk that are executed before the next plan (null: half of the chunk).
    guidance: weight of the goal (null: no guidance).
    goal: file with the goal image, for a robot, which observes no goals (null: goals are observed).
    seed: of the policy's noise when it acts.
    optimizer_lr: learning rate of AdamW.
    optimizer_weight_decay: of AdamW.
    normalization_mapping: LeRobot's own; all identity, as the policy normalizes by itself.
    """

    recipe: str | None = None
    built: str | None = None
    n_action_steps: int | None = None
    guidance: float | None = None
    goal: str | None = None
    seed: int = 0
    optimizer_lr: float = 5e-4
    optimizer_weight_decay: float = 1e-3
    # The policy normalizes by itself, with statistics that are stored among its weights.
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: dict.fromkeys(("VISUAL", "STATE", "ENV", "ACTION"), NormalizationMode.IDENTITY)
    )

    def policy(self) -> PolicyConfig:
        """The policy's config; raises UsageError if the recipe has none."""
        if self.built is not None:
            return from_dict(PolicyConfig, json.loads(self.built)["config"])
        return PolicyConfig() if self.recipe is None else load_config(TrainConfig, Path(self.recipe)).policy

    def spec(self) -> PolicySpec | None:
        """The spec that it was built for; None if it is not built yet."""
        return None if self.built is None else PolicySpec.from_dict(json.loads(self.built)["spec"])

    def validate_features(self) -> None:
        """Raises UsageError if there is no goal among the inputs."""
        goals = (GOAL_STATE, GOAL_PROPRIO, GOAL_IMAGES)
        if not any(key.startswith(goals) for key in self.input_features or {}):
            raise UsageError(
                "this dataset has no goals: write it with `playlearn export lerobot STORE OUT --goals`, or train with "
                "`playlearn train`, which samples goals while training (`store: {type: lerobot, root: ...}`)"
            )

    def get_optimizer_preset(self) -> AdamWConfig:
        return AdamWConfig(lr=self.optimizer_lr, weight_decay=self.optimizer_weight_decay, grad_clip_norm=1.0)

    def get_scheduler_preset(self) -> None:
        return None

    @property
    def observation_delta_indices(self) -> list[int] | None:
        history = self.policy().history
        return None if history == 1 else list(range(1 - history, 1))

    @property
    def action_delta_indices(self) -> list[int]:
        return list(range(self.policy().chunk))

    @property
    def reward_delta_indices(self) -> None:
        return None


def features(
    spec: PolicySpec, policy: PolicyConfig, *, training: bool = False
) -> tuple[dict[str, PolicyFeature], dict[str, PolicyFeature]]:
    """Inputs and outputs of a policy as LeRobot's features; images are channel first.

    training: with what training alone reads.
    """
    state, goal, encoder = len(spec.state_names), len(spec.achieved_names), policy.encoder
    features: dict[str, Any] = {STATE: (FeatureType.STATE, (state,))}
    supervised = training and encoder.supervised
    if ("state" in encoder.goals and goal) or supervised:
        features[ACHIEVED] = (FeatureType.ENV, (2 * goal,))
        if ObjectLayout(spec.achieved_names).select(encoder.goal_names) or supervised:
            features[GOAL_STATE] = (FeatureType.STATE, (goal,))
    if encoder.uses_goal_proprio:
        features[GOAL_PROPRIO] = (FeatureType.STATE, (state,))
    for prefix, cameras in ((IMAGES, encoder.observation_cameras), (GOAL_IMAGES, encoder.goal_cameras)):
        features |= {prefix + camera: (FeatureType.VISUAL, (3, *spec.cameras[camera])) for camera in cameras}
    inputs = {key: PolicyFeature(type=kind, shape=shape) for key, (kind, shape) in features.items()}
    return inputs, {"action": PolicyFeature(type=FeatureType.ACTION, shape=(len(spec.action_names),))}
