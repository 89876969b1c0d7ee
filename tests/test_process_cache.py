"""What a process keeps must not show: one environment for each config, as good as new."""

from pathlib import Path

import numpy as np

from playlearn.collection.store import store_spec
from playlearn.process_cache import cached_env, cached_env_of, cached_envs, cached_note, cached_store, forget_envs
from playlearn.store import NativeStore
from tests.fakes import PointConfig
from tests.synthetic import make_store


def test_a_config_has_one_environment_whoever_asks(tmp_path: Path) -> None:
    """An equal config, another number of clones, a store's: all get the first environment."""
    first = cached_env(PointConfig())
    assert cached_env(PointConfig()) is first
    three = cached_envs(PointConfig(), 3)
    assert len(set(map(id, three))) == 3
    assert three[0] is first
    assert cached_envs(PointConfig(), 2) == three[:2]
    store = NativeStore.create(tmp_path / "play", store_spec(first))
    assert cached_env_of(store) is first
    forget_envs()
    assert cached_env(PointConfig()) is not first


def test_a_clone_of_a_broken_environment_is_sound() -> None:
    forget_envs()
    first = cached_env(PointConfig())
    first.set_state(np.full_like(first.sim_state(), np.nan))
    clone = cached_envs(PointConfig(), 2)[1]
    assert np.isfinite(clone.sim_state()).all()


def test_stores_and_notes_are_read_once(tmp_path: Path) -> None:
    make_store(tmp_path / "play", np.random.default_rng(0), 1, 5)
    assert cached_store(str(tmp_path / "play")) is cached_store(str(tmp_path / "play"))
    (tmp_path / "note.json").write_text('{"seed": 3}')
    assert cached_note(str(tmp_path / "note.json"))["seed"] == 3
    (tmp_path / "note.json").unlink()
    assert cached_note(str(tmp_path / "note.json"))["seed"] == 3
