"""A fixed workload, timed on this machine: the cost of a stage is given as a multiple of it.

Two parts, because processors differ in them: `simulation` steps PlayTable under its play policy, `learning` makes
updates of a small convolutional network. One thread, one core; a few seconds.
"""

import time
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from playlearn.envs import PlayTableConfig
from playlearn.oracles import PlayConfig
from playlearn.policies.encoders.cameras import channels_last
from playlearn.rollout import rollout

STEPS, UPDATES = 200, 40


@dataclass(frozen=True)
class Reference:
    """Seconds of wall clock that each part takes, so that other load on the machine counts."""

    simulation: float
    learning: float


def measure() -> Reference:
    """Time both parts, each after a short warm-up."""
    return Reference(_simulation(), _learning())


def _simulation() -> float:
    environment = PlayTableConfig().build()
    policy = PlayConfig().build(environment)
    seconds = 0.0
    for steps in (10, STEPS):
        environment.reset(0)
        began = time.perf_counter()
        rollout([environment], policy, [None], seeds=[0], max_steps=steps)
        seconds = time.perf_counter() - began
    return seconds


def _learning() -> float:
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(48, 3, 64, 96, generator=generator).to(memory_format=torch.channels_last)
    convolutions = nn.Sequential(nn.Conv2d(3, 32, 8, 4, 2), nn.ReLU(), nn.Conv2d(32, 32, 3, 1, 1), nn.ReLU())
    network = channels_last(nn.Sequential(convolutions, nn.Flatten(), nn.Linear(32 * 16 * 24, 64)))
    optimizer = torch.optim.AdamW(network.parameters())
    times = []
    for _ in range(UPDATES):
        began = time.perf_counter()
        optimizer.zero_grad()
        network(images).square().mean().backward()
        optimizer.step()
        times.append(time.perf_counter() - began)
    return float(np.sum(times[UPDATES // 4 :])) * 4 / 3
