"""`playlearn demo`."""

import argparse
from pathlib import Path

from playlearn.cli.verb import DONE, Verb, as_overrides, count


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--config", type=Path, default=Path("configs/demo.yaml"), metavar="FILE", help="(default %(default)s)"
    )
    parser.add_argument("--out", type=Path, default=Path("runs/demo"), metavar="DIR", help="(default %(default)s)")
    parser.add_argument("--seed", type=int, metavar="S", help="of play and trainings")
    parser.add_argument(
        "--steps", type=count, metavar="N", help="updates of every training, in place of their configs'"
    )


def run(arguments: argparse.Namespace) -> int:
    from playlearn.config import load_config
    from playlearn.demo import DemoConfig, demo

    config = load_config(DemoConfig, arguments.config, as_overrides(arguments, "seed") + arguments.overrides)
    demo(config, arguments.out, steps=arguments.steps)
    return DONE


VERB = Verb(
    "demo",
    "collect play, train on it and reach goal images, in one go; says how long it takes",
    run,
    add,
    overrides=True,
    config="demo",
    kept="; the same command goes on from there",
)
