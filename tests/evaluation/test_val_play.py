"""Laws of suites made from held-out play."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from playlearn.data.split import val_episodes
from playlearn.errors import UsageError
from playlearn.evaluation import (
    EvalEpisode,
    ValPlayConfig,
    evaluate,
)
from playlearn.policies import PolicyConfig
from tests.evaluation.parts import SUITE, play, spec, write
from tests.fakes import PointConfig, PointEnv, PointExpert, point_expert

torch.set_num_threads(1)


def test_heldout_play_gives_starts_and_goals(tmp_path: Path, run: Path) -> None:
    """Both are recorded moments of the same held-out episode, 1 to 2 s apart, and differ."""
    store = play(tmp_path / "play")
    kind = ValPlayConfig(store=tmp_path / "play", val_fraction=0.25, seconds=(1.0, 2.0))
    env = PointEnv(PointConfig())
    out = np.flatnonzero(val_episodes(store.indices(), 0.25))
    recorded = {tuple(state): (int(i), t) for i in out for t, state in enumerate(store.array(int(i), "sim.state"))}
    for e in range(20):
        episode: EvalEpisode = kind.setup(env, PointExpert(), e, 0, 50, ("front",))
        (i, t), (j, g) = recorded[tuple(episode.start_sim_state)], recorded[tuple(episode.goal_sim_state)]
        assert i == j
        assert 10 <= g - t <= 20
        assert not env.reached(episode.start_achieved, episode.goal.achieved)
        np.testing.assert_array_equal(episode.goal.achieved, store.array(i, "achieved")[g])
        env.set_state(episode.goal_sim_state)
        np.testing.assert_array_equal(episode.goal.images["front"], env.render("front"))
        assert set(episode.task.split(" + ")) <= {"puck", "lamp"}


@pytest.mark.slow
def test_heldout_play_of_the_run_itself(tmp_path: Path, run: Path) -> None:
    """Store and held-out fraction are read from the run's config if the suite leaves them open."""
    play(tmp_path / "play")
    folder = tmp_path / "run"
    PolicyConfig(chunk=8).build(spec(), None, seed=0).save(folder / "policy")
    (folder / "config.yaml").write_text(
        yaml.safe_dump({"store": str(tmp_path / "play"), "data": {"val_fraction": 0.5}})
    )
    kind = ValPlayConfig(seconds=(1.0, 2.0))
    assert kind.prepare(folder) == replace(kind, store=tmp_path / "play", val_fraction=0.5)
    suite = write(replace(SUITE, name="val", kind=kind, episodes=6), tmp_path)
    results = evaluate(suite, run=folder, goal="state", out=tmp_path / "out", workers=0, expert=point_expert)
    assert results["references"]["expert"]["success_rate"] > 0.6
    assert results["strict_rate"] == results["success_rate"], "here success is that everything is where it is shown"
    with pytest.raises(UsageError, match="name its store"):
        kind.prepare(None)
