"""The environment that a policy was made for: names, rate, cameras; and what differs from another one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from playlearn.errors import CheckpointError, UsageError
from playlearn.layout import ObjectLayout
from playlearn.quantity import Bounds, Quantities


class Named(Protocol):
    """The names and the rate of an environment or a store."""

    @property
    def state_names(self) -> tuple[str, ...]: ...
    @property
    def achieved_names(self) -> tuple[str, ...]: ...
    @property
    def action_names(self) -> tuple[str, ...]: ...
    @property
    def fps(self) -> float: ...


@dataclass(frozen=True)
class PolicySpec:
    """The environment a policy was made for.

    state_names: what each dimension of `state` is.
    achieved_names: what each dimension of `achieved` is (see ObjectLayout).
    action_names: what each dimension of `action` is.
    fps: steps a second.
    cameras: camera -> (height, width) in pixels.
    controller: the controller's settings.
    predicts: actions, or the change of `achieved` up to the next settled moment (`action_names` are then its names).
    quantities: what the dimensions of `state` and `achieved` measure, and what bounds the actions.
    """

    state_names: tuple[str, ...]
    achieved_names: tuple[str, ...]
    action_names: tuple[str, ...]
    fps: float
    cameras: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    controller: Mapping[str, Any] = field(default_factory=dict)
    predicts: Literal["actions", "next_settled_delta"] = "actions"
    quantities: Quantities = field(default_factory=Quantities)

    @classmethod
    def from_dict(cls, written: Mapping[str, Any]) -> "PolicySpec":
        """What `dataclasses.asdict` made of one and JSON gave back."""
        return cls(
            state_names=tuple(written["state_names"]),
            achieved_names=tuple(written["achieved_names"]),
            action_names=tuple(written["action_names"]),
            fps=written["fps"],
            cameras={camera: (size[0], size[1]) for camera, size in written["cameras"].items()},
            controller=written["controller"],
            predicts=written.get("predicts", "actions"),
            quantities=Quantities.from_dict(written["quantities"]),
        )

    @property
    def bounds(self) -> Bounds:
        """The lowest and highest value of each number it predicts; () where none is known."""
        return self.quantities.action_bounds if self.predicts == "actions" else ()

    def check(self, other: Named, cameras: Mapping[str, tuple[int, int]], needed: tuple[str, ...]) -> None:
        """Refuse an environment whose dimensions mean something else.

        What a policy that knows no `achieved` is shown of it is left out, so it may have any.

        needed: the cameras the policy reads; only these are compared.

        Raises:
            CheckpointError: names, fps or a needed camera differ; the message says which.
        """
        known = ("achieved_names",) if self.achieved_names else ()
        acting = ("action_names",) if self.predicts == "actions" else ()
        for what in ("state_names", *known, *acting):
            mine, theirs = tuple(getattr(self, what)), tuple(getattr(other, what))
            if mine != theirs:
                raise CheckpointError(_difference(what.removesuffix("_names"), mine, theirs))
        if self.fps != other.fps:
            raise CheckpointError(
                f"the policy was trained at {self.fps:g} Hz, this environment runs at {other.fps:g} Hz"
            )
        for camera in needed:
            if camera not in cameras:
                raise CheckpointError(f"the policy needs camera {camera!r}, which is not there: {_names(cameras)}")
            if tuple(cameras[camera]) != tuple(self.cameras[camera]):
                raise CheckpointError(
                    f"camera {camera!r} is {tuple(cameras[camera])} pixels here, the policy was trained on "
                    f"{tuple(self.cameras[camera])}: set the environment's cameras to that size"
                )


def goal_dimensions(achieved_names: Sequence[str], patterns: Sequence[str], where: str = "this play") -> list[int]:
    """The dimensions of `achieved` that a goal state covers. where: whose they are, for messages.

    Raises:
        UsageError: a pattern matches no name, or no dimension is left.
    """
    chosen = ObjectLayout(achieved_names).select(patterns)
    if chosen:
        return chosen
    robot = "let it be the robot's own pose (`policy.encoder.goal_proprio: true`; see configs/train/lerobot.yaml)"
    if achieved_names:
        raise UsageError(
            f"encoder.goal_names is {list(patterns)}: the policy is left without a goal; name some of "
            f"{', '.join(achieved_names)}, or {robot}"
        )
    raise UsageError(
        "encoder: a goal that is a state needs `achieved` (objects; LeRobot's `observation.environment_state`), and "
        f"{where} records none: the policy is left without a goal; {robot}, or read goal images (`type: cnn`; see "
        "configs/train/lerobot_image.yaml)"
    )


def _difference(what: str, mine: tuple[str, ...], theirs: tuple[str, ...]) -> str:
    missing = [name for name in mine if name not in theirs]
    added = [name for name in theirs if name not in mine]
    parts = [f"the policy was trained for another {what}"]
    if missing:
        parts.append(f"it expects {', '.join(missing)}, which this environment lacks")
    if added:
        parts.append(f"this environment has {', '.join(added)}, which it does not know")
    if not missing and not added:
        parts.append(f"the order differs: {', '.join(mine)} against {', '.join(theirs)}")
    return "; ".join(parts)


def _names(cameras: Mapping[str, Any]) -> str:
    return "the cameras are " + ", ".join(sorted(cameras)) if cameras else "there are no cameras"
