"""Where an image shows the hand: read off the play, in which the scene changes where the hand acts.

Between a moment before a grasp and one after the scene has settled, images differ where the object was, where it is,
and where the arm is seen. The arm is now here and now there, so over many grasps one smooth function of the robot's
state fits: the one that puts grasp and settled moment where images differ. It takes seconds, no markers, and no
knowledge of camera or robot.
"""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from playlearn.data.dataset import PlayDataset
from playlearn.episode import IMAGES, Array
from playlearn.errors import StoreError
from playlearn.policies.encoders.hand import hand_terms
from playlearn.policies.normalize import Normalizer

CELL = 4  # pixels of a cell of the difference images
BLURS = (2.5, 1.8, 1.2, 0.8)  # cells, from coarse to fine
STARTS, REFINED, UPDATES = 3000, 4, 100  # random functions to try, how many of them are refined, updates for each blur
FEWEST = 30  # grasps
LEAST = 0.3  # of the mean difference, counted everywhere: what was hidden, or moved little, must not decide


def hand_projection(dataset: PlayDataset, normalizer: Normalizer, camera: str, moving: Sequence[int]) -> Tensor:
    """(Q, 2) the weights of `hand_terms` of the normalized state that give x and y in the image, each in [-1, 1].

    moving: the numbers of the state that decide.

    Raises:
        StoreError: the play has too few grasps that a settled moment follows.
    """
    pairs = [pair for e in range(len(dataset.episodes)) for pair in _pairs(dataset, camera, e)]
    if len(pairs) < FEWEST:
        raise StoreError(
            f"{dataset.store.name()}: {len(pairs)} grasps with a settled moment after them; where the {camera} camera "
            f"shows the hand is read from {FEWEST} or more: record more play, see that `data.settling.robot` names the "
            "gripper, or take an encoder of another type (cnn)"
        )
    differences = torch.from_numpy(np.stack([difference for difference, _ in pairs]))  # (n, h', w')
    states = normalizer.normalize("state", torch.from_numpy(np.stack([state for _, state in pairs])))  # (n, 2, S)
    terms = hand_terms(states[..., list(moving)])  # (n, 2, Q)
    differences = differences / (differences.mean(0) + 2)
    differences = differences / differences.mean((1, 2), keepdim=True).clamp(min=1e-6)
    blurred = [_blurred(differences, width) for width in BLURS]
    generator = torch.Generator().manual_seed(0)
    starts = []
    for _ in range(STARTS):
        weights = torch.zeros(terms.shape[-1], 2)
        weights[0] = torch.rand(2, generator=generator) * 1.2 - 0.6
        weights[1 : 1 + len(moving)] = torch.randn(len(moving), 2, generator=generator) * 0.6 / len(moving) ** 0.5
        starts.append((float(_agreement(weights, terms, blurred[0])), weights))
    starts.sort(key=lambda start: -start[0])
    refined = [_refined(weights, terms, blurred, 1 + len(moving)) for _, weights in starts[:REFINED]]
    return max(refined, key=lambda one: one[0])[1]


def _pairs(dataset: PlayDataset, camera: str, episode: int) -> list[tuple[Array, Array]]:
    """For each grasp that a settled moment follows, how images before and after differ (h', w'), and both states."""
    found = []
    state = dataset.store.array(int(dataset.episodes[episode]), "observation.state")
    frames = dataset.store.array(int(dataset.episodes[episode]), IMAGES + camera)
    before = 0
    for moment, end, grasp in dataset.segments(episode):
        if grasp > before and end > moment:
            ends = state[[grasp, moment]]
            seen = [span[_far(state[span], ends)] for span in (np.arange(before, grasp), np.arange(moment, end + 1))]
            found.append((_difference(frames[seen[0]], frames[seen[1]]), ends))
        before = moment
    return found


def _far(states: Array, ends: Array) -> int:
    """Which of the states (n, S) is farthest from both ends (2, S), so that the arm hides neither."""
    scale = np.maximum(np.abs(states - states.mean(0)).max(0), 1e-6)
    return int((np.abs(states[:, None] - ends) / scale).sum(-1).min(1).argmax())


def _difference(one: Array, other: Array) -> NDArray[np.float32]:
    """(h, w, 3) each to (h', w'), the mean absolute difference in each cell."""
    apart = np.abs(one.astype(np.float32) - other).mean(-1)
    height, width = (side // CELL * CELL for side in apart.shape)
    cells = apart[:height, :width].reshape(height // CELL, CELL, width // CELL, CELL).mean((1, 3))
    return np.asarray(cells, np.float32)


def _blurred(maps: Tensor, width: float) -> Tensor:
    """(n, 1, h', w') under a Gaussian of so many cells."""
    at = torch.arange(-6, 7, dtype=maps.dtype)
    kernel = torch.exp(-(at**2) / (2 * width**2))
    kernel = kernel / kernel.sum()
    rows = torch.nn.functional.conv2d(maps.unsqueeze(1), kernel.view(1, 1, 1, -1), padding=(0, 6))
    return torch.nn.functional.conv2d(rows, kernel.view(1, 1, -1, 1), padding=(6, 0))


def _agreement(weights: Tensor, terms: Tensor, blurred: Tensor) -> Tensor:
    """The mean logarithm of how much images differ where these weights see the hand."""
    found = torch.nn.functional.grid_sample(blurred, (terms @ weights).unsqueeze(2), align_corners=False)
    return (LEAST + found).log().mean()


def _refined(weights: Tensor, terms: Tensor, blurred: Sequence[Tensor], linear: int) -> tuple[float, Tensor]:
    """The weights after some updates, and how well they agree. linear: how many are not of products."""
    weights = weights.clone().requires_grad_()
    optimizer = torch.optim.Adam([weights], lr=0.02)
    for maps in blurred:
        for _ in range(UPDATES):
            loss = 1e-2 * weights[linear:].square().sum() - _agreement(weights, terms, maps)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    return -float(loss.detach()), weights.detach()
