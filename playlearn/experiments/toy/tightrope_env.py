"""A tightrope of cues: the toy world of two experiments.

At every step the rope turns by -1, 0 or 1, as a cue tells him who can read it; a walker who turns otherwise
is off by the difference, and stays so until he turns back. The expert follows the rope, and from beside it
steps back. What is seen: the cue, blurred (CUE numbers), and how far off one is (2 numbers, 0 on the rope).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from playlearn.episode import Array

CUE, BLUR, FURTHEST = 12, 0.7, 3  # blurred so that some cues in a thousand are misread

Policy = Callable[[Array], Array]
"""(N, CUE + 2) seen -> (N,) turns in -1, 0, 1."""


@dataclass(frozen=True, eq=False)
class Walk:
    """N walks of T steps. seen (N, T, CUE + 2), turn (N, T) what was done, right (N, T) what the expert would do."""

    seen: Array
    turn: Array
    right: Array

    @property
    def mistakes(self) -> float:
        """A walk, on average."""
        return float((self.turn != self.right).sum(axis=1).mean())


def walk(policy: Policy | None, walks: int, steps: int, rng: np.random.Generator, stumble: float = 0.0) -> Walk:
    """Let a policy, or None for the expert, walk; with `stumble` a share of the turns executed is drawn by chance."""
    signs = np.random.default_rng(0).standard_normal((3, CUE))  # what the three cues look like: always the same
    off: Array = np.zeros(walks, int)
    rows: list[tuple[Array, Array, Array]] = []
    for _ in range(steps):
        rope = rng.integers(-1, 2, walks)
        seen = observe(signs[rope + 1] + BLUR * rng.standard_normal((walks, CUE)), off)
        right = back_to(rope, off)
        turn = right if policy is None else policy(seen)
        if stumble:
            turn = np.where(rng.random(walks) < stumble, rng.integers(-1, 2, walks), turn)
        rows.append((seen, turn, right))
        off = np.clip(off + turn - rope, -FURTHEST, FURTHEST)
    return Walk(*(np.stack(column, axis=1) for column in zip(*rows, strict=True)))


def observe(cue: Array, off: Array) -> Array:
    """(N, CUE + 2)."""
    seen: Array = np.concatenate([cue, np.maximum(off, 0)[:, None], np.maximum(-off, 0)[:, None]], axis=1)
    return seen.astype(np.float32)


def back_to(rope: Array, off: Array) -> Array:
    """(N,) the turn that follows the rope and takes back what one is off, as far as a turn can."""
    right: Array = np.clip(rope - np.sign(off), -1, 1)
    return right


def cloned(seen: Array, right: Array, updates: int, seed: int) -> Policy:
    """A small network taught to turn right: (n, F) seen, (n,) turns."""
    with torch.random.fork_rng(devices=[]):
        torch.random.manual_seed(seed)
        net = nn.Sequential(nn.Linear(seen.shape[1], 64), nn.GELU(), nn.Linear(64, 3))
    rng = torch.Generator().manual_seed(seed)
    inputs, targets = torch.from_numpy(seen), torch.from_numpy(right + 1)
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
    def act(now: Array) -> Array:
        logits: Tensor = net(torch.from_numpy(now))
        turns: Array = logits.argmax(-1).numpy() - 1
        return turns

    return act
