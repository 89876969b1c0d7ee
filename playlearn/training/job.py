"""Learn a policy from a store of play: the root that builds every part and hands it over."""

import functools
import json
import math
import os
import sys
import threading
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from accelerate import Accelerator
from torch import Tensor, nn

from playlearn.batch import Batch
from playlearn.config import append_line, atomic_write, git_revision, held, save_config, to_dict, versions
from playlearn.data import statistics
from playlearn.data.projection import hand_projection
from playlearn.errors import NotLearnedError, TrainingDiverged
from playlearn.executor import interruption_deferred
from playlearn.policies import Policy, PolicySpec
from playlearn.policies.checkpoint import first_not_finite, load_checkpoint, save_checkpoint
from playlearn.policies.ema import averaged
from playlearn.privileges import KEY as PRIVILEGED
from playlearn.report.events import events_picture
from playlearn.report.outcome import Outcome
from playlearn.report.progress import Pace, Progress
from playlearn.store import Store, open_store
from playlearn.threads import limit
from playlearn.training.config import TrainConfig, check_out, flattened, run_folder, stored_threads, training_inputs
from playlearn.training.divergence import reason
from playlearn.training.examples import RunExamples, store_remarks, unsettled_remarks
from playlearn.training.privileged import check_start, privileged
from playlearn.training.window import Window


def train(config: TrainConfig, out: Path, *, resume: bool = False) -> None:
    """Train and leave in `out`: config.yaml, run.json, metrics.jsonl, checkpoint/, policy/ (for Policy.load).

    The batch and all noise of an update depend on (seed, update) only. A resumed run therefore ends in exactly the
    tensors of an unbroken one, on the same machine and device and without max_minutes; it uses as many threads.
    The outcome is printed on stderr and kept in run.json, as `outcome`.

    Raises:
        TrainingDiverged: a loss, a gradient or a weight is not finite; what was saved before is kept.
        NotLearnedError: a fresh policy's held-out loss is no better than before the first update; all is saved.
        UsageError: `out` is taken (or, with resume, is no run of this config on these data); the store lacks a camera,
            or a goal.
        StoreError: the store is missing or too small, or holds a number that is not finite.
        BusyError: another process trains there.
        DiskError: the disk is full; the last checkpoint and policy are whole.
        KeyboardInterrupt: on Ctrl-C, after the current update and a checkpoint.
    """
    config = config.resolved()
    with held(out) if _is_first() else nullcontext():
        check_out(config, out, resume=resume)
        _train(config, out, resume=resume)


def _is_first() -> bool:
    """Whether this process is the one that writes, of those that a launcher started."""
    return os.environ.get("RANK", "0") == "0"


def _train(config: TrainConfig, out: Path, *, resume: bool) -> None:
    threads = stored_threads(config, out, resume=resume)
    limit(threads)
    store = open_store(config.store, blind=config.blind)
    where = store.name() + (" (blind)" if config.blind else "")
    config.policy.encoder.check_goal(store.spec, where)  # before anything slow
    check_start(config)
    inputs = training_inputs(config, store)
    if resume:
        run_folder(out).check_inputs(inputs)
    run = _Run(config, store, out)
    if resume and run.checkpoint.is_file():
        run.load()
    elif run.accelerator.is_main_process:
        run_folder(out).keep_inputs(inputs)
        run.describe()
    run.examples.make(run.policy)
    limit(threads)  # the makers of these may have set others
    with interruption_deferred() as interrupted, Progress("train", 100.0, "%", 100 * run.progress()) as progress:
        run.loop(interrupted, progress)
    if run.accelerator.is_main_process:
        run.conclude()


class _Run:
    """Everything that lives as long as the training."""

    def __init__(self, config: TrainConfig, store: Store, out: Path) -> None:
        self.config, self.store, self.out = config, store, out
        self.checkpoint = out / "checkpoint" / "last.safetensors"
        self.accelerator = Accelerator(
            mixed_precision="bf16" if config.precision == "bf16" else "no",
            cpu=config.cpu,
            log_with=config.tracker,
            project_dir=str(out),
        )
        self.examples = RunExamples(config, store, out, self.accelerator)
        self.data = self.examples.data
        changes = config.data.target == "next_settled_delta"
        self.spec = PolicySpec(
            state_names=store.spec.state_names,
            achieved_names=store.spec.achieved_names,
            action_names=store.spec.achieved_names if changes else store.spec.action_names,
            fps=store.spec.fps,
            cameras={camera: (int(h), int(w)) for camera, (h, w) in self.examples.cameras().items()},
            controller=store.meta(0).controller,
            predicts=config.data.target,
            quantities=store.spec.quantities,
        )
        policy = self._initial_policy()
        policy.to(self.accelerator.device)
        learned = policy.freeze_except(config.trainable)
        self.ema = averaged(policy, config.ema_decay)
        matrices = [parameter for parameter in learned if parameter.ndim > 1]
        vectors = [parameter for parameter in learned if parameter.ndim <= 1]
        decays: list[dict[str, Any]] = [{"params": matrices}, {"params": vectors, "weight_decay": 0.0}]
        optimizer = torch.optim.AdamW(decays, lr=config.lr, weight_decay=config.weight_decay, fused=True)
        self.policy = policy
        self.model: nn.Module
        self.model, self.optimizer = self.accelerator.prepare(policy, optimizer)
        self.step, self.seconds = 0, 0.0
        self.saved: int | None = None  # the step of the checkpoint
        self.paces = {"update": Pace(warmup=2), "evaluate": Pace(), "save": Pace()}

    def _initial_policy(self) -> Policy:
        """The policy before the first update: fresh, or that of `init_from`."""
        config = self.config
        if config.init_from is None:
            policy = config.policy.build(self.spec, statistics(self.data), config.seed)
            policy.fit_action_statistics(torch.as_tensor(self.data.targets()))
            policy.encoder.calibrate(functools.partial(hand_projection, self.data, policy.normalizer))
            return policy
        begun = Policy.load(config.init_from / "policy")
        begun.check(self.spec, self.spec.cameras)
        if begun.config == config.policy:
            return begun.train()
        policy = config.policy.build(self.spec, None, config.seed)
        policy.load_from(begun, config.init_from)
        return policy

    def loop(self, interrupted: threading.Event, progress: Progress) -> None:
        config, accelerator = self.config, self.accelerator
        if config.tracker:
            accelerator.init_trackers("playlearn", config=flattened(to_dict(config)))
        rank, ranks = accelerator.process_index, accelerator.num_processes
        batches = self.examples.mixed().batches(config.batch_size, self.step, rank, ranks)
        window = Window()
        if self.examples.val and self.step == 0:
            progress.say(self.validate())
        with closing(cast(Generator[Batch], batches)):
            while not self.finished():
                began = time.monotonic()
                window.add(self.update(next(batches)))
                self.step += 1
                took = time.monotonic() - began
                self.seconds += took  # of updates only, so that `last` is known to be the last
                self.paces["update"].add(took)
                last = self.finished()
                if self.step % config.log_every == 0 or last:
                    self.log("train", {**window.means(), "lr": self.optimizer.param_groups[0]["lr"]})
                if self.examples.val and (self.step % config.val_every == 0 or last):
                    progress.say(self.validate())
                if self.step % config.checkpoint_every == 0 or last or interrupted.is_set():
                    self.save()
                progress.to(100 * self.progress(), self.pace(window), left=self.left())
                if interrupted.is_set():
                    raise KeyboardInterrupt
        if config.tracker:
            accelerator.end_training()

    def update(self, batch: Batch) -> dict[str, Tensor]:
        config, accelerator = self.config, self.accelerator
        for group in self.optimizer.param_groups:
            group["lr"] = config.lr * min(1, (self.step + 1) / max(config.warmup, 1)) * _cosine(self.progress())
        generator = _generator(config.seed, self.step, accelerator.process_index)
        with accelerator.autocast():
            loss, metrics = self.model(batch.to(accelerator.device), generator, self.step)
        self.optimizer.zero_grad()
        accelerator.backward(loss)
        loss, norm = loss.detach(), accelerator.clip_grad_norm_(self.model.parameters(), config.grad_clip)
        if not bool(torch.isfinite(loss + norm)):  # before the step, so that no weight is touched
            raise self.diverged(f"loss is {float(loss):g}, the norm of its gradient {float(norm):g}", [batch], made=1)
        self.optimizer.step()
        self.ema.update_parameters(self.policy)
        return {"loss": loss, **metrics, "grad_norm": norm}

    @torch.no_grad()
    def evaluate(self) -> dict[str, float]:
        """Metrics of the averaged weights on held-out play.

        action_error: mean over the chunk and its numbers, each as a share of its spread in the data (see `scaled`), so
        that a small unit counts like a large one.
        """
        policy = cast(Policy, self.ema.module)
        policy.eval()
        window = Window()
        for number, batch in enumerate(self.examples.val):
            generator = _generator(self.config.seed, number, -1)
            loss, metrics = policy.loss(batch.to(self.accelerator.device), generator)
            if policy.acting_learns:
                error = policy.action_error(policy.act(batch, generator), batch.action)[batch.action_mask].mean()
                metrics = {**metrics, "action_error": error}
            window.add({"loss": loss, **metrics})
        return window.means()

    def validate(self) -> str:
        """Evaluate on held-out play and log it; returns the line to show."""
        began = time.monotonic()
        metrics = self.evaluate()
        if not math.isfinite(metrics["loss"]):
            raise self.diverged(f"held-out loss is {metrics['loss']:g}", self.examples.val)
        line = self.log("val", metrics)
        self.paces["evaluate"].add(time.monotonic() - began)
        return line

    def progress(self) -> float:
        """The fraction of the run that is done: of updates or of minutes, whichever is more."""
        fraction = self.step / self.config.steps
        if self.config.max_minutes is not None:
            fraction = max(fraction, self.seconds / 60 / self.config.max_minutes)
        return min(fraction, 1.0)

    def pace(self, window: "Window") -> str:
        """What is shown beside the progress bar."""
        loss = f", loss {window.latest['loss']:.4g}" if "loss" in window.latest else ""
        return f"step {self.step}, {1 / max(self.paces['update'].seconds(), 1e-9):.1f} updates/s{loss}"

    def left(self) -> float:
        """Seconds until the end, from what updates, evaluations and checkpoints took lately."""
        config, pace = self.config, max(self.paces["update"].seconds(), 1e-9)
        seconds = (config.steps - self.step) * pace
        if config.max_minutes is not None:
            seconds = min(seconds, 60 * config.max_minutes - self.seconds)
        ahead = math.ceil(max(seconds, 0.0) / pace)
        often = {"evaluate": config.val_every, "save": config.checkpoint_every}
        for kind, every in often.items():
            each = self.paces[kind].seconds()  # NaN while there was none
            if not math.isnan(each):
                # The last update is one of them, whichever its number.
                seconds += each * ((self.step + ahead - 1) // every - self.step // every + (ahead > 0))
        return max(seconds, 0.0)

    def finished(self) -> bool:
        return self.progress() >= 1.0

    def log(self, kind: str, values: Mapping[str, float]) -> str:
        """Into metrics.jsonl and the tracker; returns the line to show."""
        named = {f"{kind}/{name}": value for name, value in values.items()}
        if self.accelerator.is_main_process:
            append_line(self._metrics, json.dumps({"step": self.step, "seconds": round(self.seconds, 2), **named}))
        if self.config.tracker:
            self.accelerator.log(named, step=self.step)
        return f"step {self.step}: " + " ".join(f"{name} {value:.4g}" for name, value in named.items())

    def save(self) -> None:
        """The checkpoint, and the averaged policy beside it; raises TrainingDiverged where a weight is not finite."""
        began = time.monotonic()
        for module in self._modules.values():
            wrong = first_not_finite(module)
            if wrong is not None:
                raise self.diverged(f"weight {wrong} is not finite", [])
        if self.accelerator.is_main_process:
            note = {"step": self.step, "seconds": self.seconds}
            save_checkpoint(self.checkpoint, self._modules, self.optimizer.optimizer, note)
            cast(Policy, self.ema.module).save(self.out / "policy")
        self.saved = self.step
        self.paces["save"].add(time.monotonic() - began)

    def diverged(self, what: str, batches: Sequence[Batch], made: int = 0) -> TrainingDiverged:
        """batches: that it was found in. made: updates of this step that were tried."""
        kept = (
            "nothing was saved yet"
            if self.saved is None
            else f"checkpoint/ and policy/ stay those of step {self.saved}"
        )
        why = reason(self.config, self.spec, batches)
        return TrainingDiverged(f"{self.out}: training diverged at step {self.step + made}: its {what}; {why}; {kept}")

    def load(self) -> None:
        note = load_checkpoint(self.checkpoint, self._modules, self.optimizer.optimizer)
        self.step, self.seconds, self.saved = note["step"], note["seconds"], note["step"]
        if self.accelerator.is_main_process and self._metrics.exists():
            lines = self._metrics.read_text(encoding="utf-8").splitlines(keepends=True)
            kept = [line for line in lines if line.endswith("\n") and json.loads(line)["step"] <= self.step]
            atomic_write(self._metrics, "".join(kept).encode())

    def conclude(self) -> None:
        """Print and save the outcome. Raises NotLearnedError where a fresh policy learned nothing."""
        lines = self._metrics.read_text(encoding="utf-8").splitlines()
        outcome = Outcome.of(map(json.loads, lines), self.step, self.config.steps, self.seconds)
        record = json.loads((self.out / "run.json").read_text(encoding="utf-8"))
        atomic_write(self.out / "run.json", json.dumps({**record, "outcome": outcome.numbers()}, indent=2).encode())
        picture = events_picture(cast(Policy, self.ema.module), self.examples.val[0]) if self.examples.val else None
        if picture is not None:
            atomic_write(self.out / "events.png", picture)
        for line in outcome.summary():
            print(f"{self.out}: {line}", file=sys.stderr, flush=True)
        complaint = outcome.complaint()
        # A run that starts from a trained policy may end where that was.
        if complaint is not None and self.config.init_from is None:
            raise NotLearnedError(f"{self.out}: {complaint}; the checkpoint and the policy are kept")

    def describe(self) -> None:
        """Save what is run, before it runs; say what of the store is not read, or is read otherwise than recorded."""
        for remark in (*store_remarks(self.config, self.store), *unsettled_remarks(self.data)):
            print(f"{self.store.name()}: {remark}", file=sys.stderr, flush=True)
        self._metrics.unlink(missing_ok=True)  # of a run that left no checkpoint
        save_config(self.config, self.out / "config.yaml")
        record = {
            "seed": self.config.seed,
            "versions": versions(),
            "git_revision": git_revision(),
            "device": str(self.accelerator.device),
            "processes": self.accelerator.num_processes,
            "threads": torch.get_num_threads(),
            "parameters": sum(parameter.numel() for parameter in self.policy.parameters()),
            "examples": len(self.data),
            "store": {"path": self.store.name(), "episodes": len(self.store)},
            "environment": dict(self.store.spec.environment),
            PRIVILEGED: privileged(self.config, self.store).to_dict(),
        }
        atomic_write(self.out / "run.json", json.dumps(record, indent=2, default=dict).encode())

    @property
    def _metrics(self) -> Path:
        return self.out / "metrics.jsonl"

    @property
    def _modules(self) -> dict[str, nn.Module]:
        return {"policy": self.policy, "ema": self.ema}


def _cosine(fraction: float) -> float:
    return 0.5 * (1 + math.cos(math.pi * fraction))


def _generator(*numbers: int) -> torch.Generator:
    """A generator that depends on these numbers only."""
    seed = np.random.SeedSequence([number & 0xFFFFFFFF for number in numbers]).generate_state(1, np.uint64)[0]
    return torch.Generator().manual_seed(int(seed) & 0x7FFFFFFFFFFFFFFF)
