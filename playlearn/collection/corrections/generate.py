"""Make displaced moments of a store's episodes, on all cores; an interrupted call continues where it stopped."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from playlearn.collection.corrections.response import end_effector_response
from playlearn.collection.corrections.rollback import CorrectableEnv, way_back
from playlearn.data.corrections import CorrectionsConfig
from playlearn.episode import IMAGES, Array
from playlearn.episode_jobs import made_of, make_files
from playlearn.errors import UsageError
from playlearn.executor import Job
from playlearn.process_cache import cached_env_of, cached_note, cached_store
from playlearn.store import Store, episode_path
from playlearn.store.tensors import write_tensors

NOTE = "corrections.json"
_MEASURED = 40  # episodes on which the response is measured
_TRIES = 5  # moments looked at for each that is wanted


def make_corrections(
    config: CorrectionsConfig,
    store: Store,
    episodes: NDArray[np.int64],
    cameras: Sequence[str],
    folder: Path,
    workers: int | None = None,
) -> None:
    """Leave in `folder` a file for each of `episodes` (positions in the store); those that are there already stay.

    A file holds, of n moments: t (n,), observation.state (n, S), action (n, k, A) the labels that lead back,
    displacement (n, 6) m and rad, and images of `cameras` (n, h, w, 3).

    Raises:
        UsageError: `folder` was made with other settings, or the store's environment cannot displace its arm.
        StoreError: the store lacks simulator states.
        BusyError: another process makes them.
        DiskError: the disk is full.
    """
    response = end_effector_response(store, episodes[:_MEASURED].tolist())
    note = {
        **made_of(store),
        "cameras": {camera: list(store.cameras()[camera]) for camera in cameras},
        "response": response.tolist(),
        **{name: getattr(config, name) for name in ("displacement", "turn", "per_episode", "steps", "seed")},
    }
    jobs = [
        Job(
            key=int(number), function=correct, kwargs={"source": store.name(), "out": str(folder), "index": int(number)}
        )
        for number in store.indices()[episodes]
    ]
    make_files(folder, "corrections", note, jobs, workers)


def correct(source: str, out: str, index: int) -> None:
    """Make displaced moments of the episode that was recorded under `index`: one job."""
    store, note = cached_store(source), cached_note(str(Path(out) / NOTE))
    position = int(np.searchsorted(store.indices(), index))
    env = _environment(store)
    states, labels = store.array(position, "sim.state"), store.array(position, "expert_action")
    sizes, steps = note["cameras"], int(note["steps"])
    response, rng = np.asarray(note["response"]), np.random.default_rng((int(note["seed"]), index))
    rows: dict[str, list[Array]] = {key: [] for key in ("t", "observation.state", "action", "displacement")}
    rows |= {IMAGES + camera: [] for camera in sizes}
    for t in rng.permutation(max(0, len(labels) - steps + 1))[: _TRIES * note["per_episode"]]:
        if len(rows["t"]) == note["per_episode"]:
            break
        shift, turn = _within_ball(note["displacement"], rng), _within_ball(note["turn"], rng)
        if _touches(env, states[t + steps]) or _touches(env, states[t]):
            continue  # it would lose what it holds or pushes, now or on the way back
        before = env.observe().achieved
        if not env.displace(shift, turn):
            continue
        seen = env.observe()
        if not np.array_equal(seen.achieved, before):
            continue
        images = {camera: env.render(camera, h, w) for camera, (h, w) in sizes.items()}
        back = way_back(env, states[t], labels[t : t + steps], response, shift, turn)
        if back is None:
            continue
        rows["t"].append(np.asarray(t, np.int64))
        rows["observation.state"].append(seen.state)
        rows["action"].append(back)
        rows["displacement"].append(np.concatenate([shift, turn]))
        for camera, image in images.items():
            rows[IMAGES + camera].append(image)
    shapes = {
        "t": (),
        "observation.state": (len(store.spec.state_names),),
        "action": (steps, len(store.spec.action_names)),
        "displacement": (6,),
        **{IMAGES + camera: (h, w, 3) for camera, (h, w) in sizes.items()},
    }
    dtypes = {"t": np.int64, "displacement": np.float64, **{IMAGES + camera: np.uint8 for camera in sizes}}
    arrays = {
        key: np.array(values, dtypes.get(key, np.float32)).reshape(-1, *shapes[key]) for key, values in rows.items()
    }
    write_tensors(episode_path(Path(out), index), arrays, {"format": "corrections"})


def _touches(env: CorrectableEnv, state: Array) -> bool:
    """Whether the robot touches something in a recorded state; the environment is left in that state."""
    env.set_state(np.array(state))
    return env.touching()


def _within_ball(radius: float, rng: np.random.Generator) -> Array:
    """(3,) uniform in direction and in length up to `radius`: small displacements are the common case."""
    direction = rng.normal(size=3)
    return direction / np.linalg.norm(direction) * radius * rng.random()


def _environment(store: Store) -> CorrectableEnv:
    env = cached_env_of(store)
    if not isinstance(env, CorrectableEnv):
        raise UsageError(
            "corrections: this environment cannot displace an arm (`displace`, `touching`); leave them out"
        )
    return env
