"""What a LeRobot dataset's features are, by their description in `info.json`: color cameras, vectors of numbers."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.episode import IMAGES
from playlearn.errors import StoreError

PICTURES = ("image", "video")
DEPTH = ("is_depth_map", "video.is_depth_map")
CHANNELS = ("channel", "channels", "rgb", "c")  # what `names` calls the axis of colors

type Shape = tuple[int, ...]
type Size = tuple[int, int]  # (height, width)


@dataclass(frozen=True)
class Camera:
    """A camera of the dataset.

    key: name of the feature.
    size: (height, width).
    video: frames are in a video file, not in the parquet file.
    """

    key: str
    size: Size
    video: bool


def check_features(path: Path, features: Any) -> dict[str, Mapping[str, Any]]:
    """The features of `info.json`, which is at `path`; raises StoreError where one has no dtype or no shape."""
    if not isinstance(features, Mapping):
        raise StoreError(f"{path}: `features` must map names to what they are, not {features!r:.60}")
    for key, feature in features.items():
        if not isinstance(feature, Mapping) or not isinstance(feature.get("dtype"), str):
            raise StoreError(f"{path}: the feature {key!r} has no dtype")
        sizes = feature.get("shape")
        if not isinstance(sizes, list) or not all(type(size) is int and size >= 0 for size in sizes):
            raise StoreError(f"{path}: the feature {key!r} has no shape, a list of whole numbers, but {sizes!r:.60}")
    return dict(features)


def read_cameras(features: Mapping[str, Any]) -> tuple[dict[str, Camera], dict[str, str]]:
    """The color cameras by their name, all different; and feature -> why it is left out, or called otherwise."""
    pictures = {key: feature for key, feature in features.items() if feature["dtype"] in PICTURES}
    cameras, remarks = {}, {}
    for key, feature in pictures.items():
        size, reason = _image_size(feature)
        if size is None:
            remarks[key] = f"left out: {reason}; color images (height, width, 3) are read"
        else:
            cameras[key] = Camera(key, size, feature["dtype"] == "video")
    short = {key: key.removeprefix(IMAGES).removeprefix("observation.") for key in cameras}
    counts = Counter(short.values())
    names = {key: name if counts[name] == 1 else key for key, name in short.items()}
    if len(set(names.values())) < len(names):
        names = {key: key for key in names}
    for key, name in names.items():
        if counts[short[key]] > 1:
            remarks[key] = f"called {name!r}, in full: the dataset has {counts[short[key]]} cameras {short[key]!r}"
    return {names[key]: camera for key, camera in cameras.items()}, remarks


def vector_size(key: str, feature: Mapping[str, Any]) -> int:
    """How many numbers a feature has at each frame; raises StoreError where it is not a vector of them."""
    dtype, shape = feature["dtype"], tuple(feature["shape"])
    if not is_numeric(dtype):
        raise StoreError(f"{key} is of {dtype}, and a vector of numbers is read")
    if len(shape) > 1:
        raise StoreError(f"{key} has the shape {shape}, and a vector (n,) is read: flatten it in a copy of the dataset")
    size = int(np.prod(shape, dtype=int))
    if not size:
        raise StoreError(f"{key} has the shape {shape}: it holds no numbers")
    return size


def is_numeric(dtype: str) -> bool:
    """Whether a feature's dtype is one of real numbers or truth values."""
    try:
        return np.dtype(dtype).kind in "biuf"
    except (TypeError, ValueError):
        return False


def _image_size(feature: Mapping[str, Any]) -> tuple[Size | None, str]:
    """(height, width) of a color camera; or None, and what it is instead."""
    shape = tuple(feature["shape"])
    details = [feature.get(where) for where in ("info", "video_info")]
    if any(own.get(mark) for own in details if isinstance(own, Mapping) for mark in DEPTH):
        return None, "a depth map"
    if len(shape) != 3 or not all(shape):
        return None, f"its shape {shape} is not that of an image"
    axis = _channel_axis(shape, feature.get("names"))
    if shape[axis] != 3:
        return None, f"it has {shape[axis]} channels" if shape[axis] > 1 else "it has one channel"
    height, width = (size for k, size in enumerate(shape) if k != axis)
    return (height, width), ""


def _channel_axis(shape: Shape, names: Any) -> int:
    """0 or 2: where the colors are, as `names` says if that can be, else by the sizes."""
    if isinstance(names, list) and len(names) == 3:
        named = [k for k in (0, 2) if str(names[k]).lower() in CHANNELS and shape[k] <= 4]
        if named:
            return named[0]
    return 0 if shape[2] > 4 and shape[0] <= 4 else 2
