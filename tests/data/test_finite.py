"""What is made of play, and learned from, is as finite as the play: or the file and the number are named."""

from pathlib import Path

import numpy as np
import pytest

from playlearn.data import Corrections, DataConfig, Perceived, PlayDataset, check_finite
from playlearn.episode import Array
from playlearn.errors import StoreError
from playlearn.store import episode_path
from playlearn.store.tensors import write_tensors
from tests.synthetic import ACHIEVED, ACTION, STATE, make_store


@pytest.fixture
def dataset(tmp_path: Path) -> PlayDataset:
    store = make_store(tmp_path / "play", np.random.default_rng(0), 2, 60)
    return DataConfig(val_fraction=0).build(store, "train", 0)


def write(folder: Path, arrays: dict[str, Array], wrong: str) -> Path:
    """A file for each of two episodes; in the second, the last number of the array `wrong` is infinite."""
    for number in (0, 1):
        if number == 1:
            arrays[wrong].reshape(-1)[-1] = np.inf
        path = episode_path(folder, number)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_tensors(path, arrays, {})
    return folder


@pytest.mark.parametrize("wrong", ["observed", "wanted"])
def test_estimates_are_finite(wrong: str, dataset: PlayDataset, tmp_path: Path) -> None:
    estimates = {name: np.zeros((3, len(ACHIEVED)), np.float32) for name in ("observed", "wanted")}
    folder = write(tmp_path / "perceived", {"t": np.array([0, 20, 40]), **estimates}, wrong)
    with pytest.raises(StoreError, match=rf"000001.safetensors, {wrong}: lamp.on is inf in row 2"):
        Perceived(folder, dataset)


@pytest.mark.parametrize("wrong", ["observation.state", "action"])
def test_corrections_are_finite(wrong: str, dataset: PlayDataset, tmp_path: Path) -> None:
    arrays = {
        "t": np.array([1, 2]),
        "observation.state": np.zeros((2, len(STATE)), np.float32),
        "action": np.zeros((2, 4, len(ACTION)), np.float32),
    }
    folder = write(tmp_path / "corrections", arrays, wrong)
    last = {"observation.state": STATE, "action": ACTION}[wrong][-1]
    with pytest.raises(StoreError, match=rf"000001.safetensors, {wrong}: {last} is inf in row 1"):
        Corrections(folder, dataset, 0.5)


def test_finite_numbers_and_none_at_all_pass() -> None:
    check_finite(np.zeros((3, 2)), ("x", "y"), "here")
    check_finite(np.zeros((3, 0)), (), "here")
