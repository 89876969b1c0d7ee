"""An image encoder that the hand teaches: it tells where the hand goes next, and needs no simulator's truth.

Nobody names object poses in a robot's recording, but its own future says where the objects were: where the gripper next
closes, and where the hand is once the world has settled (see `relabeling.hand`). So the encoder estimates the robot's
state at these events from the observation, the goal image and their difference, and the policy reads the estimates and
how far they are from the present state, as the state encoder reads objects and their goals.

What is grasped, and where it goes, shows where observation and goal differ, wherever in the image that is. So every
cell of a fully convolutional network says how likely an event is seen there, and which state of the robot that would
be: a smooth function of the cell's position, learned with the rest, and an offset read from the pixels around it. Which
cell is right is known once it is known where the camera shows the hand; that is read off the play (`data.projection`),
so no camera needs to be calibrated. Shifted images are matched by shifted cells, so one grasp teaches those elsewhere.
A closer look at the likeliest cells then gives the states.

The policy reads the estimates in training as in acting: true events displaced by noise as wide as the estimates are off
made a worse one, since most of that is not error but what nobody can tell, where along its length a block is taken. So
the estimator is trained first, and the policy from that run.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from playlearn.batch import EVENTS, Inputs
from playlearn.errors import UsageError
from playlearn.policies.encoders.base import Encoder, EncoderConfig, Proposals, Tokens
from playlearn.policies.encoders.cameras import (
    CamerasConfig,
    PerCamera,
    channels_last,
    pixels,
    random_shift,
    shift_frames,
    shift_offsets,
)
from playlearn.policies.encoders.cnn import CNNConfig
from playlearn.policies.encoders.keypoints import Glimpses, heatmap_loss
from playlearn.policies.encoders.objects import NEAR, mlp
from playlearn.policies.spec import Named, PolicySpec


@EncoderConfig.register_subclass("hand")
@dataclass(frozen=True)
class HandConfig(CamerasConfig):
    """Event tokens from images, and the features of further cameras.

    channels: of the estimator's finest map; a quarter of the image's size.
    feed_cameras: the cameras whose features the policy reads, for the last centimeters (null: all but the goal's).
    features: width of such a camera's feature vector.
    """

    channels: int = 32
    feed_cameras: tuple[str, ...] | None = None
    features: int = 128

    @property
    def fed_cameras(self) -> tuple[str, ...]:
        """The cameras whose features the policy reads."""
        if self.feed_cameras is not None:
            return self.feed_cameras
        return tuple(camera for camera in self.cameras if camera != self.goal_camera)

    @property
    def uses_events(self) -> bool:
        return True

    @property
    def needs_achieved(self) -> bool:
        return False

    def check_goal(self, spec: Named, where: str = "this play") -> None:
        if self.goal != "image":
            raise UsageError(f"encoder.goal is {self.goal!r}: an encoder of type hand reads goal images only")

    def build(self, spec: PolicySpec, width: int, *, fetch: bool = True) -> "HandEncoder":
        self.check()
        unknown = set(self.fed_cameras) - set(self.cameras)
        if unknown:
            raise UsageError(f"encoder.feed_cameras: {min(unknown)!r} is not among encoder.cameras {self.cameras}")
        return HandEncoder(self, spec, width)


class HandEncoder(Encoder):
    """A goal token, for whether there is a goal; then one token an event, one a fed camera, one for the robot."""

    goal_tokens = 1

    def __init__(self, config: HandConfig, spec: PolicySpec, width: int) -> None:
        super().__init__()
        self.config, state = config, len(spec.state_names)
        size = spec.cameras[config.goal_camera]
        moving = hand_dimensions(spec)
        self.estimate = EventEstimator(state, moving, config.channels, size)
        self.events = nn.ModuleDict({name: mlp(3 * state + 1, config.hidden, width) for name in EVENTS})
        self.robot = mlp(state, config.hidden, width)
        features = CNNConfig(features=config.features)
        self.fed = PerCamera(
            {
                camera: nn.Sequential(
                    features.backbone(3, spec.cameras[camera], fetch=False), nn.Linear(config.features, width)
                )
                for camera in config.fed_cameras
            }
        )
        self.goal_flag = nn.Parameter(torch.randn(2, width) * 0.02)  # without, with a goal
        self.step_tokens = len(EVENTS) + len(config.fed_cameras) + 1

    def forward(self, inputs: Inputs, keep: Tensor, generator: torch.Generator | None = None) -> Tokens:
        state, config = inputs.state, self.config  # (B, T, S)
        proposals = self._proposals(inputs, generator)
        made: list[Tensor] = []
        for name, pose in self.estimate.most_likely(proposals).items():  # (B, S)
            pose = pose.detach()
            ahead = ~pose.isnan().any(-1) & keep  # (B,)
            there = ahead[:, None, None].to(state.dtype)
            seen = (pose.nan_to_num().unsqueeze(1) * there).expand_as(state)
            left = seen - state * there
            given = there.expand(*state.shape[:2], 1)
            made.append(self.events[name](torch.cat([seen, left, torch.tanh(NEAR * left), given], -1)).unsqueeze(2))
        for camera, net in self.fed.networks():
            frames = random_shift(inputs.images[camera], config.shift, generator)
            made.append(net(pixels(frames.flatten(0, 1))).unflatten(0, state.shape[:2]).unsqueeze(2))
        made.append(self.robot(state).unsqueeze(2))
        return Tokens(self.goal_flag[keep.long()].unsqueeze(1), torch.cat(made, 2), proposals=proposals)

    def token_parameters(self) -> Iterable[nn.Parameter]:
        return [parameter for name, parameter in self.named_parameters() if not name.startswith("estimate.")]

    def calibrate(self, project: Callable[[str, Sequence[int]], Tensor]) -> None:
        found = project(self.config.goal_camera, self.estimate.moving)
        self.estimate.get_buffer("projection").copy_(found)

    def perceive(self, inputs: Inputs, generator: torch.Generator | None = None) -> Tokens:
        none = inputs.state.new_empty(len(inputs.state), 0, 0)
        return Tokens(none, none.unsqueeze(1), proposals=self._proposals(inputs, generator))

    def auxiliary(self, tokens: Tokens, inputs: Inputs) -> dict[str, Tensor]:
        if tokens.proposals is None or not inputs.events:
            return {}
        return self.estimate.loss(tokens.proposals, inputs.events)

    def events_ahead(self, inputs: Inputs) -> Mapping[str, Tensor]:
        """Event -> (B, S) the state that is estimated, NaN where it does not lie ahead; all normalized."""
        return self.estimate.most_likely(self._proposals(inputs, None))

    def seen(self, state: Tensor) -> Tensor:
        """(B, S) normalized to (B, 2), x and y in [-1, 1]: where the goal's camera shows the hand in such a state."""
        return self.estimate.project(state)

    def _proposals(self, inputs: Inputs, generator: torch.Generator | None) -> Proposals:
        camera = self.config.goal_camera
        both = torch.stack([inputs.images[camera][:, -1], inputs.goal_images[camera]], dim=1)  # (B, 2, h, w, 3)
        offsets = shift_offsets(len(both), self.config.shift, generator)
        frames = shift_frames(both, offsets)
        proposals: Proposals = self.estimate(frames[:, 0], frames[:, 1], inputs.state[:, -1], offsets)
        return proposals


class EventEstimator(nn.Module):
    """Observation and goal (B, h, w, 3) uint8 and the robot's state (B, S) to `Proposals`.

    projection: (Q, 2) where the image shows the hand, a quadratic function of its state (see `hand_terms`); fitted to
        the play before training (see `data.projection`).
    """

    STRIDE, COARSEST, GLIMPSE = 4, 16, 16  # pixels of a cell of the finest and of the coarsest map, and of a glimpse
    ANSWERS = 4  # a block may be taken either way round
    NEAR = 0.25  # of half the image: a glimpse this far off teaches nothing

    def __init__(self, state: int, moving: list[int], channels: int, size: tuple[int, int]) -> None:
        super().__init__()
        self.state, self.moving = state, moving
        self.size = tuple(-(-side // self.COARSEST) * self.COARSEST for side in size)  # padded to whole cells
        self.shape = tuple(side // self.STRIDE for side in self.size)
        whole = [side / own for side, own in zip(reversed(size), reversed(self.size), strict=True)]
        self.register_buffer("whole", torch.tensor(whole), persistent=False)  # (2,) the image's share of that, x and y
        events = len(EVENTS)
        self.register_buffer("projection", torch.zeros(hand_terms(torch.zeros(1, len(moving))).shape[1], 2))
        y, x = torch.meshgrid(*(_centers(count) for count in self.shape), indexing="ij")
        self.register_buffer("cells", torch.stack([x.flatten(), y.flatten()], -1), persistent=False)  # (N, 2)
        self.reaches = nn.Linear(5, events * state)  # the state that reaches a cell, quadratic in its position
        self.stem = nn.Conv2d(6, channels, 2 * self.STRIDE, self.STRIDE, self.STRIDE // 2)
        self.away = nn.Conv2d(4, channels, 1)
        self.condition = nn.Linear(state, 2 * channels)
        self.fine, self.fused = (nn.Conv2d(channels, channels, 3, padding=1) for _ in range(2))
        self.to_middle = nn.Conv2d(channels, 2 * channels, 2, 2)
        self.middle = _Residual(2 * channels)
        self.to_coarse = nn.Conv2d(2 * channels, 2 * channels, 2, 2)
        self.coarse = _Residual(2 * channels)
        self.from_coarse = nn.Conv2d(2 * channels, 2 * channels, 1)
        self.from_middle = nn.Conv2d(2 * channels, channels, 1)
        self.propose = nn.Conv2d(channels, events * (1 + state), 1)
        self.ahead = mlp(4 * channels + state, 64, events)
        self.glimpses = Glimpses(self.GLIMPSE, events, 64, 6, (self.size[0], self.size[1]))
        self.answer = mlp(events * self.glimpses.features + state, 256, events * self.ANSWERS * (1 + state))
        self.log_scale = nn.Parameter(torch.zeros(events, 1, state))
        channels_last(self)

    def forward(self, frames: Tensor, goal: Tensor, state: Tensor, offsets: Tensor | None) -> Proposals:
        """offsets: (2, B, 1) rows and columns by which the images were shifted; None for none."""
        images = self._padded(torch.cat([pixels(frames), pixels(goal)], 1))
        maps = self.stem(images)  # (B, C, h', w')
        shift = self._shift(offsets, state)
        away = self.get_buffer("cells") - (self._in_cells(state) - shift).unsqueeze(1)  # (B, N, 2) from the hand
        away = away.movedim(-1, 1).unflatten(-1, self.shape)
        scale, bias = self.condition(state)[:, :, None, None].chunk(2, 1)
        maps = maps + self.away(torch.cat([away.tanh(), (NEAR * away).tanh()], 1))
        maps = (maps * (1 + scale) + bias).relu()
        maps = (maps + self.fine(maps)).relu()
        middle = self.middle(self.to_middle(maps).relu())
        coarse = self.coarse(self.to_coarse(middle).relu())
        middle = (middle + _doubled(self.from_coarse(coarse))).relu()
        maps = (maps + self.fused((maps + _doubled(self.from_middle(middle))).relu())).relu()
        found = self.propose(maps).flatten(2).unflatten(1, (len(EVENTS), -1))  # (B, E, 1 + S, N)
        reached = self._reached(self.get_buffer("cells") + shift.unsqueeze(1))
        pooled = torch.cat([coarse.mean((2, 3)), coarse.amax((2, 3)), state], 1)
        logits, states = found[:, :, 0], reached + found[:, :, 1:].movedim(2, -1)
        peak = logits.argmax(-1)  # (B, E)
        seen = self.glimpses(images, self.get_buffer("cells")[peak])  # (B, E, F)
        answers = self.answer(torch.cat([seen.flatten(1), state], -1)).view(len(state), len(EVENTS), self.ANSWERS, -1)
        refined = _at(states, peak).detach().unsqueeze(2) + answers[..., 1:]
        return Proposals(logits, states, self.ahead(pooled), shift, answers[..., 0], refined)

    def loss(self, found: Proposals, events: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Of the cells at which the true events (B, S) are seen, and of the states that these propose.

        events: NaN where they do not lie ahead.
        """
        target = torch.stack([events[name] for name in EVENTS], 1)  # (B, E, S)
        there = ~target.isnan().any(-1)  # (B, E)
        target = target.nan_to_num()
        seen = self._in_cells(target) - found.shift.unsqueeze(1)  # (B, E, 2)
        inside = there & (seen.abs() <= 1).all(-1)
        points = seen.masked_fill(~inside.unsqueeze(-1), torch.nan)
        where = heatmap_loss(found.logits.unflatten(-1, self.shape), points)
        away = (self.get_buffer("cells") - seen.unsqueeze(2)).square().sum(-1)  # (B, E, N)
        error = _error(_at(found.states, away.argmin(-1)), target)
        near = inside & (_at(away.unsqueeze(-1), found.logits.argmax(-1))[..., 0] < self.NEAR**2)
        scale = self.log_scale.clamp(min=-4)  # of a Laplace density
        apart = ((found.refined - target.unsqueeze(2)).abs() / scale.exp() + scale).sum(-1)  # (B, E, K)
        refined = -(found.answers.log_softmax(-1) - apart).logsumexp(-1) / self.state
        ahead = nn.functional.binary_cross_entropy_with_logits(found.ahead, there.to(target.dtype))
        count = inside.sum().clamp(min=1)
        return {
            "where": where,
            "state": 10 * (error * inside).sum() / count,
            "refined": (refined * near).sum() / near.sum().clamp(min=1),
            "ahead": ahead,
        }

    def most_likely(self, found: Proposals) -> dict[str, Tensor]:
        """Event -> (B, S), the likeliest answer at the most confident cell; NaN where the event does not lie ahead."""
        states = _at(found.refined, found.answers.argmax(-1))
        states = states.masked_fill((found.ahead < 0)[..., None], torch.nan)  # (B, E, S)
        return dict(zip(EVENTS, states.unbind(1), strict=True))

    def project(self, state: Tensor) -> Tensor:
        """(..., S) normalized to (..., 2), x and y in [-1, 1]: where the image shows the hand."""
        seen: Tensor = hand_terms(state[..., self.moving]) @ self.get_buffer("projection")
        return seen

    def _padded(self, images: Tensor) -> Tensor:
        """(B, C, h, w) with edges repeated at the right and the bottom, up to whole cells."""
        missing = [own - side for own, side in zip(self.size, images.shape[2:], strict=True)]
        if not any(missing):
            return images
        return nn.functional.pad(images, (0, missing[1], 0, missing[0]), mode="replicate")

    def _in_cells(self, state: Tensor) -> Tensor:
        """The same, in [-1, 1] of the padded image."""
        seen = self.project(state)
        return seen + (seen + 1) * (self.get_buffer("whole") - 1)  # to the bit what is seen, where nothing is padded

    def _shift(self, offsets: Tensor | None, like: Tensor) -> Tensor:
        """(B, 2), x and y in [-1, 1], by which the images were shifted."""
        if offsets is None:
            return like.new_zeros(len(like), 2)
        height, width = self.size
        return torch.cat([2 * offsets[1] / width, 2 * offsets[0] / height], -1).to(like)

    def _reached(self, at: Tensor) -> Tensor:
        """(B, N, 2) to (B, E, N, S)."""
        x, y = at.unbind(-1)
        reached = self.reaches(torch.stack([x, y, x * x, x * y, y * y], -1))  # (B, N, E S)
        by_event: Tensor = reached.unflatten(-1, (len(EVENTS), -1)).movedim(-2, 1)
        return by_event


def _at(values: Tensor, cell: Tensor) -> Tensor:
    """(B, E, N, D) and (B, E) to (B, E, D)."""
    found: Tensor = values.gather(2, cell[..., None, None].expand(-1, -1, 1, values.shape[-1]))[:, :, 0]
    return found


def _error(states: Tensor, target: Tensor) -> Tensor:
    error: Tensor = nn.functional.smooth_l1_loss(states, target, beta=0.1, reduction="none").mean(-1)
    return error


def hand_terms(state: Tensor) -> Tensor:
    """(..., M) to (..., Q): 1, the numbers and their products, of which where the hand is seen is a linear function."""
    first, second = torch.triu_indices(state.shape[-1], state.shape[-1])
    return torch.cat([torch.ones_like(state[..., :1]), state, state[..., first] * state[..., second]], -1)


def hand_dimensions(spec: PolicySpec) -> list[int]:
    """The numbers of the robot's state that decide where its hand is: its position where declared, else all."""
    declared = spec.quantities.of("state", len(spec.state_names))
    position = [k for k, text in enumerate(declared) if text in ("length x", "length y", "length z")]
    return position if len(position) == 3 else list(range(len(declared)))


class _Residual(nn.Module):
    """Two convolutions around which the maps also pass."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first, self.second = (nn.Conv2d(channels, channels, 3, padding=1) for _ in range(2))

    def forward(self, maps: Tensor) -> Tensor:
        out: Tensor = (maps + self.second(self.first(maps).relu())).relu()
        return out


def _doubled(maps: Tensor) -> Tensor:
    return nn.functional.interpolate(maps, scale_factor=2)


def _centers(count: int) -> Tensor:
    return (2 * torch.arange(count) + 1) / count - 1
