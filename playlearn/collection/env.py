"""One world for each process, built when it is first needed, and the store that its episodes go into."""

import functools
import json
import sys
from pathlib import Path
from typing import Any

from playlearn.collection.config import CollectConfig
from playlearn.config import RunFolder, atomic_write, from_dict, git_revision, save_config, to_dict, versions
from playlearn.errors import StoreError, UsageError
from playlearn.sim import Environment, EnvironmentConfig
from playlearn.store import NativeStore, StoreSpec

NOTE = "collect.json"  # what decided the episodes, beside store.json
RESOLVED = "collect.yaml"  # the whole config, for another `playlearn collect --config`


def env(config: EnvironmentConfig) -> Environment:
    """The environment of that kind that this process has, in whatever state it was left."""
    return _env(json.dumps(kind(config)))


def forget_envs() -> None:
    """Build anew what is asked for next: the one there is may have been left in the middle of something."""
    _env.cache_clear()


def kind(config: EnvironmentConfig) -> dict[str, Any]:
    """The config as JSON, with its `type`."""
    return {"type": config.get_choice_name(type(config)), **to_dict(config)}


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
        environment.renderer()  # no OpenGL is said now, not in a worker
    if resume and (out / "store.json").exists():
        _check_same(config, out)
        return NativeStore.open(out)
    seen = environment.observe(config.cameras).images
    spec = StoreSpec(
        environment=kind(config.environment),
        state_names=environment.spec.state_names,
        achieved_names=environment.spec.achieved_names,
        action_names=environment.spec.action_names,
        fps=environment.spec.fps,
        cameras={name: (int(image.shape[0]), int(image.shape[1])) for name, image in seen.items()},
    )
    note = {"config": config.settings(), "versions": versions(), "git_revision": git_revision()}
    text = json.dumps(note, indent=2).encode()
    notes = {
        NOTE: lambda path: atomic_write(path, text),
        RESOLVED: lambda path: save_config(config, path),
    }
    return NativeStore.create(out, spec, notes)


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


@functools.cache
def _env(config: str) -> Environment:
    return from_dict(EnvironmentConfig, json.loads(config)).build()
