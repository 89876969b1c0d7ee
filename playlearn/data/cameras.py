"""Whether a store has the images that are asked for."""

from collections.abc import Sequence

from playlearn.errors import UsageError
from playlearn.store import Store


def check_cameras(store: Store, wanted: Sequence[str]) -> None:
    """Raises UsageError where the store lacks a camera; the message says how to come by its images."""
    has = store.cameras()
    missing = [camera for camera in dict.fromkeys(wanted) if camera not in has]
    if not missing:
        return
    there = ", ".join(f"{camera} {h}x{w}" for camera, (h, w) in has.items()) or "none"
    options = " ".join(f"--camera {camera}=64x64" for camera in missing)
    rendered = f"`playlearn render {store.name()} OUT {options}` draws them from its simulator states"
    named = f"--policy.encoder.cameras '[{', '.join(has)}]' --policy.encoder.goal_camera {next(iter(has), '')}"
    own = f"name its own: `{named}`" if has else "read its numbers alone, as configs/train/lerobot.yaml does"
    left = {key: why for key, why in store.remarks().items() if any(key.endswith(camera) for camera in missing)}
    own = "; ".join([*(f"{key} is {why}" for key, why in left.items()), own])
    way = rendered if store.array(0, "sim.state").shape[1] else own
    raise UsageError(f"{store.name()} has no images of {', '.join(missing)} (it has: {there}); {way}")
