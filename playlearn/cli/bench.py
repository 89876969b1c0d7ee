"""`playlearn bench`."""

import argparse
import json
from pathlib import Path

from playlearn.cli.verb import DONE, Verb, add_json


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "name",
        nargs="*",
        metavar="NAME",
        help="sim, render, collect, workers, grow, train, threads, data, start (default: all)",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="write compared images here")
    parser.add_argument("--quick", action="store_true", help="seconds instead of minutes; too noisy to quote")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from dataclasses import asdict, replace

    from playlearn.bench import Size
    from playlearn.bench import run as measure

    show = (lambda _: None) if arguments.json else (lambda figure: print(figure.line(), flush=True))
    size = Size(steps=20, rounds=1, episodes=20) if arguments.quick else Size()
    figures = measure(arguments.name, replace(size, out=arguments.out), show)
    if arguments.json:
        print(json.dumps([asdict(figure) for figure in figures], indent=2))
    return DONE


VERB = Verb("bench", "measure speed beside robosuite, LeRobot and the limit, in one run", run, add)
