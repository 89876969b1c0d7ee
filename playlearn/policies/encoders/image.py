"""What image encoders with one vector a camera share: fusion of observation and goal, state supervision."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from playlearn.batch import Inputs
from playlearn.errors import UsageError
from playlearn.policies.encoders.base import Encoder, Tokens
from playlearn.policies.encoders.cameras import CamerasConfig, PerCamera, pixels, random_shift
from playlearn.policies.encoders.goal_state import GoalStateEncoder
from playlearn.policies.encoders.objects import ObjectTokens, mlp
from playlearn.policies.spec import Named, PolicySpec


@dataclass(frozen=True)
class ImageConfig(CamerasConfig):
    """The fields that each of them has.

    fusion: `early` stacks observation and goal along the channels; `late` runs one network over each.
    features: width of a camera's feature vector.
    state_supervision: weight of a loss that predicts `achieved` from images, in training only (privileged).
    use_estimated_state: whether the policy reads the estimated achieved of observation and goal and their difference,
        as the state encoder reads the true ones; a goal state needs no estimate.
    feed_cameras: the cameras whose features the policy reads beside them (null: all).
    detach_estimate: whether the estimates get no gradient from the policy's own loss.
    linear_estimate: whether a linear map of the features is added to the small network of the estimates.
    """

    fusion: Literal["early", "late"] = "early"
    features: int = 256
    state_supervision: float = 0.0
    use_estimated_state: bool = False
    feed_cameras: tuple[str, ...] | None = None
    detach_estimate: bool = True
    linear_estimate: bool = False

    @property
    def needs_achieved(self) -> bool:
        return "state" in self.goals or self.use_estimated_state

    @property
    def supervised(self) -> bool:
        return self.state_supervision > 0

    def check_goal(self, spec: Named, where: str = "this play") -> None:
        if self.supervised and not spec.achieved_names:
            raise UsageError(
                f"encoder.state_supervision: {where} records no objects (`achieved`) that images could be supervised "
                "with; leave it at 0"
            )
        super().check_goal(spec, where)

    def backbone(self, channels: int, size: tuple[int, int], *, fetch: bool) -> nn.Module:
        """(B, channels, h, w) in [-1, 1] -> (B, features)."""
        raise NotImplementedError

    def build(self, spec: PolicySpec, width: int, *, fetch: bool = True) -> "ImageEncoder":
        self.check_build()
        return ImageEncoder(self, spec, width, fetch=fetch)

    def check_build(self) -> None:
        """Raises UsageError where the fields contradict each other."""
        self.check()
        if self.use_estimated_state and self.state_supervision <= 0:
            raise UsageError(
                "encoder.use_estimated_state needs encoder.state_supervision above 0: nothing else trains it"
            )
        unknown = set(self.feed_cameras or ()) - set(self.cameras)
        if unknown:
            raise UsageError(f"encoder.feed_cameras: {min(unknown)!r} is not among encoder.cameras {self.cameras}")
        goal_fed = self.feed_cameras is None or self.goal_camera in self.feed_cameras
        if not goal_fed and not self.use_estimated_state and self.goal != "state":
            raise UsageError(
                "encoder.feed_cameras without the goal's camera needs encoder.use_estimated_state: no goal is given"
            )


class ImageEncoder(Encoder):
    """A goal token, then for each step one token a camera and one for the robot's own state.

    The goal token encodes whether there is a goal, and the goal itself where it is a state or fused late.

    With `use_estimated_state` there is also a token an object, from the estimated achieved of observation and goal. The
    true `achieved` is read in `auxiliary` alone.
    """

    def __init__(self, config: ImageConfig, spec: PolicySpec, width: int, *, fetch: bool) -> None:
        super().__init__()
        self.config = config
        self.fused = config.fusion == "early" and "image" in config.goals
        size = spec.cameras[config.goal_camera]
        others = [camera for camera in config.cameras if camera != config.goal_camera]
        self.front = config.backbone(6 if self.fused else 3, size, fetch=fetch)
        self.others = PerCamera({camera: config.backbone(3, spec.cameras[camera], fetch=fetch) for camera in others})
        features, state = config.features, len(spec.state_names)
        fed = config.cameras if config.feed_cameras is None else config.feed_cameras
        self.project = PerCamera({camera: nn.Linear(features, width) for camera in fed})
        goal_fed = config.goal_camera in fed and not self.fused and "image" in config.goals
        self.project_goal = nn.Linear(features, width) if goal_fed else None
        # without a goal, with one, and where a goal may be either, with a goal state
        self.goal_flag = nn.Parameter(torch.randn(1 + len(config.goals), width) * 0.02)
        self.goal_tokens, self.step_tokens = 1, len(fed) + 1

        self.estimate = _Estimate(config, len(spec.achieved_names), state) if config.state_supervision > 0 else None
        self.objects: ObjectTokens | None = None
        self.proprio: nn.Module | None = None
        self.goal_encoder: GoalStateEncoder | None = None
        if config.use_estimated_state:
            self.objects = ObjectTokens(spec, config.goal_names, config.hidden, width)
            self.step_tokens += self.objects.count - 1
        else:
            self.proprio = mlp(state, config.hidden, width)
            if "state" in config.goals:
                self.goal_encoder = GoalStateEncoder(spec, config.goal_names, config.hidden, width)

    def forward(self, inputs: Inputs, keep: Tensor, generator: torch.Generator | None = None) -> Tokens:
        config = self.config
        has_image = config.has_goal_image(inputs, generator)  # (B,)
        encoded = self._encode(inputs, keep & has_image, generator)
        step_tokens = [project(encoded.cameras[camera]).unsqueeze(2) for camera, project in self.project.networks()]

        flag = keep.long() if len(config.goals) == 1 else keep * (2 - has_image.long())
        goal_token = self.goal_flag[flag]  # (B, D)
        if self.project_goal is not None and encoded.goal is not None:
            goal_token = goal_token + torch.where((keep & has_image)[:, None], self.project_goal(encoded.goal), 0.0)
        if self.goal_encoder is not None:
            goal_token = goal_token + torch.where(
                (keep & ~has_image)[:, None], self.goal_encoder(inputs.goal_achieved), 0.0
            )

        observed, goal = self._estimated(inputs, encoded, has_image)
        if self.objects is not None and observed is not None and goal is not None:
            now, then = (observed.detach(), goal.detach()) if config.detach_estimate else (observed, goal)
            step_tokens.append(self.objects(inputs.state, now, then, keep))
        elif self.proprio is not None:
            step_tokens.append(self.proprio(inputs.state).unsqueeze(2))
        return Tokens(
            goal_token.unsqueeze(1), torch.cat(step_tokens, 2), observed, goal, encoded.heatmaps, encoded.goal_heatmaps
        )

    def token_parameters(self) -> Iterable[nn.Parameter]:
        if not (self.config.use_estimated_state and self.config.detach_estimate) or self.project or self.project_goal:
            return self.parameters()
        reads_images = ("front.", "others.", "estimate.")
        return [parameter for name, parameter in self.named_parameters() if not name.startswith(reads_images)]

    def perceive(self, inputs: Inputs, generator: torch.Generator | None = None) -> Tokens:
        has_image = self.config.has_goal_image(inputs, generator)
        encoded = self._encode(inputs, has_image, generator)
        observed, goal = self._estimated(inputs, encoded, has_image)
        none = inputs.state.new_empty(len(has_image), 0, 0)
        return Tokens(none, none.unsqueeze(1), observed, goal, encoded.heatmaps, encoded.goal_heatmaps)

    def run_backbone(self, backbone: nn.Module, images: Tensor) -> tuple[Tensor, Tensor | None]:
        """(B, C, h, w) to features (B, F), and heatmaps (B, K, h', w') of those that make them."""
        return backbone(images), None

    def auxiliary(self, tokens: Tokens, inputs: Inputs) -> dict[str, Tensor]:
        if tokens.observed is None or tokens.wanted is None:
            return {}
        # a small beta: nearly an absolute error, so that errors below a centimeter still count
        loss = nn.functional.smooth_l1_loss(tokens.observed, inputs.achieved, beta=0.1)
        loss = loss + nn.functional.smooth_l1_loss(tokens.wanted, inputs.goal_achieved, beta=0.1)
        return {"achieved": self.config.state_supervision * loss}

    def _estimated(
        self, inputs: Inputs, encoded: "_Features", has_image: Tensor
    ) -> tuple[Tensor | None, Tensor | None]:
        """(B, T, G) and (B, G), normalized estimates of observation and goal; None where there are none."""
        if self.estimate is None:
            return None, None
        observed = self.estimate(encoded.cameras, inputs.state)
        goal = inputs.goal_achieved
        if encoded.goal is not None:
            goal = torch.where(has_image[:, None], self.estimate.wanted(encoded.goal), goal)
        return observed, goal

    def _encode(self, inputs: Inputs, keep: Tensor, generator: torch.Generator | None) -> "_Features":
        """The features of all images; fused early, the last step's are also the goal's.

        keep: (B,) bool, False where the goal image is dropped.
        """
        config, (batch, steps) = self.config, inputs.state.shape[:2]
        heatmaps: dict[str, Tensor] = {}
        goal_heatmaps: dict[str, Tensor] = {}
        stacked = self._goal_camera_frames(inputs, keep, generator)  # (B, T or T + 1, C, h, w)
        encoded, maps = self.run_backbone(self.front, stacked.flatten(0, 1))
        encoded = encoded.unflatten(0, (batch, -1))  # (B, T or T + 1, F)
        goal = encoded[:, -1] if self.fused or config.goal_camera in inputs.goal_images else None
        cameras = {config.goal_camera: encoded[:, :steps]}
        if maps is not None:
            maps = maps.unflatten(0, (batch, -1))
            heatmaps[config.goal_camera] = maps[:, :steps]
            if goal is not None and not self.fused:
                goal_heatmaps[config.goal_camera] = maps[:, -1]
        for camera, backbone in self.others.networks():
            frames = random_shift(inputs.images[camera], config.shift, generator)
            found, maps = self.run_backbone(backbone, pixels(frames.flatten(0, 1)))
            cameras[camera] = found.unflatten(0, (batch, steps))
            if maps is not None:
                heatmaps[camera] = maps.unflatten(0, (batch, steps))
        return _Features(cameras, goal, heatmaps, goal_heatmaps)

    def _goal_camera_frames(self, inputs: Inputs, keep: Tensor, generator: torch.Generator | None) -> Tensor:
        """(B, T, C, h, w) inputs of the backbone of the goal's camera: fused with the goal, or that is one more step.

        A goal that is the observation itself, as a drawn scene's is, is encoded once.
        """
        config, (batch, steps) = self.config, inputs.state.shape[:2]
        frames = inputs.images[config.goal_camera]  # (B, T, h, w, 3)
        if not self.fused and (
            config.goal_camera not in inputs.goal_images or _is_own_goal(inputs, config.goal_camera)
        ):
            frames = random_shift(frames, config.shift, generator)
            return self._rows(pixels(frames.flatten(0, 1)), batch)
        wanted = inputs.goal_images.get(config.goal_camera, torch.zeros_like(frames[:, 0]))  # (B, h, w, 3)
        both = torch.cat([frames, wanted.unsqueeze(1)], dim=1)
        both = random_shift(both, config.shift, generator)
        if not self.fused:
            return self._rows(pixels(both.flatten(0, 1)), batch)
        frames, wanted = both.split([steps, 1], 1)
        stacked = torch.cat([frames, wanted.expand(-1, steps, -1, -1, -1)], dim=-1)  # (B, T, h, w, 6)
        scaled = pixels(stacked.flatten(0, 1))  # (B T, 6, h, w)
        dropped = ~keep.repeat_interleave(steps)
        scaled[:, 3:].masked_fill_(dropped[:, None, None, None], 0.0)  # mid-gray
        return self._rows(scaled, batch)

    @staticmethod
    def _rows(frames: Tensor, batch: int) -> Tensor:
        """(B T, ...) to (B, T, ...)."""
        return frames.view(batch, -1, *frames.shape[1:])


def _is_own_goal(inputs: Inputs, camera: str) -> bool:
    """Whether the goal image is the observation itself, in the same memory."""
    frames, wanted = inputs.images[camera], inputs.goal_images[camera]
    return frames.shape[1] == 1 and frames.data_ptr() == wanted.data_ptr()


class _Features(NamedTuple):
    """What the backbones return.

    cameras: camera -> (B, T, F) features of the observation.
    goal: (B, F) features of the goal image, if there is one.
    heatmaps: see `Tokens`.
    goal_heatmaps: see `Tokens`.
    """

    cameras: dict[str, Tensor]
    goal: Tensor | None
    heatmaps: dict[str, Tensor]
    goal_heatmaps: dict[str, Tensor]


class _Estimate(nn.Module):
    """Estimates of the normalized achieved: from all cameras and the robot's state; of the goal, from its image."""

    def __init__(self, config: ImageConfig, achieved: int, state: int) -> None:
        super().__init__()
        inputs, net = config.features * len(config.cameras) + state, _LinearAndMLP if config.linear_estimate else mlp
        self.observed = net(inputs, config.hidden, achieved)
        self.wanted = net(config.features, config.hidden, achieved)
        # fused late, one backbone encodes both images, so one head may learn from both
        self.shared = config.fusion == "late" or config.goal == "state"
        self.camera = config.goal_camera

    def forward(self, features: dict[str, Tensor], state: Tensor) -> Tensor:
        observed: Tensor = self.observed(torch.cat([*features.values(), state], dim=-1))  # (B, T, G)
        return observed + self.wanted(features[self.camera]) if self.shared else observed


class _LinearAndMLP(nn.Module):
    """A linear map and a small network, summed."""

    def __init__(self, inputs: int, hidden: int, out: int) -> None:
        super().__init__()
        self.linear = nn.Linear(inputs, out)
        self.net = mlp(inputs, hidden, out)

    def forward(self, features: Tensor) -> Tensor:
        out: Tensor = self.linear(features) + self.net(features)
        return out
