"""The `playlearn` command. Each verb imports what it needs when it runs, so that `--help` stays quick.

Exit codes: 0 done, 1 the job failed, 2 bad usage or config, 130 interrupted (what was finished is kept).
"""

import argparse
import errno
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from playlearn import __version__
from playlearn.errors import PlaylearnError, UsageError

DONE, FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130
DEBUG = "PLAYLEARN_DEBUG"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; a mistake ends in one message on stderr, not a traceback."""
    try:
        arguments = _parse(argv)
    except SystemExit as stop:  # argparse has said why
        return int(stop.code or 0)
    try:
        with _termination_as_interrupt():
            code: int = arguments.command(arguments)
            sys.stdout.flush()
            return code
    except KeyboardInterrupt:
        return _say(f"interrupted{arguments.kept}", INTERRUPTED)
    except BrokenPipeError:  # the reader of our output went away: `playlearn info STORE | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except Exception as error:
        message = _explain(error)
        if message is None:
            raise
        return _say(message, USAGE if isinstance(error, UsageError) else FAILED)


def collect(arguments: argparse.Namespace) -> int:
    from playlearn.collect import CollectConfig, collect_by_hand, collect_one
    from playlearn.collect import collect as run
    from playlearn.config import load_config

    overrides = _flags(arguments, "episodes", "seed") + arguments.overrides
    config = load_config(CollectConfig, arguments.config, overrides)
    if arguments.episode is not None:
        collect_one(config, arguments.out, arguments.episode)
    elif arguments.device is not None:
        collect_by_hand(config, arguments.out, arguments.device, arguments.sensitivity, resume=arguments.resume)
    else:
        run(config, arguments.out, workers=arguments.workers, resume=arguments.resume)
    return DONE


def info(arguments: argparse.Namespace) -> int:
    from playlearn.store import open_store

    store = open_store(arguments.store)
    facts = store.info()
    problems = store.verify() if arguments.verify else []
    if arguments.verify:
        facts = {**facts, "problems": problems}
    if arguments.json:
        print(json.dumps(facts, indent=2))
    else:
        _print_facts({key: value for key, value in facts.items() if key != "problems"})
        if arguments.verify and not problems:
            print(f"whole: every checksum of {len(store)} episodes holds")
    for problem in problems:
        print(f"playlearn: {problem}", file=sys.stderr)
    if arguments.report:
        from playlearn.collect.world import world
        from playlearn.config import from_dict
        from playlearn.report.store_report import write_report
        from playlearn.sim import EnvironmentConfig

        for path in arguments.report:
            write_report(store, path, lambda: world(from_dict(EnvironmentConfig, dict(store.spec.environment))))
            print(f"report  {path}", file=sys.stderr)
    return FAILED if problems else DONE


def render(arguments: argparse.Namespace) -> int:
    from playlearn.collect import render_store
    from playlearn.sim.environment import CameraConfig

    cameras = {name: CameraConfig(height=height, width=width) for name, height, width in arguments.camera}
    render_store(arguments.store, arguments.out, cameras, workers=arguments.workers)
    return DONE


def view(arguments: argparse.Namespace) -> int:
    if not arguments.path.exists():
        raise UsageError(f"there is nothing at {arguments.path}; give a store or the --out folder of an evaluation")
    from playlearn.report.view import view_episode, view_results

    if (arguments.path / "results.json").exists():
        view_results(arguments.path, save=arguments.save)
    else:
        view_episode(arguments.path, arguments.episode, save=arguments.save)
    return DONE


def train(arguments: argparse.Namespace) -> int:
    from playlearn.config import load_config
    from playlearn.train import TrainConfig
    from playlearn.train import train as run

    config = load_config(TrainConfig, arguments.config, _flags(arguments, "store") + arguments.overrides)
    run(config, arguments.out, resume=arguments.resume)
    return DONE


def evaluate(arguments: argparse.Namespace) -> int:
    from playlearn.evaluate import evaluate as run

    results = run(
        arguments.suite,
        run=arguments.run,
        policy=arguments.policy,
        goal=arguments.goal,
        out=arguments.out,
        episodes=arguments.episodes,
        workers=arguments.workers,
        seed=arguments.seed,
        overrides=arguments.overrides,
    )
    if arguments.json:
        print(json.dumps(results, indent=2))
    else:
        for name, rates in ((results["policy"]["name"], results), *results["references"].items()):
            low, high = rates["ci95"]
            print(f"{name:<10} {rates['success_rate']:6.1%}  [{low:.1%}, {high:.1%}] of {rates['episodes']} episodes")
        print(f"report     {arguments.out / 'report.html'}")
    return DONE


def export(arguments: argparse.Namespace) -> int:
    from playlearn.report.progress import Progress
    from playlearn.store import open_store
    from playlearn.store.lerobot import export_lerobot

    store = open_store(arguments.store)
    with Progress(f"export {arguments.out}", len(store), "episode") as progress:
        export_lerobot(store, arguments.out, videos=arguments.videos, progress=lambda done, _: progress.to(done))
    print(f"{arguments.out}: LeRobot v3.0, {len(store)} episodes")
    return DONE


def lab(arguments: argparse.Namespace) -> int:
    from playlearn.lab import load_experiment
    from playlearn.lab import run as measure

    experiment = load_experiment(arguments.config, arguments.overrides)
    rows = measure(experiment, arguments.out, lambda words: print(words, file=sys.stderr, flush=True))
    for row in rows:
        print("  ".join(f"{name} {value}" for name, value in row.items() if not isinstance(value, list)))
    print(f"plot  {arguments.out / 'plot.png'}")
    return DONE


def bench(arguments: argparse.Namespace) -> int:
    from dataclasses import asdict, replace

    from playlearn.bench import Size, run

    said = (lambda _: None) if arguments.json else (lambda figure: print(figure.line(), flush=True))
    quick = Size(steps=20, rounds=1, episodes=20) if arguments.quick else Size()
    figures = run(arguments.name, replace(quick, out=arguments.out), said)
    if arguments.json:
        print(json.dumps([asdict(figure) for figure in figures], indent=2))
    return DONE


def doctor(arguments: argparse.Namespace) -> int:
    from playlearn.doctor import doctor as run

    return run(json_output=arguments.json)


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
    made = verb(collect, "collect", "record play into a store", free=True, kept=kept)
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

    made = verb(info, "info", "say what is in a store, and whether it is whole")
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
    made = verb(render, "render", "draw a store's images again from its simulator states", kept=kept_too)
    made.add_argument("store", type=Path, metavar="STORE")
    made.add_argument("out", type=Path, metavar="OUT")
    made.add_argument(
        "--camera", type=_camera, action="append", required=True, metavar="NAME=HxW", help="`front=64x64`; repeatable"
    )
    _workers(made)

    made = verb(view, "view", "open an episode or an evaluation in rerun, or write the .rrd where there is no display")
    made.add_argument("path", type=Path, metavar="STORE|RESULTS")
    made.add_argument("--episode", type=int, default=0, metavar="I", help="which one, from 0 (default %(default)s)")
    made.add_argument("--save", type=Path, metavar="FILE.rrd", help="write a file instead of opening a window")

    made = verb(train, "train", "learn a policy from a store", free=True, kept=kept)
    _config(made, "configs/train/NAME.yaml")
    made.add_argument("--store", metavar="STORE", help="train on another store than the config names")
    made.add_argument("--resume", action="store_true", help="go on from the last checkpoint in --out")

    made = verb(evaluate, "eval", "let a policy reach the goals of a suite and write a report", free=True)
    who = made.add_mutually_exclusive_group(required=True)
    who.add_argument("--run", type=Path, metavar="RUN", help="the folder of a training run")
    who.add_argument("--policy", choices=("expert", "random"), help="a reference instead of a trained policy")
    made.add_argument("--suite", type=Path, required=True, metavar="FILE", help="eval/suites/NAME.yaml")
    made.add_argument("--goal", choices=("image", "state"), required=True, help="how the goal is shown")
    made.add_argument("--out", type=Path, required=True, metavar="DIR", help="results.json and report.html go here")
    made.add_argument("--episodes", type=_count, metavar="N", help="episodes in all, instead of the suite's own")
    _workers(made)
    made.add_argument("--seed", type=int, metavar="S", help="instead of the suite's own")
    _json(made)

    made = verb(export, "export", "write a store in a format that others read")
    made.add_argument("format", choices=("lerobot",))
    made.add_argument("store", type=Path, metavar="STORE")
    made.add_argument("out", type=Path, metavar="OUT")
    made.add_argument("--videos", action="store_true", help="encode the cameras as video instead of images")

    made = verb(lab, "lab", "run a small experiment and plot what came out", free=True)
    _config(made, "configs/lab/NAME.yaml")

    made = verb(bench, "bench", "measure speed beside robosuite and beside the limit, in one run")
    made.add_argument("name", nargs="*", metavar="NAME", help="sim, render, collect, grow (default: all)")
    made.add_argument("--out", type=Path, metavar="DIR", help="write compared images here")
    made.add_argument("--quick", action="store_true", help="seconds instead of minutes; the figures say little")
    _json(made)

    made = verb(doctor, "doctor", "say what this machine has, what is missing, and the command that mends it")
    _json(made)
    return parser


class _Parser(argparse.ArgumentParser):
    """Mistakes in one line, then where to read on."""

    def error(self, message: str) -> NoReturn:
        self.exit(USAGE, f"{self.prog}: {message}\nTry `{self.prog} --help`.\n")


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = _parser()
    arguments, left = parser.parse_known_args(argv)
    if left and not arguments.free:
        parser.error(f"unknown argument {left[0]}")
    arguments.overrides = left
    return arguments


def _config(parser: argparse.ArgumentParser, example: str) -> None:
    parser.add_argument("--config", type=Path, required=True, metavar="FILE", help=example)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="the folder to write")


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


def _flags(arguments: argparse.Namespace, *names: str) -> list[str]:
    """Flags that are a config's own fields, as overrides."""
    given = {name: getattr(arguments, name) for name in names}
    return [f"--{name}={json.dumps(value)}" for name, value in given.items() if value is not None]


def _print_facts(facts: dict[str, Any]) -> None:
    width = max(map(len, facts), default=0)
    for name, value in facts.items():
        print(f"{name:<{width}}  {value if isinstance(value, str) else json.dumps(value)}")


def _explain(error: Exception) -> str | None:
    """The message of an error that a user can mend; None for one that is ours."""
    if isinstance(error, PlaylearnError):
        return str(error)
    if getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT) or "No space left on device" in str(error):
        return f"the disk is full ({error}); what was finished is kept. Make room and run the same command again."
    if (
        isinstance(error, PermissionError | FileNotFoundError | NotADirectoryError | IsADirectoryError)
        and error.filename
    ):
        return f"{error.strerror}: {error.filename}"
    if isinstance(error, OSError) and error.errno == errno.EROFS:
        return f"{error.strerror}: {error.filename}"
    return None


def _say(message: str, code: int) -> int:
    if os.environ.get(DEBUG):
        traceback.print_exc()
    print(f"playlearn: {message}", file=sys.stderr)
    return code


@contextmanager
def _termination_as_interrupt() -> Iterator[None]:
    """SIGTERM ends a job as Ctrl-C does: cleanly, with what was finished kept."""

    def interrupt(_signal: int, _frame: object) -> None:
        raise KeyboardInterrupt

    try:
        former = signal.signal(signal.SIGTERM, interrupt)
    except ValueError:  # not the main thread, which alone may say so
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, former)


if __name__ == "__main__":
    sys.exit(main())
