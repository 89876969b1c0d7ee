"""Untrained policies of the point environment."""

from pathlib import Path

import pytest
import torch

from playlearn.policies import PolicyConfig
from playlearn.policies.encoders import CNNConfig
from playlearn.policies.trunks import MLPConfig
from tests.evaluation.parts import spec

torch.set_num_threads(1)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An untrained policy that reads goal states."""
    folder = tmp_path_factory.mktemp("runs") / "state"
    PolicyConfig(chunk=8).build(spec(), None, seed=0).save(folder / "policy")
    return folder


@pytest.fixture(scope="module")
def image_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One that reads goal images."""
    folder = tmp_path_factory.mktemp("runs") / "image"
    encoder = CNNConfig(cameras=("front",), goal_camera="front")
    trunk = MLPConfig(width=64)  # unlike a Transformer it imports nothing that each worker would have to import too
    PolicyConfig(encoder=encoder, trunk=trunk, chunk=8).build(spec(), None, seed=0).save(folder / "policy")
    return folder
