"""`playlearn train`."""

import argparse

from playlearn.cli.verb import DONE, RESUME, Verb, add_config, as_overrides


def add(parser: argparse.ArgumentParser) -> None:
    add_config(parser, "configs/train/NAME.yaml")
    parser.add_argument("--store", metavar="STORE", help="train on another store than the config names")
    parser.add_argument("--resume", action="store_true", help="go on from the last checkpoint in --out")


def run(arguments: argparse.Namespace) -> int:
    from playlearn.config import load_config
    from playlearn.training import TrainConfig, train

    overrides = as_overrides(arguments, "store") + arguments.overrides
    train(load_config(TrainConfig, arguments.config, overrides), arguments.out, resume=arguments.resume)
    return DONE


VERB = Verb("train", "train a policy on a store of play", run, add, overrides=True, config="train", kept=RESUME)
