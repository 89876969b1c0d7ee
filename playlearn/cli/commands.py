"""What each verb does with its arguments; returns an exit code."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from playlearn.errors import UsageError
from playlearn.threads import limit

DONE, FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130


def collect(arguments: argparse.Namespace) -> int:
    from playlearn.collection import CollectConfig, collect_by_hand, collect_one
    from playlearn.collection import collect as run
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
        from playlearn.process_cache import cached_env_of
        from playlearn.report.store_report import write_report

        for path in arguments.report:
            write_report(store, path, lambda: cached_env_of(store))
            print(f"report  {path}", file=sys.stderr)
    return FAILED if problems else DONE


def render(arguments: argparse.Namespace) -> int:
    from playlearn.collection import render_store
    from playlearn.sim.environment import CameraConfig

    cameras = {name: CameraConfig(height=height, width=width) for name, height, width in arguments.camera}
    render_store(arguments.store, arguments.out, cameras, workers=arguments.workers, episodes=arguments.episodes)
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
    from playlearn.training import TrainConfig
    from playlearn.training import train as run

    config = load_config(TrainConfig, arguments.config, _flags(arguments, "store") + arguments.overrides)
    run(config, arguments.out, resume=arguments.resume)
    return DONE


def evaluate(arguments: argparse.Namespace) -> int:
    from playlearn.evaluation import evaluate as run

    limit()  # of what that has imported, too
    results = run(
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
            print(f"{name:<10} {rates['success_rate']:6.1%}  [{low:.1%}, {high:.1%}] of {rates['episodes']} episodes")
        print(f"report     {arguments.out / 'report.html'}")
    return DONE


def dagger(arguments: argparse.Namespace) -> int:
    from playlearn.config import load_config
    from playlearn.dagger import DaggerConfig
    from playlearn.dagger import dagger as run
    from playlearn.dagger.results import line

    limit()
    config = load_config(DaggerConfig, arguments.config, arguments.overrides)
    results = run(config, arguments.run, arguments.out, workers=arguments.workers, resume=arguments.resume)
    if arguments.json:
        print(json.dumps(results, indent=2))
    else:
        for row in results["rounds"]:
            print(line(row))
        print(f"plot  {arguments.out / 'plot.png'}")
    return DONE


def demo(arguments: argparse.Namespace) -> int:
    from playlearn.config import load_config
    from playlearn.demo import DemoConfig
    from playlearn.demo import demo as run

    config = load_config(DemoConfig, arguments.config, _flags(arguments, "seed") + arguments.overrides)
    run(config, arguments.out, steps=arguments.steps)
    return DONE


def diagnose(arguments: argparse.Namespace) -> int:
    from playlearn.evaluation.diagnosis import diagnose as run
    from playlearn.evaluation.diagnosis import format_summary

    limit()
    results = run(
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


def export(arguments: argparse.Namespace) -> int:
    if arguments.format != "lerobot":
        given = [f"--{name}" for name in ("videos", "goals", "subtasks", "push", "private") if getattr(arguments, name)]
        if given or arguments.overrides:
            raise UsageError(f"{(given + arguments.overrides)[0]} says nothing of `export {arguments.format}`")
    return EXPORTS[arguments.format](arguments)


def _export_policy(arguments: argparse.Namespace) -> int:
    from playlearn.lerobot.publish import export_policy

    export_policy(arguments.source, arguments.out)
    words = f"lerobot-eval --policy.path={arguments.out} --env.type=playlearn --env.suite=eval/suites/NAME.yaml"
    print(f"{arguments.out}: a policy for LeRobot; try `{words}`")
    return DONE


def _export_lerobot(arguments: argparse.Namespace) -> int:
    from playlearn.config import load_config
    from playlearn.lerobot.goals import RelabelConfig
    from playlearn.lerobot.share import contents, push, share
    from playlearn.report.progress import Progress
    from playlearn.store import open_store
    from playlearn.store.lerobot.metadata import is_lerobot

    kind = [] if arguments.goals is None else [f"--goals.type={arguments.goals}"]
    if arguments.overrides and not kind:
        raise UsageError(f"unknown argument {arguments.overrides[0]}; how goals are drawn is said with --goals")
    goals = load_config(RelabelConfig, None, kind + arguments.overrides) if kind else None
    if not (arguments.push and is_lerobot(arguments.out)):
        content = contents(open_store(arguments.source), goals, subtasks=arguments.subtasks)
        with Progress(f"export {arguments.out}", len(content), "episode") as progress:
            fidelity = share(content, arguments.out, arguments.videos, lambda done, _: progress.to(done))
        for camera, read in fidelity.items():
            print(f"{camera}: {read}")
        print(f"{arguments.out}: LeRobot v3.0, {len(content)} episodes")
    if arguments.push:
        print(push(arguments.out, arguments.push, private=arguments.private))
    return DONE


def _export_robomimic(arguments: argparse.Namespace) -> int:
    from playlearn.data import DataConfig
    from playlearn.data.split import val_mask
    from playlearn.report.progress import Progress
    from playlearn.store import open_store
    from playlearn.store.robomimic_export import export_robomimic

    store = open_store(arguments.source)
    out, numbers = val_mask(store, DataConfig().val_fraction), store.indices()
    masks = {"train": numbers[~out].tolist(), "valid": numbers[out].tolist()}
    with Progress(f"export {arguments.out}", len(store), "episode") as progress:
        export_robomimic(store, arguments.out, masks, progress.to)
    print(f"{arguments.out}: robomimic's HDF5, {len(store)} episodes, {len(masks['valid'])} of them under mask valid")
    return DONE


EXPORTS = {"lerobot": _export_lerobot, "robomimic": _export_robomimic, "policy": _export_policy}


def import_(arguments: argparse.Namespace) -> int:
    from playlearn.report.progress import Progress
    from playlearn.store.importing import import_recordings

    recordings = IMPORTS[arguments.format](arguments.source, arguments.overrides)
    with Progress(f"import {arguments.out}", len(recordings.names()), "recording") as progress:
        skip = arguments.skip_broken
        store = import_recordings(recordings, arguments.out, skip_broken=skip, progress=progress.to, say=progress.say)
    print(f"{arguments.out}: {len(store)} episodes, {int(store.lengths().sum())} steps")
    for name, numbers in recordings.splits.items():
        print(f"mask {name}: {len(numbers)} episodes")
    return DONE


def _robomimic(source: Path, overrides: list[str]) -> Any:
    from playlearn.config import load_config
    from playlearn.store.robomimic import RobomimicConfig, RobomimicFile

    return RobomimicFile(source, load_config(RobomimicConfig, None, overrides))


def _robosuite(source: Path, overrides: list[str]) -> Any:
    from playlearn.config import load_config
    from playlearn.store.robosuite_demos import RobosuiteConfig, RobosuiteFile

    return RobosuiteFile(source, load_config(RobosuiteConfig, None, overrides))


def _ogbench(source: Path, overrides: list[str]) -> Any:
    from playlearn.store.ogbench import OgbenchFile

    if overrides:
        raise UsageError(f"unknown argument {overrides[0]}")
    return OgbenchFile(source)


def _lerobot(source: Path, overrides: list[str]) -> Any:
    from playlearn.config import load_config
    from playlearn.store.lerobot.config import LeRobotStoreConfig
    from playlearn.store.lerobot.recordings import LeRobotRecordings

    return LeRobotRecordings(load_config(LeRobotStoreConfig, None, [f"--root={json.dumps(str(source))}", *overrides]))


IMPORTS = {"lerobot": _lerobot, "robomimic": _robomimic, "robosuite": _robosuite, "ogbench": _ogbench}


def toy(arguments: argparse.Namespace) -> int:
    from playlearn.experiments.toy import load_experiment
    from playlearn.experiments.toy import run as measure

    experiment = load_experiment(arguments.config, arguments.overrides)
    rows = measure(experiment, arguments.out, lambda words: print(words, file=sys.stderr, flush=True))
    for row in rows:
        print("  ".join(f"{name} {value}" for name, value in row.items() if not isinstance(value, list)))
    print(f"plot  {arguments.out / 'plot.png'}")
    return DONE


def compare(arguments: argparse.Namespace) -> int:
    from playlearn.config import load_config
    from playlearn.experiments.compare import CompareConfig
    from playlearn.experiments.compare import compare as run
    from playlearn.report.compared import table

    limit()
    config = load_config(CompareConfig, arguments.config, arguments.overrides)
    rows = run(config, arguments.out, workers=arguments.workers)
    print(json.dumps(rows, indent=2) if arguments.json else table(rows), end="\n" if arguments.json else "")
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


def _flags(arguments: argparse.Namespace, *names: str) -> list[str]:
    """Flags that are a config's own fields, as overrides."""
    given = {name: getattr(arguments, name) for name in names}
    return [f"--{name}={json.dumps(value)}" for name, value in given.items() if value is not None]


def _print_facts(facts: dict[str, Any]) -> None:
    width = max(map(len, facts), default=0)
    for name, value in facts.items():
        print(f"{name:<{width}}  {value if isinstance(value, str) else json.dumps(value)}")
