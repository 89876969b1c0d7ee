"""`playlearn export`."""

import argparse
from pathlib import Path

from playlearn.cli.verb import DONE, Verb
from playlearn.errors import UsageError


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("format", choices=tuple(FORMATS), help="a store for LeRobot or robomimic; a run's policy")
    parser.add_argument("source", type=Path, metavar="STORE|RUN")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument(
        "--videos",
        nargs="?",
        const="av1",
        choices=("av1", "h264"),
        help="encode the cameras as video (default av1) instead of images",
    )
    parser.add_argument(
        "--goals",
        nargs="?",
        const="settled",
        metavar="SAMPLER",
        help="relabel: each window of play becomes an episode that carries its goal, drawn by a sampler (default "
        "settled; its fields are set as `--goals.ahead 2`)",
    )
    parser.add_argument(
        "--subtasks",
        action="store_true",
        help="skills as LeRobot's subtask annotation (`language_persistent`), which its viewer cannot show yet",
    )
    parser.add_argument("--push", metavar="USER/NAME", help="upload the dataset to the Hub under this name")
    parser.add_argument("--private", action="store_true", help="with --push: visible to you only")


def run(arguments: argparse.Namespace) -> int:
    if arguments.format != "lerobot":
        given = [f"--{name}" for name in ("videos", "goals", "subtasks", "push", "private") if getattr(arguments, name)]
        if given or arguments.overrides:
            raise UsageError(f"`export {arguments.format}` does not take {(given + arguments.overrides)[0]}")
    return FORMATS[arguments.format](arguments)


def _policy(arguments: argparse.Namespace) -> int:
    from playlearn.lerobot.publish import export_policy

    inputs = export_policy(arguments.source, arguments.out)
    command = f"lerobot-eval --policy.path={arguments.out} --env.type=playlearn --env.suite=eval/suites/NAME.yaml"
    print(f"{arguments.out}: a policy for LeRobot, which reads {', '.join(inputs)}")
    print(f"try `{command}`, or an environment of your own that gives these")
    return DONE


def _lerobot(arguments: argparse.Namespace) -> int:
    from playlearn.config import load_config
    from playlearn.lerobot.goals import RelabelConfig
    from playlearn.lerobot.share import contents, push, share
    from playlearn.report.progress import Progress
    from playlearn.store import open_store
    from playlearn.store.lerobot.metadata import is_lerobot

    kind = [] if arguments.goals is None else [f"--goals.type={arguments.goals}"]
    if arguments.overrides and not kind:
        raise UsageError(f"unknown argument {arguments.overrides[0]}; fields of a goal sampler need --goals")
    goals = load_config(RelabelConfig, None, kind + arguments.overrides) if kind else None
    if not (arguments.push and is_lerobot(arguments.out)):
        content = contents(open_store(arguments.source), goals, subtasks=arguments.subtasks)
        with Progress(f"export {arguments.out}", len(content), "episode") as progress:
            fidelity = share(content, arguments.out, arguments.videos, lambda done, _: progress.to(done))
        for camera, read in fidelity.items():
            print(f"{camera}: {read}")
        print(f"{arguments.out}: LeRobot v3.0, {len(content)} episodes")
    if arguments.push:
        print(push(arguments.out, arguments.push, private=arguments.private))
    return DONE


def _robomimic(arguments: argparse.Namespace) -> int:
    from playlearn.data import DataConfig
    from playlearn.data.split import val_mask
    from playlearn.report.progress import Progress
    from playlearn.store import open_store
    from playlearn.store.robomimic_export import export_robomimic

    store = open_store(arguments.source)
    val, numbers = val_mask(store, DataConfig().val_fraction), store.indices()
    masks = {"train": numbers[~val].tolist(), "valid": numbers[val].tolist()}
    with Progress(f"export {arguments.out}", len(store), "episode") as progress:
        export_robomimic(store, arguments.out, masks, progress.to)
    print(f"{arguments.out}: robomimic's HDF5, {len(store)} episodes, {len(masks['valid'])} of them under mask valid")
    return DONE


FORMATS = {"lerobot": _lerobot, "robomimic": _robomimic, "policy": _policy}

VERB = Verb("export", "write a store, or a run's policy, in a format that others read", run, add, overrides=True)
