"""What can be said on the command line."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from playlearn import __version__
from playlearn.cli import commands


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="playlearn", description="Robots that reach any goal you show them, learned from play.")
    parser.add_argument("--version", action="version", version=f"playlearn {__version__}")
    verbs = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def verb(run: Callable[[argparse.Namespace], int], name: str, words: str, **extra: Any) -> argparse.ArgumentParser:
        made = verbs.add_parser(name, help=words, description=f"{words[0].upper()}{words[1:]}.", allow_abbrev=False)
        made.set_defaults(command=run, free=extra.get("free", False), kept=extra.get("kept", ""))
        if extra.get("free"):
            made.epilog = "Any field of the config can be set: `--field value`, `--block.field value`."
        return made

    kept = "; what was finished is kept, and the same command with --resume goes on from there"
    made = verb(commands.collect, "collect", "record play into a store", free=True, kept=kept)
    _config(made, "configs/collect/playtable.yaml")
    made.add_argument("--episodes", type=_count, metavar="N", help="number of episodes in all")
    _workers(made)
    made.add_argument("--seed", type=int, metavar="S", help="the same seed gives the same play")
    made.add_argument("--resume", action="store_true", help="go on with a store that is there, skip what is done")
    single = made.add_mutually_exclusive_group()
    single.add_argument(
        "--episode",
        type=_number,
        metavar="N",
        help="play episode N alone, in this process, with a traceback if it fails. A new --out becomes a store that "
        "holds it alone; a store there that lacks it gets it; one that has it is left as it is, and compared",
    )
    single.add_argument(
        "--device",
        choices=("keyboard", "spacemouse"),
        help="play yourself, in real time and in this process. Enter or the device's reset keeps an episode, "
        "Backspace throws it away, Esc leaves",
    )
    made.add_argument("--sensitivity", type=float, default=1.0, metavar="X", help="of the device (default %(default)s)")

    made = verb(commands.info, "info", "say what is in a store, and whether it is whole")
    made.add_argument("store", type=Path, metavar="STORE")
    made.add_argument("--verify", action="store_true", help="read every episode and compare its checksum")
    made.add_argument(
        "--report",
        type=Path,
        action="append",
        metavar="FILE",
        help="write what was played: a page (.html), its numbers (.json), film strips (.png), a card (.md); repeatable",
    )
    _json(made)

    kept_too = "; what was finished is kept, and the same command goes on from there"
    made = verb(commands.render, "render", "draw a store's images again from its simulator states", kept=kept_too)
    made.add_argument("store", type=Path, metavar="STORE")
    made.add_argument("out", type=Path, metavar="OUT")
    made.add_argument(
        "--camera", type=_camera, action="append", required=True, metavar="NAME=HxW", help="`front=64x64`; repeatable"
    )
    made.add_argument("--episodes", type=_count, metavar="N", help="the first N only (default: all)")
    _workers(made)

    made = verb(commands.view, "view", "open an episode or an evaluation in rerun, or write it to a file")
    made.add_argument("path", type=Path, metavar="STORE|RESULTS")
    made.add_argument("--episode", type=int, default=0, metavar="I", help="which one, from 0 (default %(default)s)")
    made.add_argument(
        "--save",
        type=Path,
        metavar="FILE.rrd|FILE.png",
        help="write a file instead of opening a window; .png: the episode's timeline",
    )

    made = verb(commands.train, "train", "learn a policy from a store", free=True, kept=kept)
    _config(made, "configs/train/NAME.yaml")
    made.add_argument("--store", metavar="STORE", help="train on another store than the config names")
    made.add_argument("--resume", action="store_true", help="go on from the last checkpoint in --out")

    made = verb(commands.evaluate, "eval", "let a policy reach the goals of a suite and write a report", free=True)
    who = made.add_mutually_exclusive_group(required=True)
    who.add_argument("--run", type=Path, metavar="RUN", help="the folder of a training run")
    who.add_argument("--policy", choices=("expert", "random"), help="a reference instead of a trained policy")
    _judged(made, "results.json and report.html")
    made.add_argument(
        "--encoder", type=Path, metavar="RUN", help="let a state policy look through this run's image encoder"
    )
    made.add_argument("--no-baselines", action="store_true", help="without the expert and chance beside it")

    words = "let a policy practice under an expert's eyes, and train it further, in rounds"
    made = verb(commands.dagger, "dagger", words, free=True, kept=kept)
    _config(made, "configs/dagger/NAME.yaml")
    made.add_argument("--run", type=Path, required=True, metavar="RUN", help="the training run to begin with")
    _workers(made)
    made.add_argument("--resume", action="store_true", help="go on with the rounds in --out, skip those that are done")
    _json(made)

    words = "record play, learn from it and reach goal images, in one go; says how long it takes"
    again = "; the same command goes on from there"
    made = verb(commands.demo, "demo", words, free=True, kept=again)
    made.add_argument(
        "--config", type=Path, default=Path("configs/demo.yaml"), metavar="FILE", help="(default %(default)s)"
    )
    made.add_argument("--out", type=Path, default=Path("runs/demo"), metavar="DIR", help="(default %(default)s)")
    made.add_argument("--seed", type=int, metavar="S", help="of play and trainings")
    made.add_argument("--steps", type=_count, metavar="N", help="updates of every training, in place of their configs'")

    made = verb(commands.diagnose, "diagnose", "say why a policy fails on a suite, with pictures", free=True)
    made.add_argument("--run", type=Path, required=True, metavar="RUN", help="the folder of a training run")
    _judged(made, "diagnosis.json and .html")

    made = verb(commands.export, "export", "write a store, or a run's policy, in a format that others read", free=True)
    made.add_argument(
        "format", choices=tuple(commands.EXPORTS), help="a store for LeRobot or robomimic; a run's policy"
    )
    made.add_argument("source", type=Path, metavar="STORE|RUN")
    made.add_argument("out", type=Path, metavar="OUT")
    made.add_argument(
        "--videos",
        nargs="?",
        const="av1",
        choices=("av1", "h264"),
        help="encode the cameras as video (default av1) instead of images",
    )
    made.add_argument(
        "--goals",
        nargs="?",
        const="settled",
        metavar="SAMPLER",
        help="relabeled: each window of play an episode that carries its goal, drawn by a sampler (default settled; "
        "its fields are set as `--goals.ahead 2`)",
    )
    made.add_argument(
        "--subtasks",
        action="store_true",
        help="skills as LeRobot's subtask annotation (`language_persistent`), which its viewer cannot show yet",
    )
    made.add_argument("--push", metavar="USER/NAME", help="upload the dataset to the Hub under this name")
    made.add_argument("--private", action="store_true", help="with --push: for yourself alone")

    words = "put other people's recordings into a store"
    made = verb(commands.import_, "import", words, free=True, kept=kept_too)
    made.add_argument("format", choices=tuple(commands.IMPORTS))
    made.add_argument("source", type=Path, metavar="SRC", help="a dataset's folder, .hdf5 or .npz")
    made.add_argument("out", type=Path, metavar="OUT")
    made.add_argument("--skip-broken", action="store_true", help="leave broken recordings out, and say which")

    made = verb(commands.toy, "toy", "run a small experiment and plot what came out", free=True)
    _config(made, "configs/toy/NAME.yaml")

    made = verb(commands.compare, "compare", "train variants on the same play and judge them", free=True, kept=kept_too)
    _config(made, "configs/compare/NAME.yaml")
    _workers(made)
    _json(made)

    made = verb(commands.bench, "bench", "measure speed beside robosuite, LeRobot and the limit, in one run")
    made.add_argument(
        "name", nargs="*", metavar="NAME", help="sim, render, collect, grow, train, threads, data (default: all)"
    )
    made.add_argument("--out", type=Path, metavar="DIR", help="write compared images here")
    made.add_argument("--quick", action="store_true", help="seconds instead of minutes; the figures say little")
    _json(made)

    made = verb(commands.doctor, "doctor", "say what this machine has, what is missing, and the command that mends it")
    _json(made)
    return parser


class _Parser(argparse.ArgumentParser):
    """Mistakes in one line, then where to read on."""

    def error(self, message: str) -> NoReturn:
        self.exit(commands.USAGE, f"{self.prog}: {message}\nTry `{self.prog} --help`.\n")


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = _parser()
    arguments, left = parser.parse_known_args(argv)
    if left and not arguments.free:
        parser.error(f"unknown argument {left[0]}")
    arguments.overrides = left
    return arguments


def _config(parser: argparse.ArgumentParser, example: str) -> None:
    parser.add_argument("--config", type=Path, required=True, metavar="FILE", help=example)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="the folder to write")


def _judged(parser: argparse.ArgumentParser, left: str) -> None:
    """What a policy is judged on; `left`: the files that are written."""
    parser.add_argument("--suite", type=Path, required=True, metavar="FILE", help="eval/suites/NAME.yaml")
    parser.add_argument("--goal", choices=("image", "state"), required=True, help="how the goal is shown")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help=f"{left} go here")
    parser.add_argument("--episodes", type=_count, metavar="N", help="episodes in all, instead of the suite's own")
    _workers(parser)
    parser.add_argument("--seed", type=int, metavar="S", help="instead of the suite's own")
    _json(parser)


def _workers(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--workers", type=_workers_count, metavar="W", help="processes (default: one a core; 0: none but this one)"
    )


def _json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print what a program would read")


def _count(text: str) -> int:
    count = int(text)
    if count < 1:
        raise argparse.ArgumentTypeError(f"must be 1 or more, not {text}")
    return count


def _number(text: str) -> int:
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"must be 0 or more, not {text}")
    return number


def _workers_count(text: str) -> int:
    return 0 if text == "0" else _count(text)


def _camera(text: str) -> tuple[str, int, int]:
    name, _, size = text.partition("=")
    height, _, width = size.partition("x")
    if not (name and height.isdecimal() and width.isdecimal() and int(height) > 0 and int(width) > 0):
        raise argparse.ArgumentTypeError(f"must be NAME=HEIGHTxWIDTH such as front=64x64, not {text!r}")
    return name, int(height), int(width)
