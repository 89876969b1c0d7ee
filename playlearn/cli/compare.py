"""`playlearn compare`."""

import argparse
import json

from playlearn.cli.verb import DONE, REPEAT, Verb, add_config, add_json, add_workers
from playlearn.threads import limit


def add(parser: argparse.ArgumentParser) -> None:
    add_config(parser, "configs/compare/NAME.yaml")
    add_workers(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from playlearn.config import load_config
    from playlearn.experiments.compare import CompareConfig, compare
    from playlearn.report.compared import table

    limit()
    config = load_config(CompareConfig, arguments.config, arguments.overrides)
    rows = compare(config, arguments.out, workers=arguments.workers)
    print(json.dumps(rows, indent=2) if arguments.json else table(rows), end="\n" if arguments.json else "")
    return DONE


VERB = Verb(
    "compare",
    "train variants of a config on the same play and evaluate them on the same episodes",
    run,
    add,
    overrides=True,
    config="compare",
    kept=REPEAT,
)
