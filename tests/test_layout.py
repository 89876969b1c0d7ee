"""Laws of what names say of the dimensions that they name."""

import pytest

from playlearn.errors import UsageError
from playlearn.layout import ObjectLayout

NAMES = ("red.x", "red.c", "lamp", "blue.x", "nut.peg.x", "red.on")


def test_every_dimension_is_of_one_object() -> None:
    assert sorted(k for own in ObjectLayout(NAMES).objects().values() for k in own) == list(range(len(NAMES)))


def test_an_object_is_what_stands_before_the_first_dot_and_an_axis_what_stands_after_the_last() -> None:
    layout = ObjectLayout(NAMES)
    assert layout.objects() == {"red": [0, 1, 5], "lamp": [2], "blue": [3], "nut": [4]}
    assert layout.parts == ("x", "c", "", "x", "peg.x", "on")
    assert layout.axes == ("x", "c", "lamp", "x", "x", "on")


def test_only_what_has_x_y_and_z_has_a_place() -> None:
    names = ("red.x", "red.y", "red.z", "red.c", "drawer.opening", "pad.x", "pad.y", "blue.z", "blue.y", "blue.x")
    layout = ObjectLayout(names)
    assert layout.places() == {"red": (0, 1, 2), "blue": (9, 8, 7)}
    assert layout.having(("x", "y")) == {"red": (0, 1), "pad": (5, 6), "blue": (9, 8)}


def test_what_is_selected_keeps_the_order_of_the_names() -> None:
    assert ObjectLayout(("red.x", "blue.x", "lamp.on")).select(("lamp*", "red.*")) == [0, 2]


def test_a_pattern_without_a_match_is_refused_unless_there_are_no_dimensions() -> None:
    with pytest.raises(UsageError, match=r"goal_names: 'green\.\*' matches none of: red\.x"):
        ObjectLayout(("red.x",)).select(("red.*", "green.*"))
    assert ObjectLayout(()).select(("*", "green.*")) == []
