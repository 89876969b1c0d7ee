"""`playlearn dagger`: rounds of rollouts, training and evaluation, each done once.

OUT/dagger.yaml, dagger.json        what is run, from which policy
OUT/rounds/N/play/                  the round's own store; rollouts/: how each episode went
OUT/rounds/N/train/                 a training run that starts from the last round's policy
OUT/rounds/N/eval/                  a report like that of `playlearn eval`
OUT/rounds/N/round.json             its row, written last: a round without one continues where it stopped
OUT/perceived/                      play and rollouts as the image encoder perceives them, with `encoder`
OUT/results.json, plot.png          all rows
OUT/config.yaml, policy/            the last round's, so that OUT is a run like any other
"""

import functools
import json
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from playlearn.config import (
    Digests,
    RunFolder,
    atomic_write,
    copy_config,
    git_revision,
    held,
    json_digest,
    load_config,
    make_folder,
    save_config,
    spelled_from,
    to_dict,
    versions,
)
from playlearn.dagger.actor import InterventionRule
from playlearn.dagger.config import ADJUSTABLE, DaggerConfig
from playlearn.dagger.gather import GatherContext
from playlearn.dagger.results import evaluated, line, plot
from playlearn.dagger.rollouts import Make, RolloutSpec, dagger_actor
from playlearn.data.mixture import DatasetSource
from playlearn.data.perceived import PerceivedConfig
from playlearn.errors import MissingRunError, PlaylearnError, UsageError
from playlearn.evaluation import TrainedRecipe, evaluate, load_suite, scripted
from playlearn.evaluation.suite import derived_seed, goal_from
from playlearn.policies import Policy, policy_digests
from playlearn.process_cache import cached_env
from playlearn.store import open_store
from playlearn.training import TrainConfig, train

CONFIG, NOTE, ROW = "dagger.yaml", "dagger.json", "round.json"
_ROLLOUTS, _TRAINING = 0xDA66E4, 0x7E57ED  # so that no seed serves two purposes


def dagger(
    config: DaggerConfig,
    run: Path,
    out: Path,
    *,
    workers: int | None = None,
    resume: bool = False,
    expert: Make | None = None,
) -> dict[str, Any]:
    """Improve the policy of `run` in rounds; see the drawing above. expert: by default that of the environment.

    Returns the contents of results.json.

    Raises:
        UsageError: a setting does not fit the run; `out` is taken or, with `resume`, was begun with another config or
            other data.
        BusyError: another process writes into `out`.
        DiskError: the disk is full; what was finished is kept.
        CheckpointError: there is no such run, or the suites are not of its environment.
        PlaylearnError: no episode of a round reached its goal.
    """
    job = _Job(config, run, out, workers, expert or scripted)
    job.check()
    with held(out):
        _claim(job, resume=resume)
        rows = [job.start()]
        for number in range(1, config.rounds + 1):
            rows.append(job.round(number, rows))
            results = job.write(rows)
    return results


@dataclass(eq=False)
class _Job:
    """What is common to all rounds."""

    config: DaggerConfig
    run: Path
    out: Path
    workers: int | None
    expert: Make

    def __post_init__(self) -> None:
        """Reads the configs of the run and the suites; nothing is simulated."""
        config, path = self.config, self.run / "config.yaml"
        if not path.is_file():
            raise MissingRunError(f"there is no run at {self.run} (no config.yaml); make one with: playlearn train")
        self.training = load_config(TrainConfig, path)
        self.suite = load_suite(config.rollout_suite)
        self.suite = replace(self.suite, kind=self.suite.kind.prepare(None))
        self.seed = derived_seed(_ROLLOUTS, config.seed)
        self.eval_suite = load_suite(config.suite or config.rollout_suite)
        self.eval_seed = self.eval_suite.seed if config.eval_seed is None else config.eval_seed

    @functools.cached_property
    def context(self) -> GatherContext:
        """What is handed to whatever gathers."""
        config = self.config
        return GatherContext(
            rounds=config.rounds,
            episodes=config.episodes,
            rollout_spec=self.rollout_spec,
            goals=config.goals,
            max_label_deviation=config.max_label_deviation,
            store=open_store(self.training.store),
            environment=self.suite.environment,
            cameras=self.trained(self.run).cameras(),
            seed=config.seed,
            workers=self.workers,
        )

    def check(self) -> None:
        """Find what would go wrong later, in an environment or two, before anything is written.

        Raises:
            PlaylearnError: policy, expert, play and suite do not belong together.
        """
        config = self.config
        if self.seed == self.eval_seed:
            raise UsageError(
                f"eval_seed {self.eval_seed} is the seed of the rollouts: training would see what is evaluated; "
                "give another eval_seed"
            )
        open_store(self.training.store)
        policy = self.trained(self.run)
        policy.check()
        if not policy.policy().spec.achieved_names:
            raise UsageError(
                f"{self.run} learned from play without object poses (`blind`, or a robot's), and the expert that "
                "labels rollouts reads them: this run cannot be improved by DAgger"
            )
        environment = cached_env(self.suite.environment)
        actor = dagger_actor(self.rollout_spec(1, self.run), environment)
        policy.build(cached_env(self.eval_suite.environment))
        self.expert(environment)  # an environment without an expert fails here
        config.gather.check(self.context)
        asked = config.gate.sampled
        if asked:
            environment.reset(0)
            actor.reset([goal_from(environment, policy.cameras())], [0])
            actor.act([environment.observe(actor.cameras)], [True])
            if not actor.unsure():
                raise UsageError(
                    f"gate: the policy of {self.run} samples the same chunk again and again, so that it is never "
                    "uncertain; use `gate.type: distance`, or train a head that samples"
                )

    def inputs(self) -> Digests:
        """What all rounds read, by digest."""
        config = self.config
        inputs: dict[str, Mapping[str, str]] = {
            "store of the run": open_store(self.training.store).digests(),
            "policy of the run": policy_digests(self.run),
            "suites": {
                "rollout_suite": json_digest(to_dict(self.suite, self.out)),
                "suite": json_digest(to_dict(self.eval_suite, self.out)),
            },
        }
        return inputs if config.encoder is None else {**inputs, "encoder": policy_digests(config.encoder)}

    def start(self) -> dict[str, Any]:
        """Row 0: the policy that the run starts from."""
        folder = self.out / "rounds" / "0"
        if (folder / ROW).is_file():
            return _read(folder / ROW)
        return self.done(folder, {"round": 0, **evaluated(self.evaluate(self.run, folder / "eval"))})

    def round(self, number: int, before: list[dict[str, Any]]) -> dict[str, Any]:
        """Row `number`. before: the rows of the rounds before it."""
        config, folder = self.config, self.out / "rounds" / str(number)
        if (folder / ROW).is_file():
            return _read(folder / ROW)
        make_folder(folder)
        began, last = time.perf_counter(), self.run if number == 1 else self.out / "rounds" / str(number - 1) / "train"
        row = {
            "round": number,
            "beta": config.beta.at(number),
            **config.gather.gather(self.context, number, last, folder),
        }
        if not row["frames"]:
            raise PlaylearnError(
                f"round {number}: none of {row['attempted']} episodes reached its goal "
                f"({row['discarded']}); raise finish_steps, or give a rollout_suite that the expert can solve"
            )
        gathered = {past["round"]: past["frames"] for past in [*before, row] if past["round"]}
        train(
            self.trained_on(number, gathered, last), folder / "train", resume=(folder / "train/config.yaml").is_file()
        )
        row |= evaluated(self.evaluate(folder / "train", folder / "eval"))
        return self.done(folder, {**row, "seconds": round(time.perf_counter() - began, 1)})

    def rollout_spec(self, number: int, last: Path) -> RolloutSpec:
        """How the rollouts of a round are made."""
        config = self.config
        rule = InterventionRule(config.beta.at(number), config.switch_every, config.gate, config.policy_steps)
        return RolloutSpec(
            self.suite,
            self.trained(last),
            self.expert,
            rule,
            self.seed,
            config.finish_steps,
            config.success_hold_steps,
            record=config.encoder is None,
        )

    def trained(self, run: Path) -> TrainedRecipe:
        """The policy of a run as it acts in rollouts."""
        config, suite = self.config, self.suite
        n_action_steps = suite.n_action_steps if config.n_action_steps is None else config.n_action_steps
        guidance = suite.guidance if config.guidance is None else config.guidance
        return TrainedRecipe(run, config.goal, n_action_steps, guidance, encoder=config.encoder)

    def trained_on(self, number: int, gathered: Mapping[int, int], last: Path) -> TrainConfig:
        """The training of a round: the run's own, from the last policy. gathered: round -> steps of its store."""
        config, own = self.config, self.training.resolved()
        total, data = sum(gathered.values()), config.gather.data(self.context, own.data)
        kept = tuple(replace(source, fraction=(1 - config.fraction) * source.fraction) for source in own.extra_datasets)
        extra_datasets = tuple(
            DatasetSource(self.out / "rounds" / str(past) / "play", config.fraction * steps / total, data)
            for past, steps in gathered.items()
        )
        corrections = own.corrections
        if corrections is not None:  # made once, for the run
            corrections = replace(corrections, folder=corrections.folder or self.run / "corrections")
        perceived = own.perceived
        if config.encoder is not None:
            every = config.perceived_every
            perceived = PerceivedConfig(config.encoder, every, self.out / "perceived") if every else None
        return replace(
            own,
            policy=Policy.load(self.run / "policy").config,
            corrections=corrections,
            perceived=perceived,
            extra_datasets=kept + extra_datasets,
            init_from=last,
            trainable=("*",),
            steps=config.updates,
            max_minutes=None,
            lr=config.lr,
            warmup=config.warmup,
            val_every=config.updates,
            seed=derived_seed(_TRAINING, config.seed, number),
            cpu=config.cpu,
        )

    def evaluate(self, run: Path, out: Path) -> dict[str, Any]:
        """Evaluate a policy: the same episodes in every round."""
        config = self.config
        given = {"n_action_steps": config.n_action_steps, "guidance": config.guidance}
        return evaluate(
            config.suite or config.rollout_suite,
            run=run,
            encoder=config.encoder,
            goal=config.goal,
            out=out,
            episodes=config.eval_episodes,
            seed=self.eval_seed,
            workers=self.workers,
            references=False,
            overrides=[f"--{name}={value}" for name, value in given.items() if value is not None],
            expert=self.expert,
        )

    def done(self, folder: Path, row: dict[str, Any]) -> dict[str, Any]:
        """Save the row: from now on the round is done."""
        make_folder(folder)
        atomic_write(folder / ROW, json.dumps(row, indent=1).encode())
        print(line(row), file=sys.stderr, flush=True)
        return row

    def write(self, rows: list[dict[str, Any]]) -> dict[str, Any]:
        """All rows, and the last round's policy as that of `out`. Returns the contents of results.json."""
        last = self.out / "rounds" / str(rows[-1]["round"]) / "train"
        Policy.load(last / "policy").save(self.out / "policy")
        copy_config(last / "config.yaml", self.out / "config.yaml")
        atomic_write(self.out / "run.json", (last / "run.json").read_bytes())
        results = {
            "rounds": rows,
            "start": str(self.run),
            "eval_seed": self.eval_seed,
            "rollout_seed": self.seed,
            "config": to_dict(self.config),
            "versions": versions(),
            "git_revision": git_revision(),
        }
        atomic_write(self.out / "results.json", json.dumps(results, indent=1).encode())
        plot(rows, self.out / "plot.png")
        return results


def _claim(job: _Job, *, resume: bool) -> None:
    """Make `out` this job's; raises UsageError where it is something else's."""
    config, out = job.config, job.out
    folder = RunFolder(out, CONFIG, "DAgger run", adjustable=ADJUSTABLE, leftovers=(NOTE,))
    note, inputs = {"run": spelled_from(out)(job.run)}, job.inputs()
    if folder.begun(resume=resume):
        before = to_dict(load_config(DaggerConfig, folder.file), out)
        folder.check_same({**before, **_read(out / NOTE)}, {**to_dict(config, out), **note})
        folder.check_inputs(inputs)
    folder.keep_inputs(inputs)
    atomic_write(out / NOTE, json.dumps(note).encode())
    save_config(config, folder.file)


def _read(path: Path) -> dict[str, Any]:
    value: dict[str, Any] = json.loads(path.read_text())
    return value
