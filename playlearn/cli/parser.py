"""The command line: one file of this folder for each command."""

import argparse
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from playlearn import __version__
from playlearn.cli import (
    bench,
    collect,
    compare,
    completion,
    config,
    dagger,
    demo,
    diagnose,
    doctor,
    evaluate,
    export,
    import_recordings,
    info,
    render,
    toy,
    train,
    view,
)
from playlearn.cli.verb import USAGE, Verb

MODULES = (
    collect,
    info,
    render,
    view,
    train,
    evaluate,
    dagger,
    demo,
    diagnose,
    export,
    import_recordings,
    toy,
    compare,
    bench,
    config,
    completion,
    doctor,
)


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """With `command`, `kept`, `overrides` and `parsers`; exits where the arguments are wrong, or after `--help`."""
    parser, parsers = build_parser()
    arguments, left = parser.parse_known_args(argv)
    if left and not arguments.free:
        parser.error(f"unknown argument {left[0]}")
    arguments.overrides, arguments.parsers = left, parsers
    return arguments


def build_parser() -> tuple[argparse.ArgumentParser, dict[Verb, argparse.ArgumentParser]]:
    """The parser of everything, and that of each command."""
    parser = _Parser(prog="playlearn", description="Robots that reach any goal you show them, learned from play.")
    parser.add_argument("--version", action="version", version=f"playlearn {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    own: dict[Verb, argparse.ArgumentParser] = {}
    for module in MODULES:
        verb: Verb = module.VERB
        description = f"{verb.help[0].upper()}{verb.help[1:]}."
        made = commands.add_parser(
            verb.name, help=verb.help, description=description, epilog=verb.epilog, allow_abbrev=False
        )
        made.set_defaults(command=verb.run, free=verb.overrides, kept=verb.kept)
        verb.add(made)
        own[verb] = made
    return parser, own


class _Parser(argparse.ArgumentParser):
    """Mistakes in one line, then where to read on."""

    def error(self, message: str) -> NoReturn:
        self.exit(USAGE, f"{self.prog}: {message}\nTry `{self.prog} --help`.\n")

    def print_help(self, file: Any = None) -> None:
        """As argparse does, but for an error of the disk, which it hides."""
        print(self.format_help(), end="", file=file or sys.stdout)
