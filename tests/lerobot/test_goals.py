"""Relabeled exports: every window ends in the goal that all of its frames carry."""

from pathlib import Path

import numpy as np
import pytest

from playlearn.errors import UsageError
from playlearn.lerobot.goals import RelabelConfig, Windows
from playlearn.lerobot.share import contents, share
from playlearn.relabeling import RandomConfig, RelabelIndex, SettlingConfig, UniformConfig
from playlearn.store import NativeStore
from tests.synthetic import ACHIEVED, make_store

pytestmark = pytest.mark.filterwarnings("ignore")  # what LeRobot and the packages below it warn of is theirs to fix
CAMERAS = {"front": (16, 24), "wrist": (16, 16)}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> NativeStore:
    return make_store(tmp_path_factory.mktemp("goals") / "play", np.random.default_rng(0), 3, 200, CAMERAS)


def test_windows_follow_each_other_and_end_in_their_goals(store: NativeStore) -> None:
    windows = Windows(store, RelabelConfig()).windows
    index = RelabelIndex.of_store(store, SettlingConfig())
    for episode in range(3):
        own = [window for window in windows if window.episode == episode]
        assert own[0].begin == 0
        assert [window.begin for window in own[1:]] == [window.goal for window in own[:-1]]  # no step is left out
        moments, ends = index.settled(episode)
        assert len(own) == len(moments)  # the next settled one is the goal, and each is reached once
        for window, moment, end in zip(own, moments, ends, strict=True):
            assert moment <= window.goal <= end


def test_every_frame_carries_the_goal_that_the_window_ends_in(store: NativeStore) -> None:
    content = Windows(store, RelabelConfig(goals=UniformConfig(horizon=2.0), cameras=("front",), seed=3))
    for i, window in enumerate(content.windows):
        entry, episode = content.entry(i), store.read(window.episode)
        assert len(entry) == window.goal - window.begin
        columns = entry.columns
        assert set(columns) == set(content.features())
        for t in range(len(entry)):
            np.testing.assert_array_equal(
                columns["observation.images.front"][t], episode.images["front"][window.begin + t]
            )
            np.testing.assert_array_equal(
                columns["observation.images.goal_front"][t], episode.images["front"][window.goal]
            )
            np.testing.assert_array_equal(columns["observation.goal.state"][t], episode.achieved[window.goal])
            np.testing.assert_array_equal(columns["observation.goal.proprio"][t], episode.state[window.goal])
            # achieved goal, then goal
            both = np.concatenate([episode.achieved[window.begin + t], episode.achieved[window.goal]])
            np.testing.assert_array_equal(columns["observation.environment_state"][t], both)
        assert columns["next.success"][:, 0].tolist() == [False] * (len(entry) - 1) + [True]
    assert content.features()["observation.environment_state"]["names"][len(ACHIEVED)] == f"goal.{ACHIEVED[0]}"


def test_the_same_seed_gives_the_same_windows(store: NativeStore) -> None:
    drawn = [Windows(store, RelabelConfig(goals=UniformConfig(), seed=seed)).windows for seed in (1, 1, 2)]
    assert drawn[0] == drawn[1] != drawn[2]


def test_what_cannot_be_relabeled_is_refused(store: NativeStore) -> None:
    with pytest.raises(UsageError, match="moments that are not later"):
        _ = Windows(store, RelabelConfig(goals=RandomConfig())).windows
    with pytest.raises(UsageError, match="no images of top; it has: front, wrist"):
        Windows(store, RelabelConfig(cameras=("top",))).features()


@pytest.mark.slow
def test_lerobot_takes_its_goal_for_one_more_camera(
    store: NativeStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.utils.feature_utils import dataset_to_policy_features

    import datasets

    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", str(tmp_path / "cache"))
    content = contents(store, RelabelConfig())
    share(content, tmp_path / "out", None)
    dataset = LeRobotDataset("local/out", root=tmp_path / "out")
    assert dataset.num_episodes == len(content)
    seen = dataset_to_policy_features(dataset.meta.features)
    assert {key: feature.type.name for key, feature in seen.items() if "goal" in key} == {
        "observation.goal.proprio": "STATE",
        "observation.goal.state": "STATE",
        "observation.images.goal_front": "VISUAL",
        "observation.images.goal_wrist": "VISUAL",
    }
    card = (tmp_path / "out" / "README.md").read_text()
    assert (tmp_path / "out" / "play.png").stat().st_size > 1000
    assert "- LeRobot\n" in card
    assert "task_categories:\n- robotics" in card
    assert f"| episodes, frames, rate | {len(content)}, of 600 steps of play, 20 Hz |" in card
    assert "every pixel as it was" in card
