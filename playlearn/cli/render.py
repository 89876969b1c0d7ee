"""`playlearn render`."""

import argparse
from pathlib import Path

from playlearn.cli.verb import DONE, REPEAT, Verb, add_workers, count


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("store", type=Path, metavar="STORE")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument(
        "--camera", type=_camera, action="append", required=True, metavar="NAME=HxW", help="`front=64x64`; repeatable"
    )
    parser.add_argument("--episodes", type=count, metavar="N", help="the first N only (default: all)")
    add_workers(parser)


def run(arguments: argparse.Namespace) -> int:
    from playlearn.collection import render_store
    from playlearn.sim.environment import CameraConfig

    cameras = {name: CameraConfig(height=height, width=width) for name, height, width in arguments.camera}
    render_store(arguments.store, arguments.out, cameras, workers=arguments.workers, episodes=arguments.episodes)
    return DONE


def _camera(text: str) -> tuple[str, int, int]:
    name, _, size = text.partition("=")
    height, _, width = size.partition("x")
    if not (name and height.isdecimal() and width.isdecimal() and int(height) > 0 and int(width) > 0):
        raise argparse.ArgumentTypeError(f"must be NAME=HEIGHTxWIDTH such as front=64x64, not {text!r}")
    return name, int(height), int(width)


VERB = Verb("render", "render a store's images again from its simulator states", run, add, kept=REPEAT)
