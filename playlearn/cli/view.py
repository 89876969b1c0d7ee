"""`playlearn view`."""

import argparse
from pathlib import Path

from playlearn.cli.verb import DONE, Verb
from playlearn.errors import UsageError


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("path", type=Path, metavar="STORE|RESULTS")
    parser.add_argument("--episode", type=int, default=0, metavar="I", help="which one, from 0 (default %(default)s)")
    parser.add_argument(
        "--save",
        type=Path,
        metavar="FILE.rrd|FILE.png",
        help="write a file instead of opening a window; .png: the episode's timeline",
    )


def run(arguments: argparse.Namespace) -> int:
    if not arguments.path.exists():
        raise UsageError(f"there is nothing at {arguments.path}; give a store or the --out folder of an evaluation")
    from playlearn.report.view import view_episode, view_results

    if (arguments.path / "results.json").exists():
        view_results(arguments.path, save=arguments.save)
    else:
        view_episode(arguments.path, arguments.episode, save=arguments.save)
    return DONE


VERB = Verb("view", "open an episode or an evaluation in rerun, or write it to a file", run, add)
