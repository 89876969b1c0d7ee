"""What image encoders share: fusion of observation and goal, extra cameras, privileged supervision, random shifts."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

import torch
from torch import Tensor, nn

from playlearn.errors import UsageError
from playlearn.policies.encoders.base import Encoder, EncoderConfig, Modality, Tokens
from playlearn.policies.encoders.objects import ObjectTokens, mlp
from playlearn.policies.inputs import Observed, PolicySpec


@dataclass(frozen=True)
class AuxiliaryConfig:
    """Privileged supervision: in training only, images must also tell `achieved`. Its loss's weight, 0 for none."""

    achieved: float = 0.0


@dataclass(frozen=True)
class ImageConfig(EncoderConfig):
    """The fields that every image encoder has.

    cameras: what the policy sees. goal_camera: one of them, in which goals are shown.
    fusion: `early` stacks observation and goal along the channels; `late` runs one network over each.
    features: width of a camera's feature vector. hidden: units of the small networks behind it.
    auxiliary: see AuxiliaryConfig. feed_estimate: hand the estimated achieved of observation and goal and
    their difference to the policy, as the state encoder does with the true ones. feed_cameras: the cameras
    whose features the policy sees beside them (null: all). detach_estimate: the
    policy's own loss does not shape the estimates. shift: random shift of the images in training, in
    pixels, the same for observation and goal.
    """

    goal: ClassVar[Modality] = "image"
    cameras: tuple[str, ...] = ("front", "wrist")
    goal_camera: str = "front"
    fusion: Literal["early", "late"] = "early"
    features: int = 256
    hidden: int = 256
    auxiliary: AuxiliaryConfig = field(default_factory=AuxiliaryConfig)
    feed_estimate: bool = False
    feed_cameras: tuple[str, ...] | None = None
    detach_estimate: bool = True
    shift: int = 0

    @property
    def observation_cameras(self) -> tuple[str, ...]:
        return self.cameras

    @property
    def goal_cameras(self) -> tuple[str, ...]:
        return (self.goal_camera,)

    def backbone(self, channels: int, size: tuple[int, int], *, fetch: bool) -> nn.Module:
        """(B, channels, h, w) in [-1, 1] -> (B, features)."""
        raise NotImplementedError

    def build(self, spec: PolicySpec, width: int, *, fetch: bool = True) -> "ImageEncoder":
        if self.goal_camera not in self.cameras:
            raise UsageError(f"encoder.goal_camera {self.goal_camera!r} is not among encoder.cameras {self.cameras}")
        if self.feed_estimate and self.auxiliary.achieved <= 0:
            raise UsageError("encoder.feed_estimate needs encoder.auxiliary.achieved above 0: nothing else trains it")
        unknown = set(self.feed_cameras or ()) - set(self.cameras)
        if unknown:
            raise UsageError(f"encoder.feed_cameras: {min(unknown)!r} is not among encoder.cameras {self.cameras}")
        if self.feed_cameras is not None and self.goal_camera not in self.feed_cameras and not self.feed_estimate:
            raise UsageError(
                "encoder.feed_cameras without the goal's camera needs encoder.feed_estimate: no goal is seen"
            )
        return ImageEncoder(self, spec, width, fetch=fetch)


class ImageEncoder(Encoder):
    """A goal token, then for each step one token a camera and one for the robot's own state.

    With `feed_estimate` there is also a token an object, made from the estimated achieved of observation
    and goal. The true `achieved` is never read outside `auxiliary`.
    """

    def __init__(self, config: ImageConfig, spec: PolicySpec, width: int, *, fetch: bool) -> None:
        super().__init__()
        self.config = config
        early = config.fusion == "early"
        size = spec.cameras[config.goal_camera]
        others = [camera for camera in config.cameras if camera != config.goal_camera]
        self.front = config.backbone(6 if early else 3, size, fetch=fetch)
        self.others = nn.ModuleDict(
            {camera: config.backbone(3, spec.cameras[camera], fetch=fetch) for camera in others}
        )
        features, state = config.features, len(spec.state_names)
        fed = config.cameras if config.feed_cameras is None else config.feed_cameras
        self.project = nn.ModuleDict({camera: nn.Linear(features, width) for camera in fed})
        goal_fed = config.goal_camera in fed and not early
        self.project_goal = nn.Linear(features, width) if goal_fed else None
        self.goal_flag = nn.Parameter(torch.randn(2, width) * 0.02)  # without, with a goal
        self.goal_tokens, self.step_tokens = 1, len(fed) + 1

        self.estimate = _Estimate(config, len(spec.achieved_names), state) if config.auxiliary.achieved > 0 else None
        self.objects: ObjectTokens | None = None
        self.proprio: nn.Module | None = None
        if config.feed_estimate:
            self.objects = ObjectTokens(spec, config.goal_names, config.hidden, width)
            self.step_tokens += self.objects.count - 1
        else:
            self.proprio = mlp(state, config.hidden, width)

    def forward(self, inputs: Observed, keep: Tensor, generator: torch.Generator | None = None) -> Tokens:
        config, (batch, steps) = self.config, inputs.state.shape[:2]
        shown = inputs.images[config.goal_camera]  # (B, T, h, w, 3)
        wanted = inputs.goal_images[config.goal_camera]  # (B, h, w, 3)
        shown, wanted = self._shift(torch.cat([shown, wanted.unsqueeze(1)], dim=1), generator).split([steps, 1], 1)

        seen, goal_seen = self._see(shown, wanted, keep)  # (B, T, F), (B, F) or (B, T, F)
        features = {config.goal_camera: seen}
        for camera, backbone in self.others.items():
            frames = self._shift(inputs.images[camera], generator)
            features[camera] = backbone(pixels(frames.flatten(0, 1))).unflatten(0, (batch, steps))
        step_tokens = [project(features[camera]).unsqueeze(2) for camera, project in self.project.items()]

        goal_token = self.goal_flag[keep.long()]  # (B, D)
        if self.project_goal is not None:
            goal_token = goal_token + torch.where(keep[:, None], self.project_goal(goal_seen), 0.0)

        observed = goal = None
        if self.estimate is not None:
            observed, goal = self.estimate(features, goal_seen, inputs.state)
        if self.objects is not None and observed is not None and goal is not None:
            now, then = (observed.detach(), goal.detach()) if config.detach_estimate else (observed, goal)
            step_tokens.append(self.objects(inputs.state, now, then, keep))
        elif self.proprio is not None:
            step_tokens.append(self.proprio(inputs.state).unsqueeze(2))
        return Tokens(goal_token.unsqueeze(1), torch.cat(step_tokens, 2), observed, goal)

    def auxiliary(self, tokens: Tokens, inputs: Observed) -> dict[str, Tensor]:
        if tokens.observed is None or tokens.wanted is None:
            return {}
        # a small beta: nearly an absolute error, so that the last centimetre still counts
        loss = nn.functional.smooth_l1_loss(tokens.observed, inputs.achieved, beta=0.1)
        loss = loss + nn.functional.smooth_l1_loss(tokens.wanted, inputs.goal_achieved, beta=0.1)
        return {"achieved": self.config.auxiliary.achieved * loss}

    def _see(self, shown: Tensor, wanted: Tensor, keep: Tensor) -> tuple[Tensor, Tensor]:
        """Features (B, T, F) of the observation, (B, F) of the goal; fused early, the last step's tell both."""
        batch, steps = shown.shape[:2]
        if self.config.fusion == "early":
            stacked = torch.cat([shown, wanted.expand(-1, steps, -1, -1, -1)], dim=-1)  # (B, T, h, w, 6)
            scaled = pixels(stacked.flatten(0, 1))  # (B T, 6, h, w)
            withheld = ~keep.repeat_interleave(steps)
            scaled[:, 3:].masked_fill_(withheld[:, None, None, None], 0.0)  # mid-grey
            seen: Tensor = self.front(scaled).unflatten(0, (batch, steps))
            return seen, seen[:, -1]
        both = self.front(pixels(torch.cat([shown, wanted], dim=1).flatten(0, 1))).unflatten(0, (batch, steps + 1))
        return both[:, :-1], both[:, -1]

    def _shift(self, frames: Tensor, generator: torch.Generator | None) -> Tensor:
        if generator is None or self.config.shift == 0:
            return frames
        return random_shift(frames, self.config.shift, generator)


class _Estimate(nn.Module):
    """Normalised achieved of the observation from all cameras and the state, of the goal from its image alone."""

    def __init__(self, config: ImageConfig, achieved: int, state: int) -> None:
        super().__init__()
        seen = config.features * len(config.cameras) + state
        self.observed = mlp(seen, config.hidden, achieved)
        self.wanted = mlp(config.features, config.hidden, achieved)
        # fused late, one network looks at both images, so one head may learn from both
        self.shared = config.fusion == "late"
        self.camera = config.goal_camera

    def forward(self, features: dict[str, Tensor], goal_seen: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        observed = self.observed(torch.cat([*features.values(), state], dim=-1))  # (B, T, G)
        if self.shared:
            observed = observed + self.wanted(features[self.camera])
        return observed, self.wanted(goal_seen)


def pixels(frames: Tensor) -> Tensor:
    """(B, h, w, C) uint8 -> (B, C, h, w) float32 in [-1, 1], laid out channels last, which CPUs convolve fastest."""
    return frames.float().mul_(2 / 255).sub_(1).permute(0, 3, 1, 2)


def channels_last[M: nn.Module](network: M) -> M:
    """The same network with its convolutions laid out as `pixels` lays out images."""
    return network.to(memory_format=torch.channels_last)  # type: ignore[no-any-return, call-overload]


def random_shift(frames: Tensor, limit: int, generator: torch.Generator) -> Tensor:
    """Shift each example's (T, h, w, C) frames by up to `limit` pixels, edges repeated (DrQ, Yarats et al. 2021)."""
    batch, steps, height, width, channels = frames.shape
    offsets = torch.randint(-limit, limit + 1, (2, batch, 1), generator=generator, device=generator.device)
    offsets = offsets.to(frames.device)
    rows = (torch.arange(height, device=frames.device) + offsets[0]).clamp_(0, height - 1)  # (B, h)
    columns = (torch.arange(width, device=frames.device) + offsets[1]).clamp_(0, width - 1)  # (B, w)
    places = (rows[:, :, None] * width + columns[:, None, :]).flatten(1)  # (B, h w)
    frame = torch.arange(batch * steps, device=frames.device).view(batch, steps, 1) * (height * width)
    # pixels picked by one flat index: three times as quick on a CPU as indexing rows and columns
    moved = frames.reshape(-1, channels).index_select(0, (frame + places[:, None]).flatten())
    return moved.view(frames.shape)
