"""Which feature of a LeRobot dataset is which part of an episode, and what is left out, with the reason."""

from playlearn.errors import StoreError
from playlearn.store.lerobot.content import ACHIEVED, INTERVENTION, NEXT_REWARD, SUCCESS
from playlearn.store.lerobot.features import PICTURES, is_numeric, vector_size
from playlearn.store.lerobot.files import INFO, column_types
from playlearn.store.lerobot.metadata import DatasetMetadata

VECTORS = ("state", "achieved", "action")
OUTCOMES = {"success": SUCCESS, "reward": NEXT_REWARD, "done": "next.done"}
SINGLE = {"intervention": INTERVENTION, **OUTCOMES}  # read if they are one number a frame
TASK = "task_index"
BOOKKEEPING = ("timestamp", "frame_index", "episode_index", "index", TASK)
TEXTS = ("string", "language")


def read_features(metadata: DatasetMetadata, state: str, achieved: str, action: str) -> dict[str, str]:
    """Part -> feature, for the parts that the dataset has.

    Raises:
        StoreError: it has no state or no action, or they are not vectors of numbers.
    """
    features, where = metadata.features, metadata.root / INFO
    wanted = {"state": state, "achieved": achieved, "action": action}
    if action in (state, achieved):
        given = "state" if action == state else "achieved"
        raise StoreError(
            f"{where}: {action!r} is named as `action` and as `{given}`: a policy would be shown what it is to "
            f"predict; name another feature as `{given}`"
        )
    vectors = [key for key, one in features.items() if is_numeric(one["dtype"]) and key not in BOOKKEEPING]
    found = {}
    for part, key in wanted.items():
        if key not in features:
            if part == "achieved" and key in ("", ACHIEVED):
                continue  # the default, which a robot without sensors of objects does not have
            taken = state if part == "action" else action
            known = ", ".join(other for other in vectors if other != taken)
            does = f"it has {known}: set `{part}` to one of them (one is read: join several in a copy of the dataset)"
            raise StoreError(
                f"{metadata.root} has no feature {key!r} for the {part}; "
                + (does if known else "it has no other vector of numbers, so that it cannot be learned from")
            )
        try:
            vector_size(key, features[key])
        except StoreError as error:
            others = ", ".join(other for other in vectors if other != key)
            raise StoreError(f"{where}: {error}; or set `{part}` to another feature ({others})") from error
        found[part] = key
    found |= {part: key for part, key in SINGLE.items() if key in features and _is_single(metadata, key)}
    return found | ({"task": TASK} if TASK in features and metadata.tasks else {})


def left_out(metadata: DatasetMetadata, read: set[str]) -> dict[str, str]:
    """Feature or column -> why it is left out, of all but the cameras and what is `read`."""
    found = {}
    for key, feature in metadata.features.items():
        dtype, shape = feature["dtype"], tuple(feature["shape"])
        if key in read or key in BOOKKEEPING or dtype in PICTURES:
            continue
        if dtype in TEXTS:
            found[key] = "left out: no text is read but that of tasks"
        elif not is_numeric(dtype):
            found[key] = f"left out: its dtype {dtype!r} is not known"
        elif len(shape) > 1:
            found[key] = f"left out: numbers of the shape {shape}; vectors are read, and images of dtype image or video"
        else:
            found[key] = "left out: none of `state`, `achieved` and `action` in the `store` block names it"
    if TASK in metadata.features and not metadata.tasks:
        found[TASK] = "left out: the dataset has no texts of tasks"
    places = sorted({row.data for row in metadata.rows})
    columns = column_types(metadata.root / places[0]) if places else {}
    return found | {
        key: f"left out: a column of {places[0]} that {INFO} does not describe"
        for key in columns
        if key not in metadata.features and key not in BOOKKEEPING
    }


def _is_single(metadata: DatasetMetadata, key: str) -> bool:
    feature = metadata.features[key]
    return is_numeric(feature["dtype"]) and tuple(feature["shape"]) in ((), (1,))
