"""`playlearn eval`."""

import argparse
import json
from pathlib import Path

from playlearn.cli.verb import DONE, Verb, add_suite
from playlearn.threads import limit


def add(parser: argparse.ArgumentParser) -> None:
    who = parser.add_mutually_exclusive_group(required=True)
    who.add_argument("--run", type=Path, metavar="RUN", help="the folder of a training run")
    who.add_argument("--policy", choices=("expert", "random"), help="a baseline instead of a trained policy")
    add_suite(parser, "results.json and report.html")
    parser.add_argument(
        "--encoder", type=Path, metavar="RUN", help="run a state policy behind the image encoder of this run"
    )
    parser.add_argument("--no-baselines", action="store_true", help="without the expert and the random policy")


def run(arguments: argparse.Namespace) -> int:
    from playlearn.evaluation import evaluate
    from playlearn.privileges import KEY, Privileges

    limit()  # of what that has imported, too
    results = evaluate(
        arguments.suite,
        run=arguments.run,
        encoder=arguments.encoder,
        policy=arguments.policy,
        goal=arguments.goal,
        out=arguments.out,
        episodes=arguments.episodes,
        workers=arguments.workers,
        seed=arguments.seed,
        references=not arguments.no_baselines,
        overrides=arguments.overrides,
    )
    if arguments.json:
        print(json.dumps(results, indent=2))
    else:
        for name, rates in ((results["policy"]["name"], results), *results["references"].items()):
            low, high = rates["ci95"]
            success = f"{rates['success_rate']:6.1%}  [{low:.1%}, {high:.1%}] of {rates['episodes']} episodes"
            print(f"{name:<10} {success}; privileged: {Privileges.from_dict(rates[KEY])}")
        print(f"report     {arguments.out / 'report.html'}")
    return DONE


VERB = Verb(
    "eval", "evaluate a policy on the goals of a suite and write a report", run, add, overrides=True, config="suite"
)
