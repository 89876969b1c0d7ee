"""`playlearn toy`."""

import argparse
import sys

from playlearn.cli.verb import DONE, Verb, add_config


def add(parser: argparse.ArgumentParser) -> None:
    add_config(parser, "configs/toy/NAME.yaml")


def run(arguments: argparse.Namespace) -> int:
    from playlearn.experiments.toy import load_experiment
    from playlearn.experiments.toy import run as measure

    experiment = load_experiment(arguments.config, arguments.overrides)
    rows = measure(experiment, arguments.out, lambda line: print(line, file=sys.stderr, flush=True))
    for row in rows:
        print("  ".join(f"{name} {value}" for name, value in row.items() if not isinstance(value, list)))
    print(f"plot  {arguments.out / 'plot.png'}")
    return DONE


VERB = Verb("toy", "run a small experiment and plot its results", run, add, overrides=True)
