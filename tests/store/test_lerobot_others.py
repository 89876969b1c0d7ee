"""LeRobot datasets of other people: their words are kept, what is left out is named, and no traceback."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from playlearn.errors import StoreError, UsageError
from playlearn.store import LeRobotStoreConfig, NativeStore, open_store
from playlearn.store.importing import import_recordings
from playlearn.store.lerobot import sidecar
from playlearn.store.lerobot.content import ACHIEVED, ACTION, Play, tasks
from playlearn.store.lerobot.reader import LeRobotStore
from playlearn.store.lerobot.recordings import LeRobotRecordings
from tests.lerobot_dataset import DATA, TASKS, change_info, encoded, image, vector, write_dataset
from tests.store.test_hand import STEPS, cube, hand
from tests.synthetic import make_episode

LENGTHS = (12, 9)
N = sum(LENGTHS)
STATE, TOP = "observation.state", "observation.images.top"
FRAMES = np.random.default_rng(0).integers(0, 255, (N, 8, 10, 3)).astype(np.uint8)
DEPTH = np.random.default_rng(0).integers(0, 60000, (N, 8, 10)).astype(np.uint16)


def dataset(
    root: Path, features: dict[str, Any] | None = None, columns: dict[str, Any] | None = None, **more: Any
) -> Path:
    """Two episodes with a state and an action; `features` and `columns` come on top."""
    rows = np.random.default_rng(0).normal(size=(N, 3)).tolist()
    known = {STATE: vector(["x", "y", "gripper"]), "action": vector(["dx", "dy", "gripper"])}
    return write_dataset(
        root, known | (features or {}), {STATE: rows, "action": rows} | (columns or {}), LENGTHS, **more
    )


def opened(root: Path, **settings: Any) -> LeRobotStore:
    return LeRobotStoreConfig(root=root, cache=root.parent / "frames", **settings).build()


# Their words.

WORDS = ["pick: red_block", "pick: blue block", "pick:slip", "pick_up", "  Spaces, and \u00fcml\u00e4uts \u2713 "]


def worded(root: Path) -> Path:
    """Two tasks in an episode that begin alike, one that looks like our annotation, and one alone."""
    first = [WORDS[0]] * 5 + [WORDS[1]] * 3 + [WORDS[2]] * 2 + [WORDS[3]] * 2
    return dataset(root, tasks=[first, [WORDS[4]] * LENGTHS[1]])


def test_tasks_pass_unchanged(tmp_path: Path) -> None:
    store = opened(worded(tmp_path / "made"))
    imported = import_recordings(LeRobotRecordings(store), tmp_path / "native")
    for one in (store, imported, NativeStore.open(tmp_path / "native")):
        assert set(one.info()["tasks"]) == set(WORDS)
        assert one.info()["skills"] == dict.fromkeys(sorted(WORDS[:4]), 1)
        first = one.meta(0)
        assert [first.skills[k] for k in one.array(0, "skill")] == [
            *WORDS[:1] * 5,
            *WORDS[1:2] * 3,
            *WORDS[2:3] * 2,
            WORDS[3],
        ]
        assert first.task == ""
        assert one.meta(1).task == WORDS[4]
        content = Play(one)
        assert set(content.entry(0).tasks) | set(content.entry(1).tasks) == set(WORDS)
        assert content.entry(0).tasks[:5] == (WORDS[0],) * 5
        assert set(Play(one, annotated=True).entry(0).tasks) == set(WORDS[:4])


def test_their_words_are_no_annotations(tmp_path: Path) -> None:
    """`pick:slip` is a task, not a skill `pick` that slipped."""
    from playlearn.relabeling import leads_to_failure

    store = opened(worded(tmp_path / "made"))
    assert store.meta(0).annotations() == tuple(
        (word, ()) for word in sorted(WORDS[:4], key=store.meta(0).skills.index)
    )
    assert not leads_to_failure(store.array(0, "skill"), store.meta(0).annotations()).any()


def test_no_report_says_that_their_tasks_succeeded(tmp_path: Path) -> None:
    from playlearn.report.play import figures

    counts = {"count": 5, "succeeded": 0, "failed": 0, "truncated": 2, "unknown": 3}  # one to the end of each episode
    assert figures(opened(worded(tmp_path / "made")))["attempts"] == counts


@pytest.mark.parametrize("verbatim", [False, True])
def test_an_export_keeps_annotations_and_their_words_apart(tmp_path: Path, verbatim: bool) -> None:
    """For people our skill reads as words; in its sidecar it is what it was."""
    episode = make_episode(np.random.default_rng(0), 10)
    skills = ("push_red:open_loop:slip", "open_drawer", "flip_lamp")
    meta = dataclasses.replace(episode.meta, skills=skills, verbatim=verbatim)
    made = dataclasses.replace(episode, meta=meta)
    sidecar.write(tmp_path, 0, 0, made)
    back = sidecar.Sidecar.of(tmp_path, 0).meta
    assert back == meta
    assert back.annotations()[0] == ((skills[0], ()) if verbatim else ("push_red", ("open_loop", "slip")))
    words = skills if verbatim else ("push red", "open drawer", "flip lamp")
    assert tasks(made, annotated=False) == tuple(words[skill] for skill in made.skill)


def test_an_empty_task_stays_empty(tmp_path: Path) -> None:
    store = opened(dataset(tmp_path / "made", tasks=[[""] * LENGTHS[0], ["go"] * LENGTHS[1]]))
    assert set(Play(store).entry(0).tasks) == {""}


def test_success_is_what_is_recorded_else_unknown(tmp_path: Path) -> None:
    store = opened(dataset(tmp_path / "unknown"))
    assert [store.meta(i).success for i in range(2)] == [None, None]
    assert "next.success" not in Play(store).features()  # it was not known, so it is not claimed
    solved = [False] * (N - 1) + [True]
    feature = {"next.success": vector(None, 1, "bool")}
    store = opened(dataset(tmp_path / "known", feature, {"next.success": solved}))
    assert [store.meta(i).success for i in range(2)] == [False, True]
    assert [bool(Play(store).entry(i).columns["next.success"].any()) for i in range(2)] == [False, True]
    assert store.remarks() == {}


def test_a_reward_is_no_success_and_comes_back(tmp_path: Path) -> None:
    reward = np.where(np.arange(N) % 5 == 4, 1.0, -0.25)
    features = {"next.reward": vector(None, 1), "next.done": vector(None, 1, "bool")}
    ends = np.isin(np.arange(N), np.cumsum(LENGTHS) - 1)
    root = dataset(tmp_path / "made", features, {"next.reward": reward.astype(np.float32), "next.done": ends})
    store = opened(root)
    assert store.info()["success"] == {"success": 0, "failure": 0, "unknown": 2}
    assert store.remarks() == {}
    episode = store.read(1)
    assert episode.reward is not None
    np.testing.assert_array_equal(episode.reward, reward[LENGTHS[0] : -1])
    columns = Play(store).entry(1).columns
    np.testing.assert_array_equal(columns["next.reward"][:, 0], reward[LENGTHS[0] :])  # the last frame's, too
    assert "next.success" not in columns
    for rule, success in {"reward>=1": True, "reward>1": False, "dones": True, "none": False}.items():
        said = LeRobotStoreConfig(root=root, success=rule).build()
        assert [said.meta(i).success for i in range(2)] == [success] * 2
    with pytest.raises(UsageError, match=r"asks for rewards, and .*episode 0 has none"):
        LeRobotStoreConfig(root=dataset(tmp_path / "bare"), success="reward>=1").build().meta(0)


def test_goals_are_not_about_what_depends_on_the_hand(tmp_path: Path) -> None:
    """As robosuite observes a cube: by its place, and by its place relative to the hand."""
    rng, made = np.random.default_rng(0), []
    for _ in range(4):
        at = hand(rng)
        own = cube(rng, at)
        made.append((np.concatenate([at, at], 1), np.concatenate([own, own - at], 1)))
    state, objects = (np.concatenate(rows).astype(np.float32) for rows in zip(*made, strict=True))
    names = ["cube.x", "cube.y", "cube.z", "to_cube.x", "to_cube.y", "to_cube.z"]
    features = {STATE: vector(None, 6), ACHIEVED: vector(names), ACTION: vector(None, 6)}
    root = write_dataset(tmp_path / "made", features, {STATE: state, ACHIEVED: objects, ACTION: state}, [STEPS] * 4)
    store = LeRobotStoreConfig(root=root).build()
    assert store.spec.achieved_names == ("cube.x", "cube.y", "cube.z")
    np.testing.assert_array_equal(store.read(1).achieved, objects[STEPS : 2 * STEPS, :3])
    [(left, why)] = store.remarks().items()
    assert left == "to_cube.x, to_cube.y, to_cube.z"
    assert "changing with the hand while nothing else does" in why
    chosen = LeRobotStoreConfig(root=root, goal_names=("to_cube.?",)).build()
    assert chosen.spec.achieved_names == ("to_cube.x", "to_cube.y", "to_cube.z")
    np.testing.assert_array_equal(chosen.read(1).achieved, objects[STEPS : 2 * STEPS, 3:])
    with pytest.raises(UsageError, match=r"goal_names: .* nothing is left that goals could be about"):
        LeRobotStoreConfig(root=root, achieved=STATE).build()
    assert LeRobotStoreConfig(root=root, achieved="").build().spec.achieved_names == ()


def test_a_task_without_text_is_named(tmp_path: Path) -> None:
    root = dataset(tmp_path / "made")
    pq.write_table(pa.table({"task_index": [5], "task": ["other"]}), root / TASKS)
    with pytest.raises(StoreError, match=r"episode 0: task_index is 0 .* meta/tasks.parquet has no such task"):
        opened(root)
    pq.write_table(pa.table({"task_index": [0, 0], "task": ["one", "other"]}), root / TASKS)
    with pytest.raises(StoreError, match=r"tasks.parquet has two texts for one task_index"):
        opened(root)
    (root / TASKS).unlink()
    with pytest.raises(StoreError, match=r"tasks.parquet is missing"):
        opened(root)


# What is left out.

LEFT_OUT: dict[str, tuple[dict[str, Any], Any, str]] = {
    "observation.images.depth": (image(8, 10, 1), encoded(DEPTH), "it has one channel; color images"),
    "observation.images.flagged": (image(8, 10, 3) | {"info": {"is_depth_map": True}}, encoded(FRAMES), "a depth map"),
    "observation.images.rgba": (image(8, 10, 4), encoded(np.repeat(FRAMES[..., :1], 4, axis=3)), "it has 4 channels"),
    "observation.images.flat": (image(8, 10), encoded(FRAMES[..., 0]), r"its shape (8, 10) is not that of an image"),
    "observation.images.raw": (
        {"dtype": "float32", "shape": [2, 2, 3], "names": None},
        FRAMES[:, :2, :2].astype(float).tolist(),
        "numbers of the shape (2, 2, 3)",
    ),
    "observation.tactile": (
        {"dtype": "float32", "shape": [2, 2], "names": None},
        np.zeros((N, 2, 2)).tolist(),
        "numbers of the shape (2, 2)",
    ),
    "observation.effort": (vector(["a", "b"]), np.zeros((N, 2)).tolist(), "in the `store` block names it"),
    "note": ({"dtype": "string", "shape": [1], "names": None}, ["well"] * N, "no text is read"),
    "observation.audio": ({"dtype": "audio", "shape": [1], "names": None}, [0] * N, "its dtype 'audio' is not known"),
    "intervention": (vector(None, 2), np.zeros((N, 2)).tolist(), "in the `store` block names it"),
}


def test_what_is_left_out_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from playlearn.cli import main

    features = {key: feature for key, (feature, _, _) in LEFT_OUT.items()} | {TOP: image(8, 10, 3)}
    columns = {key: column for key, (_, column, _) in LEFT_OUT.items()} | {TOP: encoded(FRAMES), "secret": [0.0] * N}
    root = dataset(tmp_path / "made", features, columns)
    store = opened(root)
    assert list(store.cameras()) == ["top"]
    remarks = store.remarks()
    assert remarks.keys() == LEFT_OUT.keys() | {"secret"}
    for key, (_, _, reason) in LEFT_OUT.items():
        assert remarks[key].startswith("left out: ")
        assert reason in remarks[key], key
    assert remarks["secret"] == f"left out: a column of {DATA} that meta/info.json does not describe"
    assert TOP in opened(root, without_images=True).remarks()

    # At the import, and in `info` of both.
    lines: list[str] = []
    import_recordings(LeRobotRecordings(store), tmp_path / "native", say=lines.append)
    assert sorted(lines) == sorted(f"{key}: {remark}" for key, remark in remarks.items())
    for where in (root, tmp_path / "native"):
        assert main(["info", str(where), "--json"]) == 0
        facts = json.loads(capsys.readouterr().out)
        assert facts["remarks"] == remarks
        assert "the gripper (gripper)" in facts["goals"]["settled moments of the robot"]
        assert main(["info", str(where)]) == 0
        assert set(lines) <= set(capsys.readouterr().out.splitlines())


def test_cameras_of_one_name_are_told_apart(tmp_path: Path) -> None:
    keys = (TOP, "observation.top", "observation.image.top")
    other = dict(zip(keys, (FRAMES, 255 - FRAMES, FRAMES // 2), strict=True))
    root = dataset(
        tmp_path / "made", dict.fromkeys(keys, image(8, 10, 3)), {key: encoded(frames) for key, frames in other.items()}
    )
    store = opened(root)
    assert list(store.cameras()) == [TOP, "observation.top", "image.top"]
    for camera, frames in zip(store.cameras(), other.values(), strict=True):
        np.testing.assert_array_equal(store.array(0, f"observation.images.{camera}"), frames[: LENGTHS[0]])
    assert store.remarks().keys() == {TOP, "observation.top"}
    assert "the dataset has 2 cameras 'top'" in store.remarks()[TOP]


@pytest.mark.parametrize(
    "shape", [image(3, 8, 10, names=("channels", "height", "width")), image(3, 8, 10), image(8, 10, 3)]
)
def test_colors_may_come_first(tmp_path: Path, shape: dict[str, Any]) -> None:
    store = opened(dataset(tmp_path / "made", {TOP: shape}, {TOP: encoded(FRAMES)}))
    np.testing.assert_array_equal(store.array(1, TOP), FRAMES[LENGTHS[0] :])


# What is not supported, or broken.


def column(name: str, value: Any) -> Callable[[Path], object]:
    """Put another column into the file of numbers."""

    def change(root: Path) -> None:
        table = pq.read_table(root / DATA)
        pq.write_table(table.set_column(table.column_names.index(name), name, pa.array(value)), root / DATA)

    return change


def feature(key: str, description: Any) -> Callable[[Path], object]:
    def change(root: Path) -> None:
        info = json.loads((root / "meta/info.json").read_text())
        change_info(root, features=info["features"] | {key: description})

    return change


VECTORS = [[1.0, 2.0, 3.0]]
BROKEN: dict[str, tuple[Callable[[Path], object], str]] = {
    "2-D": (
        feature(STATE, {"dtype": "float32", "shape": [1, 3]}),
        r"info.json: observation.state has the shape \(1, 3\), and a vector",
    ),
    "no numbers": (feature(STATE, vector(None, 0)), r"info.json: observation.state has the shape \(0,\)"),
    "text": (feature(STATE, vector(None, 1, "string")), r"info.json: observation.state is of string"),
    "image": (feature("action", image(8, 10, 3)), r"info.json: action is of image, and a vector of numbers is read"),
    "complex": (feature(STATE, vector(None, 3, "complex64")), "observation.state is of complex64"),
    "unknown dtype": (feature(STATE, vector(None, 3, "quaternion")), "observation.state is of quaternion"),
    "no dtype": (feature(STATE, {"shape": [3]}), "info.json: the feature 'observation.state' has no dtype"),
    "no shape": (
        feature(STATE, {"dtype": "float32", "shape": None}),
        "info.json: the feature 'observation.state' has no shape",
    ),
    "no description": (feature("other", None), "info.json: the feature 'other' has no dtype"),
    "no features": (lambda root: change_info(root, features=None), "info.json: `features` must map"),
    "width": (
        feature(STATE, vector(None, 4)),
        r"000.parquet: observation.state has 3 numbers at a frame, where .* says 4",
    ),
    "ragged": (
        column(STATE, VECTORS * (N - 2) + [[1.0, 2.0], [1.0, 2.0, 3.0, 4.0]]),  # as many in all as if it were even
        "episode 1: observation.state has 3 numbers at frame 0 and others at frame 7",
    ),
    "nested": (column(STATE, [VECTORS] * N), r"000.parquet: observation.state is of list<.*list<.*>>, not of numbers"),
    "strings": (column(STATE, ["a"] * N), "000.parquet: observation.state is of string, not of numbers"),
    "missing": (column(STATE, VECTORS * (N - 1) + [None]), "episode 1: observation.state is empty at frame 8"),
    "missing number": (
        column(STATE, VECTORS * (N - 1) + [[1.0, None, 2.0]]),
        "episode 1: observation.state is empty at frame 8",
    ),
    "too large": (
        column(STATE, VECTORS * (N - 1) + [[1.0, 1e300, 2.0]]),
        "episode 1: observation.state is not finite at frame 8",
    ),
    "infinite": (
        column("action", VECTORS * (N - 1) + [[1.0, np.inf, 2.0]]),
        "episode 1: action is not finite at frame 8",
    ),
    "no index": (column("index", ["a"] * N), "000.parquet: index is of string, not of numbers"),
    "episodes in lists": (column("episode_index", [[0]] * N), "000.parquet: episode_index is of list"),
    "fps": (lambda root: change_info(root, fps=1e400), "info.json: fps must be above 0, not inf"),
    "version 2.0": (
        lambda root: change_info(root, codebase_version="v2.0"),
        r"Convert it to 2.1 .*lerobot.datasets.v21.convert_dataset_v20_to_v21",
    ),
    "template": (lambda root: change_info(root, data_path="{"), r"info.json cannot be read \(Single '{'"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_not_read_is_told_in_one_message(tmp_path: Path, name: str) -> None:
    damage, message = BROKEN[name]
    damage(dataset(tmp_path / "made"))
    with pytest.raises(StoreError, match=message):
        opened(tmp_path / "made")


@pytest.mark.parametrize("dtype", ["uint8", "int64", "float16", "float64", "bool"])
def test_numbers_of_any_kind_are_read(tmp_path: Path, dtype: str) -> None:
    values = np.random.default_rng(0).integers(0, 2, (N, 3)).astype(dtype)
    rows = pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1)), 3)
    store = opened(dataset(tmp_path / "made", {STATE: vector(None, 3, dtype)}, {STATE: rows}))
    assert store.array(1, STATE).dtype == np.float32
    np.testing.assert_array_equal(store.array(1, STATE), values[LENGTHS[0] :])


@pytest.mark.parametrize("value", [1.0, [1.0]])
def test_a_single_number_is_a_vector_of_one(tmp_path: Path, value: Any) -> None:
    store = opened(dataset(tmp_path / "made", {STATE: vector(None, 1)}, {STATE: [value] * N}))
    assert store.array(0, STATE).shape == (LENGTHS[0], 1)


def test_a_feature_that_is_asked_for_must_be_there(tmp_path: Path) -> None:
    root = dataset(tmp_path / "made", {"qpos": vector(["a"])}, {"qpos": [0.0] * N})
    with pytest.raises(StoreError, match=r"no feature 'cube' for the achieved; it has observation.state, qpos"):
        opened(root, achieved="cube")
    assert opened(root, state="qpos").spec.state_names == ("a",)


PICTURES: dict[str, tuple[list[Any], str]] = {
    "another size": (
        encoded([*FRAMES[:-1], np.zeros((5, 4, 3), np.uint8)]),
        r"000.parquet: episode 1, frame 8: observation.images.top is 5x4, where .* says 8x10: set `image_size`",
    ),
    "depth": (encoded(DEPTH), "frame 0: observation.images.top is an image of mode I;16"),
    "junk": ([{"bytes": b"junk", "path": None}] * N, "frame 0: observation.images.top holds no image"),
    "elsewhere": ([{"bytes": None, "path": "frame.png"}] * N, "frame 0: observation.images.top holds no image"),
}


@pytest.mark.parametrize("name", PICTURES)
def test_an_image_that_is_another_than_stated_is_named(tmp_path: Path, name: str) -> None:
    cells, message = PICTURES[name]
    store = opened(dataset(tmp_path / "made", {TOP: image(8, 10, 3)}, {TOP: cells}))
    with pytest.raises(StoreError, match=message):
        store.read(1)


def test_images_of_any_size_can_be_scaled_to_one(tmp_path: Path) -> None:
    root = dataset(tmp_path / "made", {TOP: image(8, 10, 3)}, {TOP: PICTURES["another size"][0]})
    assert opened(root, image_size=(4, 5)).array(1, TOP).shape == (LENGTHS[1], 4, 5, 3)


@pytest.mark.parametrize("cells", [None, [b"png"] * N])
def test_a_column_without_images_is_named_when_opened(tmp_path: Path, cells: Any) -> None:
    root = dataset(tmp_path / "made", {TOP: image(8, 10, 3)}, {TOP: cells} if cells else {})
    with pytest.raises(StoreError, match=r"000.parquet has .*observation.images.top(.|\n)*`without_images: true`"):
        opened(root)
    assert len(opened(root, without_images=True)) == 2


def test_open_store_finds_it(tmp_path: Path) -> None:
    assert open_store(dataset(tmp_path / "made")).info()["format"] == "lerobot"
