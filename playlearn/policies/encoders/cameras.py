"""What image encoders share: cameras, goal modality, pixels, random shifts."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from playlearn.batch import Inputs
from playlearn.errors import UsageError
from playlearn.policies.encoders.base import EncoderConfig, Modality


@dataclass(frozen=True)
class CamerasConfig(EncoderConfig):
    """The fields of every image encoder.

    cameras: whose images an observation holds.
    goal: how a goal is given: an image, the state (`achieved`), or `both`: either, drawn for each training example.
    image_goal_prob: probability that a training example has a goal image, where the goal is `both`.
    goal_camera: the camera of goal images.
    hidden: units of the small networks behind the images.
    shift: random shift of the images in training, in pixels, the same for observation and goal.
    """

    cameras: tuple[str, ...] = ("front", "wrist")
    goal: Literal["image", "state", "both"] = "image"
    image_goal_prob: float = 0.5
    goal_camera: str = "front"
    hidden: int = 256
    shift: int = 0

    @property
    def goals(self) -> tuple[Modality, ...]:
        return ("image", "state") if self.goal == "both" else (self.goal,)

    @property
    def observation_cameras(self) -> tuple[str, ...]:
        return self.cameras

    @property
    def goal_cameras(self) -> tuple[str, ...]:
        return () if self.goal == "state" else (self.goal_camera,)

    def check(self) -> None:
        """Raises UsageError where the fields contradict each other."""
        if self.goal_camera not in self.cameras:
            raise UsageError(f"encoder.goal_camera {self.goal_camera!r} is not among encoder.cameras {self.cameras}")
        if not 0 <= self.image_goal_prob <= 1:
            raise UsageError(f"encoder.image_goal_prob is a probability, 0 to 1: got {self.image_goal_prob}")

    def has_goal_image(self, inputs: Inputs, generator: torch.Generator | None) -> Tensor:
        """(B,) bool, True for the examples whose goal is an image; drawn in training, else by what the inputs hold."""
        batch, device = len(inputs.state), inputs.state.device
        given = self.goal != "state" and self.goal_camera in inputs.goal_images
        if not given or self.goal != "both" or generator is None:
            return torch.full((batch,), given, device=device)
        draws = torch.rand(batch, generator=generator, device=generator.device)
        return (draws < self.image_goal_prob).to(device)


class PerCamera(nn.ModuleDict):
    """Camera -> network, whatever the camera is called: a module's name must have no dot."""

    DOT = "|"

    def __init__(self, networks: Mapping[str, nn.Module]) -> None:
        super().__init__({camera.replace(".", self.DOT): network for camera, network in networks.items()})

    def __getitem__(self, camera: str) -> nn.Module:
        return super().__getitem__(camera.replace(".", self.DOT))

    def networks(self) -> list[tuple[str, nn.Module]]:
        """(camera, network), in order."""
        return [(name.replace(self.DOT, "."), network) for name, network in self.items()]


def pixels(frames: Tensor) -> Tensor:
    """(B, h, w, C) uint8 -> (B, C, h, w) float32 in [-1, 1], channels last in memory, which CPUs convolve fastest."""
    return frames.float().mul_(2 / 255).sub_(1).permute(0, 3, 1, 2)


def channels_last[M: nn.Module](network: M) -> M:
    """The same network with its convolutions in the memory format of `pixels`."""
    return network.to(memory_format=torch.channels_last)  # type: ignore[no-any-return, call-overload]


def random_shift(frames: Tensor, limit: int, generator: torch.Generator | None) -> Tensor:
    """Shift each example's (T, h, w, C) frames by up to `limit` pixels, edges repeated (DrQ, Yarats et al. 2021).

    Without a generator, or by 0, they stay where they are.
    """
    return shift_frames(frames, shift_offsets(len(frames), limit, generator))


def shift_offsets(batch: int, limit: int, generator: torch.Generator | None) -> Tensor | None:
    """(2, B, 1) int64: rows and columns of up to `limit` by which to shift; None without a generator, or by 0."""
    if generator is None or limit == 0:
        return None
    return torch.randint(-limit, limit + 1, (2, batch, 1), generator=generator, device=generator.device)


def shift_frames(frames: Tensor, offsets: Tensor | None) -> Tensor:
    """(B, T, h, w, C), of which pixel (row, column) is what was at (row, column) + offsets; None leaves them."""
    if offsets is None:
        return frames
    batch, steps, height, width, channels = frames.shape
    offsets = offsets.to(frames.device)
    rows = (torch.arange(height, device=frames.device) + offsets[0]).clamp_(0, height - 1)  # (B, h)
    columns = (torch.arange(width, device=frames.device) + offsets[1]).clamp_(0, width - 1)  # (B, w)
    pixel_index = (rows[:, :, None] * width + columns[:, None, :]).flatten(1)  # (B, h w)
    frame = torch.arange(batch * steps, device=frames.device).view(batch, steps, 1) * (height * width)
    # pixels picked by one flat index: three times as fast on a CPU as indexing rows and columns
    moved = frames.reshape(-1, channels).index_select(0, (frame + pixel_index[:, None]).flatten())
    return moved.view(frames.shape)
