"""What bounds the actions of robosuite's recordings: the controllers that took them, as a file's settings have it.

robosuite clips what a controller gets to `input_min` .. `input_max`, unless it is commanded in absolute poses, and what
a gripper gets to -1 .. 1.
"""

from collections.abc import Mapping
from typing import Any

from playlearn.quantity import Bounds

GRIPPER = -1.0, 1.0  # of a gripper, which follows the arm: only where the arm has the same are all known


def action_bounds(settings: Mapping[str, Any], actions: int) -> Bounds:
    """(A,) of a recording with these settings (`env_kwargs`, `env_info`); () where they do not say.

    settings: of robosuite 1.4 (one controller) or 1.5 (one for each part of the body).
    """
    given = settings.get("controller_configs")
    robots = [one for one in (given if isinstance(given, list) else [given]) if isinstance(one, Mapping)]
    parts = [part for robot in robots for part in robot.get("body_parts", {"": robot}).values()]
    found = {_bounds(part) for part in parts if isinstance(part, Mapping)}
    shared = found.pop() if len(found) == 1 else None
    return (shared,) * actions if shared == GRIPPER else ()


def _bounds(controller: Mapping[str, Any]) -> tuple[float, float] | None:
    """The bounds that all its inputs share; None where they differ, or are absolute poses."""
    absolute = controller.get("control_delta") is False or controller.get("input_type") == "absolute"
    low, high = controller.get("input_min"), controller.get("input_max")
    if absolute or low is None or high is None:
        return None
    lows, highs = (set(map(float, end if isinstance(end, list) else [end])) for end in (low, high))
    return (lows.pop(), highs.pop()) if len(lows) == len(highs) == 1 else None
