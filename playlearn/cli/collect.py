"""`playlearn collect`."""

import argparse

from playlearn.cli.verb import DONE, RESUME, Verb, add_config, add_workers, as_overrides, count, index


def add(parser: argparse.ArgumentParser) -> None:
    add_config(parser, "configs/collect/playtable.yaml")
    parser.add_argument("--episodes", type=count, metavar="N", help="number of episodes in all")
    add_workers(parser)
    parser.add_argument("--seed", type=int, metavar="S", help="the same seed gives the same play")
    parser.add_argument("--resume", action="store_true", help="go on with the store in --out, skip finished episodes")
    single = parser.add_mutually_exclusive_group()
    single.add_argument(
        "--episode",
        type=index,
        metavar="N",
        help="play only episode N, in this process, with a traceback if it fails. A new --out becomes a store that "
        "holds only this episode; a store that lacks it gets it; one that has it is left as it is, and compared",
    )
    single.add_argument(
        "--device",
        choices=("keyboard", "spacemouse"),
        help="teleoperate in real time, in this process. Enter or the device's reset keeps an episode, "
        "Backspace discards it, Esc ends the session",
    )
    parser.add_argument(
        "--sensitivity", type=float, default=1.0, metavar="X", help="of the device (default %(default)s)"
    )


def run(arguments: argparse.Namespace) -> int:
    from playlearn.collection import CollectConfig, collect, collect_by_teleoperation, collect_one
    from playlearn.config import load_config

    overrides = as_overrides(arguments, "episodes", "seed") + arguments.overrides
    config = load_config(CollectConfig, arguments.config, overrides)
    if arguments.episode is not None:
        collect_one(config, arguments.out, arguments.episode)
    elif arguments.device is not None:
        collect_by_teleoperation(
            config, arguments.out, arguments.device, arguments.sensitivity, resume=arguments.resume
        )
    else:
        collect(config, arguments.out, workers=arguments.workers, resume=arguments.resume)
    return DONE


VERB = Verb("collect", "record play into a store", run, add, overrides=True, config="collect", kept=RESUME)
