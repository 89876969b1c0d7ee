"""`playlearn demo`: four stages, each done once.

OUT/play/                   the play
OUT/preview/report.html     what a shipped policy does, to be watched meanwhile
OUT/state/, OUT/encoder/    the state policy and the image encoder, trained side by side
OUT/dagger/                 a DAgger run of the state policy behind the encoder
OUT/run/                    the two as one policy, a run like any other
OUT/eval/                   its evaluation on goal images
OUT/demo.json               what each stage cost, written when it is done: a stage that is in it is not done again
"""

import json
import sys
import time
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from playlearn.config import RunFolder, atomic_write, file_digest, git_revision, held, load_config, to_dict, versions
from playlearn.demo.checks import success_problem, training_problem
from playlearn.demo.commands import Done, run_together
from playlearn.demo.config import Cost, DemoConfig
from playlearn.demo.reference import Reference, measure
from playlearn.errors import PlaylearnError
from playlearn.evaluation import join_runs
from playlearn.executor import available_cores
from playlearn.privileges import KEY as PRIVILEGED
from playlearn.privileges import Privileges
from playlearn.training import TrainConfig

RECORD = "demo.json"
STOPPED = (130, -15)  # exit codes of a command that was interrupted or terminated
OPTIONAL = ("film",)  # only to be watched
EVERY = 60.0  # seconds between two estimates of the time left
STAGES = ("collect", "train", "DAgger", "evaluate")


def demo(config: DemoConfig, out: Path, *, steps: int | None = None, say: Callable[[str], None] | None = None) -> None:
    """Run the demo into `out`; stages that are done there are not repeated.

    steps: updates of every training, in place of their configs'.

    Raises:
        UsageError: `out` holds something else or was begun with other configs, or a config is missing.
        BusyError: another process runs it there.
        DiskError: the disk is full; the stages that are done are kept.
        PlaylearnError: a stage failed or learned nothing; the message says which and why.
        KeyboardInterrupt: on Ctrl-C; the same call continues.
    """
    job = _Demo(config, out, steps, say or _print)
    with held(out):
        job.claim()
        job.estimate()
        job.collect()
        job.learn()
        job.dagger()
        job.evaluate()


@dataclass(eq=False)
class _Demo:
    config: DemoConfig
    out: Path
    steps: int | None
    say: Callable[[str], None]

    def __post_init__(self) -> None:
        self.record: dict[str, Any] = {}
        self.reference = Reference(0.0, 0.0)
        self.pace = 1.0  # how much longer the stages so far took than was estimated
        self._reported = time.monotonic()

    def claim(self) -> None:
        """Find what is done; raises UsageError where `out` was begun with another config."""
        config, folder = self.config, RunFolder(self.out, RECORD, "demo")
        given = {**to_dict(config, self.out), "steps": self.steps}
        files = {name: getattr(config, name) for name in ("collect", "state", "encoder", "dagger", "suite")}
        inputs = {name: {path.name: file_digest(path)} for name, path in files.items()}
        if folder.begun():
            self.record = json.loads(folder.file.read_text())
            folder.check_same(self.record["config"], given)
            folder.check_inputs(inputs)
            return
        folder.keep_inputs(inputs)
        self.record = {"config": given, "versions": versions(), "git_revision": git_revision(), "stages": {}}
        self.write()  # from now on this is a demo's folder, wherever it is interrupted

    def write(self) -> None:
        """demo.json as it stands."""
        atomic_write(self.out / RECORD, json.dumps(self.record, indent=2).encode())

    def estimate(self) -> None:
        """Time the reference workload and print how long each stage will take."""
        self.say("timing this machine ...")
        self.reference = measure()
        self.record["reference"] = asdict(self.reference)
        left = [name for name in STAGES if name not in self.record["stages"]]
        for name in left:
            self.say(f"  {name:<20} about {_minutes(self._estimated(name))}")
        if left:
            self.say(f"  {'all':<20} about {_minutes(sum(map(self._estimated, left)))}, on {available_cores()} cores")

    def collect(self) -> None:
        """Collect play; meanwhile show a shipped policy."""
        config, seed = self.config, str(self.config.seed)
        page = self.out / "preview" / "report.html"
        play = ["collect", "--config", str(config.collect), "--out", str(self.out / "play"), "--seed", seed, "--resume"]
        film = ["eval", "--run", str(config.preview), "--suite", str(config.suite), "--goal", "image"]
        film += ["--episodes", "2", "--no-baselines", "--workers", "1", "--out", str(page.parent)]
        film += [f"--kind.tasks=[{config.preview_task}]"]
        announced = page.is_file()

        def watch() -> None:
            nonlocal announced
            if not announced and page.is_file():
                announced = True
                self.say(f"a film of a shipped policy; yours will do the same: {page}")
                if sys.stdout.isatty():
                    webbrowser.open(page.resolve().as_uri())

        commands = {"play": play} if announced else {"play": play, "film": film}
        self._stage("collect", commands, watch)

    def learn(self) -> None:
        """Train the state policy and the image encoder side by side.

        Raises:
            PlaylearnError: one of them learned too little for the next stage.
        """
        config = self.config
        commands = {
            "policy": self._training(config.state, "state"),
            "encoder": self._training(config.encoder, "encoder"),
        }
        self._stage("train", commands)
        for what, name, path, part, level in (
            ("the state policy", "state", config.state, "head", config.state_loss),
            ("the image encoder", "encoder", config.encoder, "achieved", config.encoder_loss),
        ):
            planned = load_config(TrainConfig, path).steps
            problem = training_problem(what, self.out / name, part, level, planned)
            if problem:
                raise PlaylearnError(f"the demo stops here: {problem}")

    def dagger(self) -> None:
        """DAgger behind the encoder; then join the two into one run."""
        folder = self.out / "dagger"
        command = [
            "dagger",
            "--config",
            str(self.config.dagger),
            "--run",
            str(self.out / "state"),
            "--out",
            str(folder),
        ]
        command += [f"--encoder={self.out / 'encoder'}", f"--seed={self.config.seed}"]
        command += ["--resume"] if (folder / "dagger.yaml").is_file() else []
        command += [] if self.steps is None else [f"--updates={self.steps}"]
        self._stage("DAgger", {"dagger": command})
        join_runs(folder, self.out / "encoder", self.out / "run")

    def evaluate(self) -> None:
        """Evaluate on unseen goal images; raises PlaylearnError where that is no better than a random policy."""
        folder = self.out / "eval"
        command = ["eval", "--run", str(self.out / "run"), "--suite", str(self.config.suite), "--goal", "image"]
        command += ["--episodes", str(self.config.episodes), "--out", str(folder)]
        self._stage("evaluate", {"eval": command})
        results = json.loads((folder / "results.json").read_text())
        self._table(results)
        problem = success_problem(results)
        if problem:
            raise PlaylearnError(problem)

    def _training(self, config: Path, name: str) -> list[str]:
        run = self.out / name
        command = ["train", "--config", str(config), "--store", str(self.out / "play"), "--out", str(run)]
        command += [f"--seed={self.config.seed}"]
        command += ["--resume"] if (run / "config.yaml").is_file() else []
        return command + ([] if self.steps is None else [f"--steps={self.steps}"])

    def _stage(self, name: str, commands: Mapping[str, Sequence[str]], watch: Callable[[], None] | None = None) -> None:
        """Run a stage's commands, unless it is done; record what it cost."""
        if name in self.record["stages"]:
            self.say(f"== {name}: done already")
            return
        left = STAGES[STAGES.index(name) + 1 :]
        estimated = self._estimated(name)
        self.say(f"== {name}: about {_minutes(estimated * self.pace)}")
        began = self._reported = time.monotonic()

        def tick() -> None:
            if watch is not None:
                watch()
            now = time.monotonic()
            if now - self._reported >= EVERY:
                self._reported = now
                pace = max(self.pace, (now - began) / max(estimated, 1e-9))
                rest = max(0.0, estimated * pace - (now - began)) + pace * sum(map(self._estimated, left))
                self.say(f"demo | about {_minutes(rest)} left in all")

        done = run_together(commands, self.say, tick, optional=OPTIONAL)
        self._check(name, done)
        seconds = time.monotonic() - began
        self.pace = seconds / max(estimated, 1e-9)
        self.record["stages"][name] = {
            "seconds": round(seconds, 1),
            "estimated_seconds": round(estimated, 1),
            "core_seconds": {key: round(one.core_seconds, 1) for key, one in done.items()},
            "reference_seconds": round(self.reference.simulation + self.reference.learning, 3),
        }
        self.write()

    def _check(self, name: str, done: Mapping[str, Done]) -> None:
        """Raises PlaylearnError where a command failed; names it, not those that were stopped because of it."""
        failed = {key: one.code for key, one in done.items() if one.code and key not in OPTIONAL}
        if failed:
            key = min(failed, key=lambda key: failed[key] in STOPPED)
            why = f"{key} ended with exit code {failed[key]} (see its message above)"
            raise PlaylearnError(f"{name}: {why}; the same command continues from there")

    def _estimated(self, name: str) -> float:
        """Seconds of a stage on this machine, by the reference workload."""
        cost = self.config.costs.get(name, Cost())
        core = cost.simulation * self.reference.simulation + cost.learning * self.reference.learning
        return core / max(1.0, min(cost.cores, available_cores()))

    def _table(self, results: Mapping[str, Any]) -> None:
        for name, one in self.record["stages"].items():
            core = sum(one["core_seconds"].values())
            ratio = core / one["reference_seconds"]
            self.say(
                f"{name:<20} {one['seconds']:6.0f} s  {core:6.0f} core seconds  {ratio:6.0f} x the reference workload"
            )
        low, high = results["ci95"]
        self.say(
            f"success on goal images: {results['success_rate']:.1%} [{low:.1%}, {high:.1%}] of {results['episodes']}\n"
            f"privileged information: {Privileges.from_dict(results.get(PRIVILEGED))}; the policy itself sees images "
            "and the robot's state\n"
            f"the report: {self.out / 'eval' / 'report.html'}"
        )


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def _print(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
