"""What is compared: our environments beside the robosuite environment of the same scene."""

import contextlib
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from playlearn.envs import PlayTableConfig
from playlearn.envs.lift import LiftConfig
from playlearn.episode import Array
from playlearn.sim.robosuite_env import RobosuiteEnv

SEED = 0
SIDE = 84  # pixels, the size that robosuite's own benchmarks and robomimic use


@dataclass(frozen=True, eq=False)
class Pair:
    """Two environments of the same scene.

    name: of the scene.
    ours, peer: the environments.
    cameras: ours.
    peer_cameras: robosuite's most similar ones.
    """

    name: str
    ours: RobosuiteEnv
    peer: Any
    cameras: tuple[str, ...]
    peer_cameras: tuple[str, ...]


def pairs(envs: Sequence[str], *, images: bool) -> Iterator[Pair]:
    """The named pairs of PlayTable and Lift; with `images` the peer renders both cameras at every step."""
    import robosuite

    from playlearn.envs.playtable.scene import PlayTable

    def peer(make: Any, cameras: list[str]) -> Any:
        seeing = {"use_camera_obs": True, "camera_names": cameras, "camera_heights": SIDE, "camera_widths": SIDE}
        with _quiet():
            made = make(
                robots="Panda",
                has_renderer=False,
                has_offscreen_renderer=images,
                hard_reset=False,  # a discarded scene would later free the GL resources of the next one
                ignore_done=True,
                **(seeing if images else {"use_camera_obs": False}),
            )
            made.reset()
        return made

    if "playtable" in envs:
        made = peer(PlayTable, ["front", "wrist"])
        yield Pair("playtable", PlayTableConfig().build(), made, ("front", "wrist"), ("front", "wrist"))
    if "lift" in envs:
        lift = LiftConfig().build()
        stock = ["agentview", "robot0_eye_in_hand"]
        made = peer(lambda **kwargs: robosuite.make("Lift", **kwargs), stock)
        yield Pair("lift", lift, made, tuple(lift.spec.cameras), tuple(stock))


def actions(steps: int) -> Array:
    """(steps, 7) smooth random actions; the gripper opens and closes."""
    rng = np.random.default_rng(SEED)
    drift: Array = np.zeros(6)
    made = np.empty((steps, 7))
    for t in range(steps):
        drift = 0.9 * drift + 0.44 * rng.normal(0, 0.3, 6)
        made[t, :6], made[t, 6] = np.clip(drift, -1, 1), 1.0 if t // 20 % 2 else -1.0
    made[:, 3:6] *= 0.3
    return made


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
