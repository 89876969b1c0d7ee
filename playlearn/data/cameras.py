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
    way = rendered if store.array(0, "sim.state").shape[1] else "name its own in `policy.encoder`"
    raise UsageError(f"{store.name()} has no images of {', '.join(missing)} (it has: {there}); {way}")
