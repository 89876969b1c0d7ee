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
        help="sim, render, collect, workers, grow, train, threads, data, start (default: all of these), settled",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="write compared images here")
    parser.add_argument("--store", type=Path, metavar="STORE", help="settled: play that records `achieved`")
    parser.add_argument("--cameras", nargs="+", default=(), metavar="CAMERA", help="settled: those that stand still")
    parser.add_argument("--picture", type=Path, metavar="FILE.png", help="settled: draw what it missed")
    parser.add_argument("--quick", action="store_true", help="seconds instead of minutes; too noisy to quote")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from dataclasses import asdict, replace

    from playlearn.bench import Size
    from playlearn.bench import run as measure

    show = (lambda _: None) if arguments.json else (lambda figure: print(figure.line(), flush=True))
    size = Size(steps=20, rounds=1, episodes=20) if arguments.quick else Size()
    size = replace(
        size,
        out=arguments.out,
        store=arguments.store,
        cameras=tuple(arguments.cameras),
        picture=arguments.picture,
    )
    if "settled" in arguments.name:
        from playlearn.bench.settled import checked

        checked(size)
    figures = measure(arguments.name, size, show)
    if arguments.json:
        print(json.dumps([asdict(figure) for figure in figures], indent=2))
    return DONE


VERB = Verb("bench", "measure speed beside robosuite, LeRobot and the limit, in one run", run, add)
