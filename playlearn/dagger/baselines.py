"""What DAgger is compared with: as many further steps of the collector's play, plain or with noise injected."""

import math
from dataclasses import replace
from pathlib import Path

from playlearn.collection import CollectConfig, collect
from playlearn.collection.store import RESOLVED
from playlearn.config import load_config
from playlearn.dagger.config import DaggerConfig
from playlearn.errors import UsageError
from playlearn.evaluation import SuiteConfig
from playlearn.store import NativeStore, Store


def player(config: DaggerConfig, store: Store, suite: SuiteConfig, cameras: tuple[str, ...]) -> CollectConfig:
    """How the control plays: as the run's own play was made, in the suite's world, seen as the policy sees it.

    Noise is injected as in DART (Laskey et al., 2017): executed noisy, labeled clean.

    Raises:
        UsageError: nobody says how the play was made.
    """
    path = config.collect or Path(store.name()) / RESOLVED
    if not path.is_file():
        raise UsageError(
            f"{store.name()} does not say how it was played (no {RESOLVED}): name a config with `--collect FILE`"
        )
    made = load_config(CollectConfig, path)
    play = made.play.noisier(config.noise) if config.baseline == "noise" else made.play
    return replace(made, environment=suite.environment, cameras=cameras, play=play)


def play_on(config: CollectConfig, steps: int, seed: int, out: Path, workers: int | None) -> int:
    """Play until the store at `out` holds `steps` steps or a little more, from where it stopped. Returns how many."""
    made = replace(config, seed=seed, episodes=math.ceil(steps / config.steps))
    while True:
        collect(made, out, workers=workers, resume=True)
        gathered = int(NativeStore.open(out).lengths().sum())
        if gathered >= steps:
            return gathered
        # some ended early
        made = replace(made, episodes=made.episodes + math.ceil((steps - gathered) / config.steps))
