"""A person records play with a device: every finished episode is committed before the next one begins."""

import sys
from pathlib import Path

from playlearn.collection.config import CollectConfig, episode_seed
from playlearn.collection.store import begin
from playlearn.errors import PlaylearnError
from playlearn.process_cache import cached_env
from playlearn.rollout import rollout
from playlearn.sim import Environment
from playlearn.teleop.device import DeviceActor, Wish, open_device

HEIGHT = 480  # of the shown image, in pixels


def collect_by_teleoperation(
    config: CollectConfig, out: Path, kind: str, sensitivity: float = 1.0, *, resume: bool = False
) -> None:
    """Let a person record the episodes that are missing, from the start states that a scripted collection would have.

    kind: `keyboard` or `spacemouse`.

    Raises:
        UsageError: there is no screen or no such device here; see also `begin`.
    """
    from playlearn.teleop.window import Window

    environment = cached_env(config.environment)
    height, width, _ = environment.render(environment.spec.cameras[0]).shape
    size = (HEIGHT, round(HEIGHT * width / height))
    with Window(f"playlearn: {out}", *size) as screen:
        actor = DeviceActor(open_device(kind, sensitivity), kind, environment, screen, size=size)
        record_teleoperation(config, out, environment, actor, resume=resume)


def record_teleoperation(
    config: CollectConfig, out: Path, environment: Environment, actor: DeviceActor, *, resume: bool = False
) -> None:
    """The same with the environment, the device and the screen given."""
    store = begin(config, environment, out, resume=resume)
    with store.writer() as writer:
        done = set(store.indices().tolist())
        missing = [index for index in range(config.episodes) if index not in done]
        made = steps = 0
        while missing and actor.wish is not Wish.LEAVE:
            index, seed = missing[0], episode_seed(config.seed, missing[0])
            environment.reset(seed)
            if not actor.ready(f"episode {index}"):
                break
            outcome = rollout(
                [environment],
                actor,
                [None],
                seeds=[seed],
                max_steps=config.steps,
                stop=actor.over,
                cameras=config.cameras,
            )[0]
            if actor.wish is Wish.DISCARD:
                print(f"episode {index}: discarded after {outcome.steps} steps", file=sys.stderr)
                continue
            if outcome.episode is None:
                raise PlaylearnError(f"episode {index} (seed {seed}) ended before its first action: {outcome.ended}")
            writer.append(outcome.episode, missing.pop(0))
            made, steps = made + 1, steps + outcome.steps
            print(f"episode {index}: kept, {outcome.steps} steps, ended: {outcome.ended}", file=sys.stderr)
    fps = environment.spec.fps
    print(f"{made} episodes, {steps} steps ({steps / fps:.0f} s of play); {len(missing)} missing", file=sys.stderr)
