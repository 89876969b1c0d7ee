"""Files that were cut, flipped, lost or added by others: named, never read as play, and mended by the command."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from playlearn import cli
from playlearn.collection import collect
from playlearn.errors import StoreError, UsageError
from playlearn.store import NativeStore
from tests.faults import point
from tests.faults.command import contents
from tests.synthetic import make_store


@pytest.mark.slow
@pytest.mark.parametrize("cut", [0, 10, -1])
@pytest.mark.parametrize("name", ["store.json", "collect.json"])
def test_a_note_that_was_cut_is_named_and_nothing_is_written(
    tmp_path: Path, config: Path, name: str, cut: int, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "play"
    collect(point.config(episodes=2), out, workers=0)
    whole = (out / name).read_bytes()
    (out / name).write_bytes(whole[:cut])
    before = contents(out)
    arguments = ["collect", "--config", str(config), "--out", str(out), "--workers", "0", "--resume"]
    assert cli.main(arguments) == 1
    assert f"{name} cannot be read" in capfd.readouterr().err
    assert contents(out) == before
    (out / name).write_bytes(whole)
    assert cli.main(arguments) == 0


def test_episodes_without_their_store_are_not_taken_for_a_new_one(tmp_path: Path) -> None:
    collect(point.config(episodes=2), tmp_path / "play", workers=0)
    (tmp_path / "play" / "store.json").unlink()
    with pytest.raises(StoreError, match=r"holds episodes but no store\.json: put it back"):
        collect(point.config(episodes=2), tmp_path / "play", workers=0, resume=True)


def test_what_made_it_decides_whether_it_can_be_gone_on_with(tmp_path: Path) -> None:
    collect(point.config(episodes=2), tmp_path / "play", workers=0)
    with pytest.raises(UsageError, match="begun with another steps"):
        collect(point.config(episodes=3, steps=13), tmp_path / "play", workers=0, resume=True)
    (tmp_path / "play" / "collect.json").unlink()
    with pytest.raises(UsageError, match=r"made by `playlearn collect`.*another --out"):
        collect(point.config(episodes=3), tmp_path / "play", workers=0, resume=True)


def test_a_damaged_episode_is_named_deleted_and_made_again(
    tmp_path: Path, config: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "play"
    collect(point.config(), out, workers=0)
    before = contents(out)
    flipped, cut = out / "episodes/000003.safetensors", out / "episodes/000008.safetensors"
    content = bytearray(flipped.read_bytes())
    content[-1] ^= 1
    flipped.write_bytes(content)
    assert cli.main(["info", str(out), "--verify"]) == 1
    assert re.search(r"000003\.safetensors: its checksum does not hold; delete it", capfd.readouterr().err)
    cut.write_bytes(cut.read_bytes()[:-1])
    assert cli.main(["info", str(out), "--verify"]) == 1
    assert re.search(r"000008\.safetensors.*cut short.*delete it", capfd.readouterr().err)
    flipped.unlink()
    cut.unlink()
    arguments = ["collect", "--config", str(config), "--out", str(out), "--workers", "0", "--resume"]
    assert cli.main(arguments) == 0
    assert contents(out) == before


@pytest.fixture
def small(tmp_path: Path) -> NativeStore:
    return make_store(tmp_path / "play", np.random.default_rng(0), 3, 5)


def test_no_flipped_bit_goes_unseen(small: NativeStore) -> None:
    """150 places of one file, drawn at random, a bit each: opening or verifying names the file every time."""
    path = small.path / "episodes/000001.safetensors"
    whole = path.read_bytes()
    rng = np.random.default_rng(1)
    for at in rng.choice(len(whole), 150, replace=False):
        content = bytearray(whole)
        content[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(content)
        try:
            problems = NativeStore.open(small.path).verify()
        except StoreError as error:
            problems = [str(error)]
        assert len(problems) == 1, f"byte {at}"
        assert "000001" in problems[0]


def test_strangers_among_the_episodes_are_named_and_never_read(small: NativeStore) -> None:
    folder = small.path / "episodes"
    strangers = ["7.safetensors", "holiday.jpg", "copy of 000001.safetensors", "٣.safetensors"]
    for name in strangers:
        shutil.copy(folder / "000001.safetensors", folder / name)
    again = NativeStore.open(small.path)
    assert again.indices().tolist() == [0, 1, 2]
    assert sorted(again.verify()) == sorted(
        f"{folder / name} does not belong here: move it out of the store" for name in strangers
    )
    (folder / "000001.safetensors").unlink()
    assert NativeStore.open(small.path).info()["missing"] == [1]
