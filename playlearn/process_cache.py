"""What a process keeps from one job to the next because it is slow to build: environments, open stores, notes.

One environment for each config, and clones of it over the same model and renderer where a job needs several. A job
never relies on the state that it finds one in: it begins with `reset` or `set_state`.
"""

import functools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from playlearn.config import from_dict, to_dict
from playlearn.sim.environment import Environment, EnvironmentConfig
from playlearn.store import Store, open_store


def cached_envs(config: EnvironmentConfig, count: int) -> list[Environment]:
    """`count` environments of a config, in whatever states they were left."""
    envs = _envs(json.dumps(to_dict(config), sort_keys=True))
    if len(envs) < count:
        envs[0].reset(0)  # a clone starts in its state, which may be that of a diverged simulation
        envs += [envs[0].clone() for _ in range(count - len(envs))]
    return envs[:count]


def cached_env(config: EnvironmentConfig) -> Environment:
    """The first environment of a config, in whatever state it was left."""
    return cached_envs(config, 1)[0]


def cached_env_of(store: Store) -> Environment:
    """The environment that a store was recorded in."""
    import playlearn.envs  # noqa: F401 - registers the kinds; here, since it imports every simulator

    return cached_env(from_dict(EnvironmentConfig, dict(store.spec.environment)))


def forget_envs() -> None:
    """Build anew what is asked for next: an error may have left an environment in the middle of something."""
    _envs.cache_clear()


@functools.cache
def cached_store(path: str) -> Store:
    """The store in a folder, opened once."""
    return open_store(path)


@functools.cache
def cached_note(path: str) -> Mapping[str, Any]:
    """What a JSON file says that is never changed, such as the record of `store.folder.claim`."""
    note: Mapping[str, Any] = json.loads(Path(path).read_text(encoding="utf-8"))
    return note


@functools.cache
def _envs(config: str) -> list[Environment]:
    return [from_dict(EnvironmentConfig, json.loads(config)).build()]
