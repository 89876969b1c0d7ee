"""`playlearn dagger`."""

import argparse
import json
from pathlib import Path

from playlearn.cli.verb import DONE, RESUME, Verb, add_config, add_json, add_workers
from playlearn.threads import limit


def add(parser: argparse.ArgumentParser) -> None:
    add_config(parser, "configs/dagger/NAME.yaml")
    parser.add_argument("--run", type=Path, required=True, metavar="RUN", help="the training run to begin with")
    add_workers(parser)
    parser.add_argument("--resume", action="store_true", help="go on with the rounds in --out, skip finished ones")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from playlearn.config import load_config
    from playlearn.dagger import DaggerConfig, dagger
    from playlearn.dagger.results import line

    limit()
    config = load_config(DaggerConfig, arguments.config, arguments.overrides)
    results = dagger(config, arguments.run, arguments.out, workers=arguments.workers, resume=arguments.resume)
    if arguments.json:
        print(json.dumps(results, indent=2))
    else:
        for row in results["rounds"]:
            print(line(row))
        print(f"plot  {arguments.out / 'plot.png'}")
    return DONE


VERB = Verb(
    "dagger",
    "improve a policy in rounds of DAgger: rollouts that the expert labels, then training on them",
    run,
    add,
    overrides=True,
    config="dagger",
    kept=RESUME,
)
