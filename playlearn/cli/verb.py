"""What a command is made of, and the arguments that several commands share."""

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

DONE, FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130

# Said after "interrupted" by a command that keeps what was finished.
RESUME = "; what was finished is kept, and the same command with --resume goes on from there"
REPEAT = "; what was finished is kept, and the same command goes on from there"


@dataclass(frozen=True)
class Verb:
    """One command.

    name: as it is typed.
    help: one line, without a capital and a full stop.
    run: does what the arguments say and returns an exit code; imports what it needs, so that `--help` stays quick.
    add: adds the command's own arguments to its parser.
    overrides: whether fields of a config may follow as `--field value`.
    config: the name under which `playlearn config` prints those fields; empty where it does not.
    kept: what is said after "interrupted".
    """

    name: str
    help: str
    run: Callable[[argparse.Namespace], int]
    add: Callable[[argparse.ArgumentParser], None]
    overrides: bool = False
    config: str = ""
    kept: str = ""

    @property
    def epilog(self) -> str | None:
        """What `--help` says of the fields that it does not list."""
        if not self.overrides:
            return None
        text = "Any field of the config can be set: `--field value`, `--block.field value`. "
        text += "A path is looked for from the working directory; in a file, `./` and `../` from the file's own folder."
        if self.config:
            text += f" `playlearn config {self.config}` prints every field with its default, choices and meaning."
        return text


def as_overrides(arguments: argparse.Namespace, *names: str) -> list[str]:
    """Options that are a config's own fields, as overrides; those not given are left out."""
    given = {name: getattr(arguments, name) for name in names}
    return [f"--{name}={json.dumps(value)}" for name, value in given.items() if value is not None]


def add_config(parser: argparse.ArgumentParser, example: str) -> None:
    parser.add_argument("--config", type=Path, required=True, metavar="FILE", help=example)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="the folder to write")


def add_suite(parser: argparse.ArgumentParser, files: str) -> None:
    """What a policy is evaluated on; `files`: what is written."""
    parser.add_argument("--suite", type=Path, required=True, metavar="FILE", help="eval/suites/NAME.yaml")
    parser.add_argument("--goal", choices=("image", "state"), required=True, help="how the goal is shown")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help=f"{files} are written here")
    parser.add_argument("--episodes", type=count, metavar="N", help="episodes in all, instead of the suite's own")
    add_workers(parser)
    parser.add_argument("--seed", type=int, metavar="S", help="instead of the suite's own")
    add_json(parser)


def add_workers(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--workers", type=_workers, metavar="W", help="processes (default: one a core; 0: none but this one)"
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print JSON, for a program to read")


def count(text: str) -> int:
    """A whole number of 1 or more."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be 1 or more, not {text}")
    return number


def index(text: str) -> int:
    """A whole number of 0 or more."""
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"must be 0 or more, not {text}")
    return number


def _workers(text: str) -> int:
    return 0 if text == "0" else count(text)
