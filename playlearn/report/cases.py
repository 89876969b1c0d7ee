"""Which goals a store of play allows, by which config, and how many settled moments are found in it."""

from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.store import Store

CONFIGS = {
    "goal image": "configs/train/lerobot_image.yaml",
    "robot's pose": "configs/train/lerobot.yaml",
    "goal state": "configs/train/lerobot_objects.yaml",
}


def cases(store: Store) -> dict[str, str]:
    """How a goal may be given -> what it would hold, or why it cannot; and what settled moments are read from."""
    spec = store.spec
    cameras = ", ".join(f"{camera} {h}x{w}" for camera, (h, w) in store.cameras().items())
    given = {
        "goal image": f"cameras {cameras}" if cameras else "",
        "robot's pose": f"{len(spec.state_names)} numbers",
        "goal state": f"objects, {len(spec.achieved_names)} numbers" if spec.achieved_names else "",
    }
    missing = {"goal image": "no images", "goal state": "no objects (`achieved`)"}
    found = {
        case: f"{holds}, as in {CONFIGS[case]}" if holds else f"not possible: {missing[case]}"
        for case, holds in given.items()
    }
    settling = SettlingConfig()
    if spec.achieved_names:
        found["settled moments"] = f"{_moments(store, settling)} by the objects"
    by_robot = SettlingConfig(source="robot")
    found["settled moments of the robot"] = f"{_moments(store, by_robot)}: {by_robot.robot.describe(spec.state_names)}"
    return found


def _moments(store: Store, settling: SettlingConfig) -> str:
    index = RelabelIndex.of_store(store, settling)
    counts = index.offsets[1:] - index.offsets[:-1]
    return f"{counts.sum()} in {(counts > 0).sum()} of {len(counts)} episodes"
