"""A tightrope of cues: the toy environment of two experiments.

At every step the rope turns by -1, 0 or 1, which a cue shows. A walker that turns otherwise is off by the difference,
and stays off until it turns back. The expert follows the rope, and steps back to it from beside it. An observation is
the cue with noise (CUE numbers) and how far the walker is off (2 numbers, 0 on the rope).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from playlearn.episode import Array

CUE, NOISE, FURTHEST = 12, 0.7, 3  # so much noise that some cues in a thousand are misread

Policy = Callable[[Array], Array]
"""(N, CUE + 2) observations -> (N,) turns in -1, 0, 1."""


@dataclass(frozen=True, eq=False)
class Walk:
    """N walks of T steps.

    observed: (N, T, CUE + 2).
    turn: (N, T), executed.
    label: (N, T), the expert's turn.
    """

    observed: Array
    turn: Array
    label: Array

    @property
    def mistakes(self) -> float:
        """Per walk, on average."""
        return float((self.turn != self.label).sum(axis=1).mean())


def walk(policy: Policy | None, walks: int, steps: int, rng: np.random.Generator, stumble: float = 0.0) -> Walk:
    """Walks of a policy (None: of the expert); stumble: fraction of the executed turns that are random."""
    signs = np.random.default_rng(0).standard_normal((3, CUE))  # the three cues, always the same
    off: Array = np.zeros(walks, int)
    rows: list[tuple[Array, Array, Array]] = []
    for _ in range(steps):
        rope = rng.integers(-1, 2, walks)
        observed = observe(signs[rope + 1] + NOISE * rng.standard_normal((walks, CUE)), off)
        label = turn_back(rope, off)
        turn = label if policy is None else policy(observed)
        if stumble:
            turn = np.where(rng.random(walks) < stumble, rng.integers(-1, 2, walks), turn)
        rows.append((observed, turn, label))
        off = np.clip(off + turn - rope, -FURTHEST, FURTHEST)
    return Walk(*(np.stack(column, axis=1) for column in zip(*rows, strict=True)))


def observe(cue: Array, off: Array) -> Array:
    """(N, CUE + 2)."""
    observed: Array = np.concatenate([cue, np.maximum(off, 0)[:, None], np.maximum(-off, 0)[:, None]], axis=1)
    return observed.astype(np.float32)


def turn_back(rope: Array, off: Array) -> Array:
    """(N,) turns that follow the rope and correct what a walker is off, as far as one turn can."""
    turn: Array = np.clip(rope - np.sign(off), -1, 1)
    return turn


def clone(observed: Array, labels: Array, updates: int, seed: int) -> Policy:
    """A small network, trained by behavior cloning on (n, F) observations and (n,) turns."""
    with torch.random.fork_rng(devices=[]):
        torch.random.manual_seed(seed)
        net = nn.Sequential(nn.Linear(observed.shape[1], 64), nn.GELU(), nn.Linear(64, 3))
    rng = torch.Generator().manual_seed(seed)
    inputs, targets = torch.from_numpy(observed), torch.from_numpy(labels + 1)
    optimizer = torch.optim.AdamW(net.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates)
    for _ in range(updates):
        rows = torch.randint(len(inputs), (256,), generator=rng)
        loss = nn.functional.cross_entropy(net(inputs[rows]), targets[rows])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()

    @torch.no_grad()
    def act(observations: Array) -> Array:
        logits: Tensor = net(torch.from_numpy(observations))
        turns: Array = logits.argmax(-1).numpy() - 1
        return turns

    return act
