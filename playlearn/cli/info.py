"""`playlearn info`."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from playlearn.cli.verb import DONE, FAILED, Verb, add_json


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("store", type=Path, metavar="STORE")
    parser.add_argument(
        "--without-images", action="store_true", help="of a LeRobot dataset whose videos were not fetched: its numbers"
    )
    parser.add_argument("--verify", action="store_true", help="read every episode and compare its checksum")
    parser.add_argument(
        "--report",
        type=Path,
        action="append",
        metavar="FILE",
        help="write what was played: a page (.html), its numbers (.json), film strips (.png), a card (.md); repeatable",
    )
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from playlearn.report.cases import cases
    from playlearn.store import LeRobotStoreConfig, open_store

    where = arguments.store
    if arguments.without_images:
        where = LeRobotStoreConfig(root=where, without_images=True)
    store = open_store(where)
    facts = store.info()
    if len(store):
        facts["goals"] = cases(store)
    problems = store.verify() if arguments.verify else []
    if arguments.verify:
        facts = {**facts, "problems": problems}
    if arguments.json:
        print(json.dumps(facts, indent=2))
    else:
        _print_facts({key: value for key, value in facts.items() if key not in ("problems", "remarks", "goals")})
        _print_facts(facts.get("goals", {}))
        for name, remark in facts["remarks"].items():
            print(f"{name}: {remark}")
        if arguments.verify and not problems:
            print(f"whole: every checksum of {len(store)} episodes holds")
    for problem in problems:
        print(f"playlearn: {problem}", file=sys.stderr)
    if arguments.report:
        from playlearn.process_cache import cached_env_of
        from playlearn.report.store_report import write_report

        for path in arguments.report:
            write_report(store, path, lambda: cached_env_of(store))
            print(f"report  {path}", file=sys.stderr)
    return FAILED if problems else DONE


def _print_facts(facts: dict[str, Any]) -> None:
    width = max(map(len, facts), default=0)
    for name, value in facts.items():
        print(f"{name:<{width}}  {value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)}")


VERB = Verb("info", "show what is in a store, and check that it is whole", run, add)
