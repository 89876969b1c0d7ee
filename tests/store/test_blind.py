"""A blind store holds what a robot records, whatever else is in the store behind it."""

from pathlib import Path

import numpy as np
import pytest

from playlearn.store import BlindStore, NativeStore, StoreSpec, open_store
from tests.synthetic import make_episode


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("blind") / "play"
    made = [
        make_episode(np.random.default_rng(k), 30, ("front",), seed=k, ended="fell", success=True, reward=np.ones(30))
        for k in range(2)
    ]
    store = NativeStore.create(path, StoreSpec.of(made[0]))
    with store.writer() as writer:
        for episode in made:
            writer.append(episode)
    return path


def test_what_a_robot_would_not_have_is_hidden_and_all_else_is_as_it_was(folder: Path) -> None:
    true, blind = open_store(folder).read(1), open_store(folder, blind=True).read(1)
    shapes = {name: getattr(blind, name).shape for name in ("achieved", "sim_state")}
    assert shapes == {"achieved": (31, 0), "sim_state": (31, 0)}
    np.testing.assert_array_equal(blind.expert_action, true.action)
    assert not np.array_equal(true.expert_action, true.action)
    assert not blind.skill.any()
    assert blind.reward is None
    meta = blind.meta
    hidden = (meta.achieved_names, meta.skills, meta.success, meta.ended, meta.seed, meta.quantities.achieved)
    assert hidden == ((), (), None, "unknown", -1, ())
    assert meta.environment == {"type": "synthetic"}, "nothing from which a scene could be built again"
    for name in ("state", "action", "time", "intervention"):
        np.testing.assert_array_equal(getattr(blind, name), getattr(true, name))
    np.testing.assert_array_equal(blind.images["front"], true.images["front"])
    for name in ("state_names", "fps", "controller", "actor", "cameras", "versions"):
        assert getattr(meta, name) == getattr(true.meta, name)
    assert meta.quantities.state == true.meta.quantities.state


def test_it_is_a_store_like_any_other(folder: Path) -> None:
    true, blind = open_store(folder), open_store(folder, blind=True)
    assert (len(blind), blind.name(), blind.cameras()) == (len(true), true.name(), true.cameras())
    assert blind.lengths().tolist() == true.lengths().tolist()
    assert blind.indices().tolist() == true.indices().tolist()
    blind.spec.check(StoreSpec.of(blind.read(0)))
    assert (blind.digests(), blind.verify(), blind.rewards(0)) == (true.digests(), [], None)
    info = blind.info()
    assert (info["achieved"], info["skills"], info["environment"]) == ([], {}, {"type": "synthetic"})
    assert info["success"] == {"success": 0, "failure": 0, "unknown": 2}
    hidden = "achieved, sim.state, expert_action, skill, reward, success"
    assert blind.remarks() == {hidden: "hidden: `blind`"}
    assert BlindStore(blind).remarks() == blind.remarks(), "of what a robot records nothing more is hidden"
