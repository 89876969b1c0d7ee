"""Our policy as a LeRobot policy: takes its batches, returns its losses and actions.

It acts through the same actor as under `playlearn eval`; observations have LeRobot's names.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

from playlearn.batch import Batch, Inputs
from playlearn.config import to_dict
from playlearn.data import check_finite
from playlearn.data.statistics import statistics_of
from playlearn.episode import IMAGES, Array, Goal, Observation
from playlearn.errors import TrainingDiverged, UsageError
from playlearn.lerobot.configuration_playlearn import ACHIEVED, STATE, PlaylearnConfig, features
from playlearn.lerobot.goals import GOAL_IMAGES, GOAL_PROPRIO, GOAL_STATE
from playlearn.picture import Size, fits, read_picture, resized
from playlearn.policies import Policy, PolicySpec
from playlearn.policies.checkpoint import first_not_finite
from playlearn.policies.execution import PolicyActor
from playlearn.quantity import Quantities
from playlearn.store.lerobot.metadata import DatasetMetadata, load_metadata
from playlearn.training.divergence import not_finite

SLACK = 0.25  # by which an augmentation may leave [0, 1]
FRAME = ("episode_index", "frame_index")


class PlaylearnPolicy(PreTrainedPolicy):  # type: ignore[misc]
    """A new policy for a dataset with goals, or the one of `config.built`."""

    config_class = PlaylearnConfig
    name = "playlearn"

    def __init__(
        self, config: PlaylearnConfig, dataset_stats: Mapping[str, Any] | None = None, dataset_meta: Any = None
    ) -> None:
        """Raises UsageError where the dataset has no goals, or lacks an input of the policy, or `config` does."""
        super().__init__(config)
        self.config: PlaylearnConfig = config
        spec = config.spec()
        if spec is not None:
            self.policy = config.policy().build(spec, None, seed=0, fetch=False)
            self._check_config()
        else:
            self.policy = _fresh(config, dataset_stats, dataset_meta)
            description = {"config": to_dict(self.policy.config), "spec": asdict(self.policy.spec)}
            config.built = json.dumps(description)
        self._goal = self._goal_image()
        given = {GOAL_IMAGES + camera for camera in self._goal}  # not asked of a robot, whose cameras LeRobot compares
        config.input_features = {key: own for key, own in (config.input_features or {}).items() if key not in given}
        self._generator = torch.Generator().manual_seed(config.seed)
        self._updates = 0  # made so far, for what warms up
        self._actor: PolicyActor | None = None

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Parameter groups as in `playlearn train`: weight decay for matrices only."""
        matrices = [parameter for parameter in self.parameters() if parameter.ndim > 1]
        vectors = [parameter for parameter in self.parameters() if parameter.ndim <= 1]
        return [{"params": matrices}, {"params": vectors, "weight_decay": 0.0}]

    def reset(self) -> None:
        self._actor = None

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, float]]:
        """action (B, H, A), action_is_pad (B, H), and observations; a loss and its parts.

        Raises:
            UsageError: an input is missing or of another shape.
            TrainingDiverged: the loss is not finite.
        """
        inputs = self._inputs(batch, training=True)
        action = batch["action"]
        padded = batch.get("action_is_pad", torch.zeros(action.shape[:2], dtype=torch.bool))
        labeled = Batch(
            state=inputs.state,
            achieved=inputs.achieved,
            images=inputs.images,
            history_mask=inputs.history_mask,
            goal_achieved=inputs.goal_achieved,
            goal_proprio=inputs.goal_proprio,
            goal_images=inputs.goal_images,
            action=action.float(),
            action_mask=~padded.to(action.device),
            steps_to_goal=torch.zeros(len(action), dtype=torch.int64),
        )
        if self.training:
            loss, metrics = self.policy(labeled, self._generator, self._updates)
            self._updates += 1
        else:
            loss, metrics = self._evaluate(labeled)
        if not bool(torch.isfinite(loss.detach())):
            raise TrainingDiverged(
                f"training diverged: its loss is {float(loss.detach()):g}; {self._reason(labeled, batch)}"
            )
        return loss, {name: float(value) for name, value in metrics.items()}

    def predict_action_chunk(self, batch: Mapping[str, Tensor], **_: Any) -> Tensor:
        """(B, H, A) on the policy's device."""
        chunk = self.policy.act(self._inputs(batch), self._generator, self.config.guidance)
        return chunk.to(self.policy.device)

    def select_action(self, batch: Mapping[str, Tensor], **_: Any) -> Tensor:
        """(B, A) from the current chunk; the goal of an episode is the one in its first observation."""
        inputs = self._inputs(batch)
        observations, goals = _observations(inputs), _goals(inputs)
        if self._actor is None:
            half = max(1, self.policy.config.chunk // 2)
            modality = "image" if inputs.goal_images else "state"
            steps = self.config.n_action_steps or half
            self._actor = PolicyActor(self.policy, steps, self.config.guidance, goal=modality)
            self._actor.reset(goals, [self.config.seed + row for row in range(len(goals))])
        decisions = self._actor.act(observations, [True] * len(observations))
        return torch.from_numpy(np.stack([decision.action for decision in decisions])).to(self.policy.device)

    def _evaluate(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        return self.policy.loss(batch, torch.Generator().manual_seed(self.config.seed))

    def _save_pretrained(self, save_directory: Path, **options: Any) -> None:
        """Raises TrainingDiverged where a weight is not finite, so that what was saved before stays the last."""
        wrong = first_not_finite(self.policy)
        if wrong is not None:
            raise TrainingDiverged(f"training diverged: weight {wrong} is not finite; {save_directory} is not written")
        super()._save_pretrained(save_directory, **options)

    def _reason(self, labeled: Batch, batch: Mapping[str, Tensor]) -> str:
        """Why a loss is not finite: which number of which frame, or none of them."""
        found = not_finite(labeled, self.policy.spec)
        if found is None:
            return "its data are finite, so its updates are too large: lower policy.optimizer_lr"
        example, number = found
        frame = [f"{key.removesuffix('_index')} {int(batch[key][example])}" for key in FRAME if key in batch]
        return f"its data are to blame: {number} in {', '.join(frame) or f'example {example} of the batch'}"

    def _goal_image(self) -> dict[str, Tensor]:
        """Camera -> (h, w, 3) uint8 of the goal in a file, scaled as images of the play are; none without a file."""
        if self.config.goal is None:
            return {}
        cameras = self.policy.config.encoder.goal_cameras
        if len(cameras) != 1:
            seen = f"through {len(cameras)} cameras ({', '.join(cameras)})" if cameras else "as states"
            raise UsageError(f"policy.goal is one image, and this policy is shown goals {seen}: leave it out")
        size = self.policy.spec.cameras[cameras[0]]
        return {cameras[0]: torch.from_numpy(read_picture(Path(self.config.goal), size).copy())}

    def _check_config(self) -> None:
        """Raises UsageError where the config of a policy that is built lacks one of its inputs, as older exports do."""
        lacks = [
            key
            for key in features(self.policy.spec, self.policy.config)[0]
            if key not in (self.config.input_features or {})
        ]
        if lacks:
            raise UsageError(
                f"config.json has no input {', '.join(lacks)}, which the policy reads: export it again with "
                "`playlearn export policy RUN OUT`"
            )

    def _check(self, batch: Mapping[str, Tensor], *, training: bool) -> None:
        """Raises UsageError where an input is missing or of another shape."""
        encoder = self.policy.config.encoder
        either = {
            GOAL_IMAGES + camera for camera in self._goal
        }  # of a goal that is an image or a state, one is enough to act
        if len(encoder.goals) > 1 and not training:
            images = {GOAL_IMAGES + camera for camera in encoder.goal_cameras}
            either |= (
                {ACHIEVED, GOAL_STATE} if images <= batch.keys() | either else images if GOAL_STATE in batch else set()
            )
        for key, feature in features(self.policy.spec, self.policy.config, training=training)[0].items():
            if key not in batch and key not in either:
                raise UsageError(f"the policy reads {key}, and it is not among {', '.join(sorted(batch))}")
            shape = tuple(feature.shape)
            if key in batch and not _as_trained(tuple(batch[key].shape[-len(shape) :]), shape):
                found = tuple(batch[key].shape[1:])
                raise UsageError(f"the policy was trained on {key} of shape {shape}, here it is {found}")

    def _inputs(self, batch: Mapping[str, Tensor], *, training: bool = False) -> Inputs:
        """LeRobot's names and shapes to ours; images from (..., 3, h, w) in [0, 1] to (..., h, w, 3) uint8."""
        self._check(batch, training=training)
        encoder, spec = self.policy.config.encoder, self.policy.spec
        state = _over_time(batch[STATE].float(), 1)  # (B, T, S)
        num_achieved = len(spec.achieved_names)
        achieved, goal = state.new_zeros((*state.shape[:2], num_achieved)), state.new_zeros((len(state), num_achieved))
        if num_achieved and ACHIEVED in batch:
            achieved = _over_time(batch[ACHIEVED].float(), 1)[..., :num_achieved]
        if num_achieved and GOAL_STATE in batch:
            goal = _over_time(batch[GOAL_STATE].float(), 1)[:, -1]
        padded = batch.get(f"{STATE}_is_pad")
        proprio = _over_time(batch[GOAL_PROPRIO].float(), 1) if encoder.uses_goal_proprio else state
        goals = {camera: image.expand(len(state), *image.shape) for camera, image in self._goal.items()}
        for camera in encoder.goal_cameras:
            if GOAL_IMAGES + camera in batch and camera not in goals:
                goals[camera] = _seen(batch, GOAL_IMAGES + camera, spec.cameras[camera])[:, -1]
        return Inputs(
            state=state,
            achieved=achieved,
            history_mask=torch.ones(state.shape[:2], dtype=torch.bool) if padded is None else ~padded,
            goal_achieved=goal,
            goal_proprio=proprio[:, -1],
            images={c: _seen(batch, IMAGES + c, spec.cameras[c]) for c in encoder.observation_cameras},
            goal_images=goals,
        )


def _fresh(config: PlaylearnConfig, stats: Mapping[str, Any] | None, meta: Any) -> Policy:
    if stats is None or meta is None:
        raise UsageError("a fresh policy is made for a dataset: train it with lerobot-train, or give --policy.path")
    config.validate_features()
    dataset = load_metadata(meta.root)
    names = {key: dataset.names(key) for key in (STATE, ACHIEVED, GOAL_STATE, "action") if key in dataset.features}
    num_achieved = len(names.get(GOAL_STATE, ())) if ACHIEVED in names else 0
    sizes = {one.key.removeprefix(IMAGES): one.size for one in dataset.cameras.values() if one.key.startswith(IMAGES)}
    spec = PolicySpec(
        state_names=names[STATE],
        achieved_names=names.get(ACHIEVED, ())[:num_achieved],
        action_names=names["action"],
        fps=float(meta.fps),
        cameras={name: size for name, size in sizes.items() if not name.startswith("goal_")},
        quantities=_quantities(dataset, num_achieved),
    )
    rows = {key: _rows(meta, key) for key in (STATE, ACHIEVED, "action") if key in names}
    for key, own in rows.items():
        check_finite(own, names[key], f"{meta.root}: {key}")
    achieved = rows[ACHIEVED][:, :num_achieved] if ACHIEVED in rows else np.zeros((1, 0), np.float32)
    statistics = {
        "state": statistics_of(rows[STATE], spec.quantities.state),
        "achieved": statistics_of(achieved, spec.quantities.achieved),
        "action": statistics_of(rows["action"]),
    }
    policy = config.policy().build(spec, statistics, config.seed)
    lacks = [key for key in features(spec, policy.config, training=True)[0] if key not in meta.features]
    if lacks:
        raise UsageError(
            f"the policy reads {', '.join(lacks)}, which the dataset lacks: write it with `playlearn export lerobot "
            "STORE OUT --goals`, or give another recipe"
        )
    policy.fit_action_statistics(torch.from_numpy(rows["action"]))
    return policy


def _quantities(dataset: DatasetMetadata, num_achieved: int) -> Quantities:
    """What the dataset declares; of `achieved` the part that is not the goal."""
    return Quantities(dataset.quantities(STATE), dataset.quantities(ACHIEVED)[:num_achieved], dataset.bounds("action"))


def _rows(meta: Any, key: str) -> Array:
    """(n, D) every row of a column of numbers of a dataset."""
    column = pq.read_table(meta.root / "data", columns=[key])[key].combine_chunks()
    return np.asarray(column.flatten(), np.float32).reshape(len(column), -1)


def _over_time(value: Tensor, dims: int) -> Tensor:
    """(B, T, ...) from a value with or without a time axis; dims: of one moment."""
    return value if value.ndim == 2 + dims else value.unsqueeze(1)


def _as_trained(found: tuple[int, ...], shape: tuple[int, ...]) -> bool:
    """Whether an input has the shape that was trained on, or is an image that can be scaled to it."""
    images = len(found) == len(shape) == 3 and found[0] == shape[0]
    return found == shape or (images and fits((found[1], found[2]), (shape[1], shape[2])))


def _seen(batch: Mapping[str, Tensor], key: str, size: Size) -> Tensor:
    """(B, T, h, w, 3) uint8, scaled to the size that was trained on as images of the play were."""
    images = _over_time(_to_uint8(batch, key), 3)
    if tuple(images.shape[2:4]) == size:
        return images
    scaled = np.stack([resized(image, size) for image in images.flatten(0, 1).cpu().numpy()])
    return torch.from_numpy(scaled.reshape(*images.shape[:2], *size, 3)).to(images.device)


def _to_uint8(batch: Mapping[str, Tensor], key: str) -> Tensor:
    """Images (..., 3, h, w) as (..., h, w, 3) uint8; raises UsageError where they are neither that nor in [0, 1]."""
    images = batch[key]
    if images.dtype != torch.uint8 and images.numel():
        low, high = float(images.min()), float(images.max())
        if not -SLACK <= low <= high <= 1 + SLACK:
            raise UsageError(
                f"{key} is between {low:.3g} and {high:.3g}: give numbers from 0 to 1, or uint8, neither normalized "
                "nor scaled to 255"
            )
    values = images if images.dtype == torch.uint8 else (images * 255).round().clamp(0, 255).to(torch.uint8)
    return values.movedim(-3, -1)


def _observations(inputs: Inputs) -> list[Observation]:
    """The latest observation of each row."""
    state, achieved = (value[:, -1].cpu().numpy() for value in (inputs.state, inputs.achieved))
    images = {camera: value[:, -1].cpu().numpy() for camera, value in inputs.images.items()}
    return [
        Observation(state[row], achieved[row], {camera: value[row] for camera, value in images.items()})
        for row in range(len(state))
    ]


def _goals(inputs: Inputs) -> list[Goal]:
    achieved, proprio = inputs.goal_achieved.cpu().numpy(), inputs.goal_proprio.cpu().numpy()
    images = {camera: value.cpu().numpy() for camera, value in inputs.goal_images.items()}
    return [
        Goal(achieved[row], {camera: value[row] for camera, value in images.items()}, proprio[row])
        for row in range(len(achieved))
    ]
