"""`playlearn diagnose`."""

import argparse
import json
from pathlib import Path

from playlearn.cli.verb import DONE, Verb, add_suite
from playlearn.threads import limit


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--run", type=Path, required=True, metavar="RUN", help="the folder of a training run")
    add_suite(parser, "diagnosis.json and diagnosis.html")


def run(arguments: argparse.Namespace) -> int:
    from playlearn.evaluation.diagnosis import diagnose, format_summary

    limit()
    results = diagnose(
        arguments.run,
        arguments.suite,
        arguments.out,
        goal=arguments.goal,
        episodes=arguments.episodes,
        workers=arguments.workers,
        seed=arguments.seed,
        overrides=arguments.overrides,
    )
    print(json.dumps(results, indent=2) if arguments.json else format_summary(results))
    if not arguments.json:
        print(f"report     {arguments.out / 'diagnosis.html'}")
    return DONE


VERB = Verb(
    "diagnose", "classify how a policy fails on a suite, with pictures", run, add, overrides=True, config="suite"
)
