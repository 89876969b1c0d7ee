"""`make_env`: from a name, a config or a mapping to an environment, and what it refuses."""

from typing import Any

import pytest

from playlearn.envs import LiftConfig, make_env
from playlearn.errors import UsageError
from playlearn.sim import CameraConfig
from tests.fakes import PointConfig, PointEnv


@pytest.mark.parametrize("what", ["point", {"type": "point"}, PointConfig()])
def test_a_name_a_mapping_and_a_config_give_the_same(what: Any) -> None:
    env = make_env(what)
    assert isinstance(env, PointEnv)
    assert env.config == PointConfig()


@pytest.mark.parametrize("what", ["point", {"type": "point"}, PointConfig()])
@pytest.mark.parametrize("size", [CameraConfig(8, 12), {"height": 8, "width": 12}])
def test_options_are_fields_of_its_config(what: Any, size: Any) -> None:
    env = make_env(what, cameras={"front": size})
    assert env.config == PointConfig(cameras={"front": CameraConfig(8, 12)})
    assert env.render("front").shape == (8, 12, 3)


def test_options_leave_the_other_fields_of_a_config_alone() -> None:
    assert make_env(PointConfig(diverge_at=7), cameras={}).config == PointConfig(diverge_at=7, cameras={})


@pytest.mark.parametrize(
    ("what", "options", "message"),
    [
        ("playtabel", {}, "there is no environment 'playtabel'; did you mean `playtable`"),
        ({"type": "lifd"}, {}, "there is no environment 'lifd'; did you mean `lift`"),
        ({"robot": "Panda"}, {}, "there is no environment None; known: .*lift, .*playtable"),
        ("lift", {"robott": "Panda"}, "unknown field `robott`; did you mean `robot`"),
        ("lift", {"robot": "Pandda"}, "'Pandda' is not a robot with one arm"),
        (LiftConfig(), {"cameras": 3}, "`cameras` must be a mapping"),
    ],
)
def test_what_cannot_be_is_refused(what: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        make_env(what, **options)
