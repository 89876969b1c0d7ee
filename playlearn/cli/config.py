"""`playlearn config`."""

import argparse
import json
from pathlib import Path
from typing import Any

from playlearn.api.configs import CONFIGS, ConfigName, config_class
from playlearn.cli.verb import DONE, Verb

# Values of the fields that have no default, so that there is something to print; a user replaces them.
EXAMPLES: dict[str, dict[str, Any]] = {
    "suite": {"name": "NAME", "environment.type": "playtable", "kind.type": "tasks"},
    "compare": {
        "base": "configs/train/NAME.yaml",
        "suite": "eval/suites/NAME.yaml",
        "variants": {"small": {"policy.trunk.layers": 2}, "large": {"policy.trunk.layers": 4}},
    },
}
_GIVEN_TO = {
    "collect": "playlearn collect --config FILE",
    "train": "playlearn train --config FILE",
    "suite": "playlearn eval --suite FILE",
    "dagger": "playlearn dagger --config FILE",
    "compare": "playlearn compare --config FILE",
    "demo": "playlearn demo --config FILE",
}


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", choices=CONFIGS, help="whose config")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="print this file completed, instead of the defaults"
    )
    parser.epilog = (
        "Fields that are given as `--field value` are printed with that value, and blocks of another type with the "
        "fields of that type: `playlearn config train --policy.head.type flow --data.goals.ahead 2 > my.yaml`."
    )


def run(arguments: argparse.Namespace) -> int:
    from playlearn.config.reference import describe

    text = describe(load(arguments.name, arguments.config, arguments.overrides))
    print(f"{_header(arguments.name)}\n{text}", end="")
    return DONE


def load(name: ConfigName, path: Path | None = None, overrides: list[str] | None = None) -> Any:
    """The config of that name: a file's, or the defaults, with examples where a field has none."""
    from playlearn.config import load_config

    examples = [f"--{field}={json.dumps(value)}" for field, value in EXAMPLES.get(name, {}).items()]
    return load_config(config_class(name), path, (examples if path is None else []) + (overrides or []))


def _header(name: str) -> str:
    return (
        f"# Every field, its value, type and meaning. Save this, edit it, and use it: {_GIVEN_TO[name]}\n"
        f"# Another type of a block has other fields; print them: playlearn config {name} --BLOCK.type TYPE\n"
    )


VERB = Verb("config", "print every field of a config with default, type, choices and meaning", run, add, overrides=True)
