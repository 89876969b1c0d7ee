"""`playlearn import`."""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from playlearn.cli.verb import DONE, REPEAT, Verb
from playlearn.errors import UsageError


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("format", choices=tuple(FORMATS), help=FIELDS)
    parser.add_argument("source", type=Path, metavar="SRC", help="a dataset's folder, .hdf5 or .npz")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--skip-broken", action="store_true", help="leave broken recordings out, and name them")


def run(arguments: argparse.Namespace) -> int:
    from playlearn.report.progress import Progress
    from playlearn.store.importing import import_recordings

    recordings = FORMATS[arguments.format](arguments.source, arguments.overrides)
    with Progress(f"import {arguments.out}", len(recordings.names()), "recording") as progress:
        skip = arguments.skip_broken
        store = import_recordings(recordings, arguments.out, skip_broken=skip, progress=progress.to, say=progress.say)
    print(f"{arguments.out}: {len(store)} episodes, {int(store.lengths().sum())} steps")
    here = set(store.indices().tolist())
    for name, numbers in recordings.splits.items():
        print(f"mask {name}: {len(here & set(numbers))} of its {len(numbers)} episodes")
    success = store.info()["success"]
    print("success: " + ", ".join(f"{what} {count}" for what, count in success.items()))
    rewarded = any(store.rewards(i) is not None for i in range(len(store)))
    if success["unknown"] and rewarded and "success" in recordings.note:
        print("a reward is not a success: say which episodes succeeded by --success, such as 'last_reward>=0' or all")
    return DONE


def _robomimic(source: Path, overrides: list[str]) -> Any:
    from playlearn.config import load_config
    from playlearn.store.robomimic import RobomimicConfig

    return load_config(RobomimicConfig, None, overrides).build(source)


def _robosuite(source: Path, overrides: list[str]) -> Any:
    from playlearn.config import load_config
    from playlearn.store.robosuite_demos import RobosuiteConfig

    return load_config(RobosuiteConfig, None, overrides).build(source)


def _ogbench(source: Path, overrides: list[str]) -> Any:
    from playlearn.store.ogbench import OgbenchFile

    if overrides:
        raise UsageError(f"unknown argument {overrides[0]}")
    return OgbenchFile(source)


def _lerobot(source: Path, overrides: list[str]) -> Any:
    from playlearn.config import load_config, to_dict
    from playlearn.store.lerobot.config import LeRobotStoreConfig
    from playlearn.store.lerobot.recordings import LeRobotRecordings

    config = load_config(LeRobotStoreConfig, None, [f"--root={json.dumps(str(source))}", *overrides])
    elsewhere = ("root", "cache", "skip_broken")  # of no bearing on what is read
    settings = {name: value for name, value in to_dict(config).items() if name not in elsewhere}
    return LeRobotRecordings(replace(config, skip_broken=True).build(), settings)


FORMATS = {"lerobot": _lerobot, "robomimic": _robomimic, "robosuite": _robosuite, "ogbench": _ogbench}

FIELDS = (
    "fields of robomimic: --state, --achieved, --goal_names (what goals are about), --success (which succeeded: "
    "'last_reward>=0', all ...), --cameras, --mask, --val_mask, --fps; of robosuite: --goal_names, --success, --mask, "
    "--fps; of lerobot: those of `store: {type: lerobot}`"
)

VERB = Verb("import", "convert recordings of other formats into a store", run, add, overrides=True, kept=REPEAT)
