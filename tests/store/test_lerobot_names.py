"""Every form of `names` that LeRobot writes or its datasets hold; each dimension gets a name of its own."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.store import open_store
from playlearn.store.lerobot.names import read_names
from tests.lerobot_dataset import vector, write_dataset

READ: dict[str, tuple[Any, list[str]]] = {
    "list": (["x", "y", "gripper"], ["x", "y", "gripper"]),
    "list of lists": ([["x", "y", "gripper"]], ["x", "y", "gripper"]),
    "motors": ({"motors": ["x", "y", "gripper"]}, ["x", "y", "gripper"]),
    "axes": ({"axes": ["x", "y", "gripper"]}, ["x", "y", "gripper"]),
    "parts": ({"arm": ["x", "y"], "gripper": "gripper"}, ["x", "y", "gripper"]),
    "name to index": ({"gripper": 2, "x": 0, "y": 1}, ["x", "y", "gripper"]),
    "index to name": ({"1": "y", "0": "x", "2": "gripper"}, ["x", "y", "gripper"]),
    "mapping in a part": ({"motors": {"gripper": 2, "x": 0, "y": 1}}, ["x", "y", "gripper"]),
    "text": ("gripper", ["gripper"]),
    "null": (None, ["state.0", "state.1"]),
    "none": ([], ["state.0", "state.1"]),
}


@pytest.mark.parametrize("form", READ)
def test_every_form_is_read(form: str) -> None:
    names, expected = READ[form]
    assert read_names("observation.state", names, len(expected)) == (tuple(expected), "")


OTHERWISE: dict[str, tuple[Any, list[str], str]] = {
    # LIBERO's own: both fingers are called gripper.
    "twice": (["x", "gripper", "gripper"], ["x", "gripper_0", "gripper_1"], "'gripper' more than once"),
    "twice in parts": ({"left": ["j0"], "right": ["j0"]}, ["left.j0", "right.j0"], "'j0' more than once"),
    "twice, and taken": (["a", "a", "a_0"], ["state.0", "state.1", "state.2"], "cannot be told apart"),
    "gaps": ({"x": 0, "gripper": 3}, ["x", "state.1", "state.2", "gripper"], "those of 2 of 4 numbers"),
    "index too high": ({"x": 1, "y": 2}, ["state.0", "state.1"], "not at 2 of the indices 0 to 1"),
    "index twice": ({"x": 0, "y": 0}, ["state.0", "state.1"], "not at 2 of the indices"),
    "too few": (["state"], ["state.0", "state.1"], "are 1 for 2 numbers"),
    "too many": (["a", "b", "c"], ["state.0", "state.1"], "are 3 for 2 numbers"),
    "text": ("x, y", ["state.0", "state.1"], "are 1 for 2 numbers"),
    "numbers": ([0, 1], ["state.0", "state.1"], "hold 0, which is no name"),
    "nothing": (["x", None], ["state.0", "state.1"], "hold None, which is no name"),
    "empty": (["x", " "], ["state.0", "state.1"], "hold ' ', which is no name"),
    "units": ({"x": "m", "y": "m"}, ["state.0", "state.1"], "map texts to texts"),
}


@pytest.mark.parametrize("form", OTHERWISE)
def test_names_that_cannot_be_used_are_replaced_and_it_is_said(form: str) -> None:
    names, expected, reason = OTHERWISE[form]
    found, said = read_names("observation.state", names, len(expected))
    assert found == tuple(expected)
    assert reason in said
    assert said.endswith(f"they are called {', '.join(expected)}")


def play(steps: int) -> np.ndarray:
    """(steps, 3): a hand that wanders, and a gripper that closes and opens every 15 steps."""
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.normal(0, 0.02, (steps, 3)), axis=0)
    x[:, 2] = np.where(np.arange(steps) // 15 % 2, 0.04, 0.0)
    return x.astype(np.float32)


def test_a_mapping_gives_the_same_names_and_moments_as_a_list(tmp_path: Path) -> None:
    """As LeRobot's gamepad writes it; the action's in another order than the state's."""
    rows = play(60).tolist()
    forms = {
        "listed": (["x", "y", "gripper"], ["dx", "dy", "gripper"]),
        "mapped": ({"x": 0, "y": 1, "gripper": 2}, {"gripper": 2, "dx": 0, "dy": 1}),
    }
    stores = {
        form: open_store(
            write_dataset(
                tmp_path / form,
                {"observation.state": vector(state), "action": vector(action)},
                {"observation.state": rows, "action": rows},
                [60],
            )
        )
        for form, (state, action) in forms.items()
    }
    for store in stores.values():
        assert store.spec.state_names == ("x", "y", "gripper")
        assert store.spec.action_names == ("dx", "dy", "gripper")
        assert store.remarks() == {}
    # The gripper opens at 15 and at 45: it is found by its name.
    settled = [RelabelIndex.of_store(store, SettlingConfig()).settled(0)[0].tolist() for store in stores.values()]
    assert settled == [[15, 45], [15, 45]]


def test_a_replaced_name_is_a_remark_of_the_store(tmp_path: Path) -> None:
    rows = play(20).tolist()
    store = open_store(
        write_dataset(
            tmp_path / "made",
            {"observation.state": vector(["state"], 3), "action": vector(["x", "x", "g"])},
            {"observation.state": rows, "action": rows},
            [20],
        )
    )
    assert store.spec.state_names == ("state.0", "state.1", "state.2")
    assert store.spec.action_names == ("x_0", "x_1", "g")
    assert "are 1 for 3 numbers" in store.remarks()["observation.state"]
    assert "'x' more than once" in store.remarks()["action"]
