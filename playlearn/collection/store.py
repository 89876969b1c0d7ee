"""The store that a collection goes into."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from playlearn.collection.config import CollectConfig
from playlearn.config import RunFolder, atomic_write, from_dict, git_revision, save_config, to_dict, versions
from playlearn.errors import StoreError, UsageError
from playlearn.sim import Environment
from playlearn.store import NativeStore, StoreSpec

NOTE = "collect.json"  # what decided the episodes, beside store.json
RESOLVED = "collect.yaml"  # the whole config, for another `playlearn collect --config`


def begin(config: CollectConfig, environment: Environment, out: Path, *, resume: bool) -> NativeStore:
    """The store at `out`: an empty one, or with `resume` what is there if the same settings made it.

    Raises:
        UsageError: it was begun with other settings, or an unknown camera was asked for.
        StoreError: there is something already and `resume` was not asked for, or it cannot be read.
    """
    unknown = sorted(set(config.cameras) - set(environment.spec.cameras))
    if unknown:
        raise UsageError(f"cameras: {unknown[0]!r} is not one of {', '.join(environment.spec.cameras)}")
    if config.cameras:
        environment.renderer()  # without OpenGL this fails now, not in a worker
    if resume and (out / "store.json").exists():
        _check_same(config, out)
        return NativeStore.open(out)
    note = {"config": config.settings(), "versions": versions(), "git_revision": git_revision()}
    text = json.dumps(note, indent=2).encode()
    notes = {
        NOTE: lambda path: atomic_write(path, text),
        RESOLVED: lambda path: save_config(config, path),
    }
    return NativeStore.create(out, store_spec(environment, config.cameras), notes)


def store_spec(environment: Environment, cameras: Sequence[str] = ()) -> StoreSpec:
    """The spec of a store for episodes of this environment, with images of these cameras."""
    spec, images = environment.spec, environment.observe(cameras).images
    return StoreSpec(
        environment=to_dict(environment.config),
        state_names=spec.state_names,
        achieved_names=spec.achieved_names,
        action_names=spec.action_names,
        fps=spec.fps,
        quantities=spec.quantities,
        cameras={name: (int(image.shape[0]), int(image.shape[1])) for name, image in images.items()},
    )


def _check_same(config: CollectConfig, out: Path) -> None:
    folder = RunFolder(out, NOTE, "store made by `playlearn collect`")
    folder.begun()
    try:
        note = json.loads(folder.file.read_text())
        before, packages = from_dict(CollectConfig, note["config"]).settings(), dict(note["versions"])
    except (OSError, ValueError, KeyError, TypeError, UsageError) as error:
        raise StoreError(
            f"{folder.file} cannot be read ({error}): put it back as it was, or give another --out"
        ) from error
    folder.check_same(before, config.settings())
    newer = {name: new for name, new in versions().items() if packages.get(name, new) != new}
    for name, new in newer.items():
        print(
            f"{out} was begun with {name} {packages[name]}, and this is {new}: "
            "new episodes may differ from those of an unbroken run",
            file=sys.stderr,
        )
