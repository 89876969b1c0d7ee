"""Learn a policy from a store of play: the root that builds every part and hands it over."""

import functools
import json
import math
import sys
import threading
import time
from collections.abc import Generator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from accelerate import Accelerator
from torch import Tensor, nn

from playlearn.batch import Batch
from playlearn.config import atomic_write, git_revision, save_config, to_dict, versions
from playlearn.corrections import Corrections, make_corrections
from playlearn.data import AugmentedDataset, Part, PlayDataset, build_sources, mix_datasets, statistics
from playlearn.data.split import val_mask
from playlearn.errors import NotLearnedError
from playlearn.executor import interruption_deferred
from playlearn.perceived import Perceived, make_perceived
from playlearn.policies import Policy, PolicySpec
from playlearn.policies.checkpoint import load_checkpoint, save_checkpoint
from playlearn.policies.ema import averaged
from playlearn.report.outcome import Outcome
from playlearn.report.progress import Pace, Progress
from playlearn.scenes import render_scenes, scene_sizes
from playlearn.store import Store, open_store
from playlearn.threads import limit
from playlearn.training.config import TrainConfig, check_out, flattened, stored_threads
from playlearn.training.examples import rendered_scenes, validation_batches, validation_scenes


def train(config: TrainConfig, out: Path, *, resume: bool = False) -> None:
    """Train and leave in `out`: config.yaml, run.json, metrics.jsonl, checkpoint/, policy/ (for Policy.load).

    The batch and all noise of an update depend on (seed, update) only. A resumed run therefore ends in exactly the
    tensors of an unbroken one, on the same machine and device and without max_minutes; it uses as many threads.
    The outcome is printed on stderr and kept in run.json, as `outcome`.

    Raises:
        NotLearnedError: a fresh policy's held-out loss is no better than before the first update; all is saved.
        UsageError: `out` is taken (or, with resume, is no run of this config); the store lacks a camera.
        StoreError: the store is missing or too small.
        KeyboardInterrupt: on Ctrl-C, after the current update and a checkpoint.
    """
    config = config.resolved()
    check_out(config, out, resume=resume)
    threads = stored_threads(config, out, resume=resume)
    limit(threads)
    store = open_store(config.store)
    run = _Run(config, store, out)
    if resume and run.checkpoint.is_file():
        run.load()
    elif run.accelerator.is_main_process:
        run.describe()
    run.make_corrections()
    run.render_scenes()
    run.perceive()
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
        self.data = config.data.build(store, "train", config.seed)
        self.own: Part = self.data  # what is shown of it
        self.accelerator = Accelerator(
            mixed_precision="bf16" if config.precision == "bf16" else "no",
            cpu=config.cpu,
            log_with=config.tracker,
            project_dir=str(out),
        )
        self.val = validation_batches(config, store)
        changes = config.data.target == "next_settled_delta"
        self.spec = PolicySpec(
            state_names=store.spec.state_names,
            achieved_names=store.spec.achieved_names,
            action_names=store.spec.achieved_names if changes else store.spec.action_names,
            fps=store.spec.fps,
            cameras={camera: (int(h), int(w)) for camera, (h, w) in self._cameras().items()},
            controller=store.meta(0).controller,
            predicts=config.data.target,
            quantities=store.spec.quantities,
        )
        self.sources = build_sources(self.data, config.extra_datasets, config.seed)
        self.extra: list[tuple[Part, float]] = [*self.sources]
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
        self.paces = {"update": Pace(warmup=2), "evaluate": Pace(), "save": Pace()}

    def _initial_policy(self) -> Policy:
        """The policy before the first update: fresh, or that of `init_from`."""
        config = self.config
        if config.init_from is None:
            policy = config.policy.build(self.spec, statistics(self.data), config.seed)
            policy.fit_action_statistics(torch.as_tensor(self.data.targets()))
            return policy
        begun = Policy.load(config.init_from / "policy")
        begun.check(self.spec, self.spec.cameras)
        if begun.config == config.policy:
            return begun.train()
        policy = config.policy.build(self.spec, None, config.seed)
        policy.load_from(begun, config.init_from)
        return policy

    def _cameras(self) -> Mapping[str, tuple[int, int]]:
        """Camera -> (height, width) of the images to learn from."""
        encoder, cameras = self.config.policy.encoder, self.store.cameras()
        if self.config.scenes is None:
            return cameras
        return {**cameras, **scene_sizes(self.store, encoder.observation_cameras)}

    def render_scenes(self) -> None:
        """Render the scenes that the config asks for, and train on them."""
        config, scenes = self.config, self.config.scenes
        if scenes is None:
            return
        folder, out = scenes.folder or self.out / "scenes", val_mask(self.store, config.data.val_fraction)
        if self.accelerator.is_main_process:
            render_scenes(scenes, self.store, out, config.policy.encoder.observation_cameras, folder)
        self.accelerator.wait_for_everyone()
        numbers, actions = self.store.indices(), len(self.spec.action_names)
        drawn = rendered_scenes(config, folder, numbers[~out], actions)
        if scenes.fraction < 1:
            self.extra = [(drawn, scenes.fraction), *self.extra]
            return
        self.own = drawn
        if out.any():
            self.val = validation_scenes(config, rendered_scenes(config, folder, numbers[out], actions))

    def make_corrections(self) -> None:
        """Make the corrections that the config asks for, and train on them."""
        corrections = self.config.corrections
        if corrections is None:
            return
        folder = corrections.folder or self.out / "corrections"
        if self.accelerator.is_main_process:
            make_corrections(corrections, self.store, self.data.episodes, self.config.data.cameras, folder)
        self.accelerator.wait_for_everyone()
        self.own = AugmentedDataset(self.data, Corrections(folder, self.data, corrections.fraction))

    def perceive(self) -> None:
        """Train on play as the config's image encoder perceives it."""
        perceived = self.config.perceived
        if perceived is None:
            return
        run = perceived.encoder
        self.policy.behind(Policy.load(run / "policy"), run)  # raises where the two do not fit together
        folder = perceived.folder or self.out / "perceived"

        def augmented(dataset: PlayDataset, number: int) -> Part:
            if self.accelerator.is_main_process:
                make_perceived(perceived, dataset.store, folder / str(number))
            self.accelerator.wait_for_everyone()
            return AugmentedDataset(dataset, Perceived(folder / str(number), dataset))

        self.own = augmented(self.data, 0)
        self.extra = [(augmented(source, k), fraction) for k, (source, fraction) in enumerate(self.sources, 1)]
        self.val = validation_batches(self.config, self.store, functools.partial(Perceived, folder / "0"))

    def loop(self, interrupted: threading.Event, progress: Progress) -> None:
        config, accelerator = self.config, self.accelerator
        if config.tracker:
            accelerator.init_trackers("playlearn", config=flattened(to_dict(config)))
        rank, ranks = accelerator.process_index, accelerator.num_processes
        examples = mix_datasets(self.own, self.extra)
        batches = cast(Generator[Batch], examples.batches(config.batch_size, self.step, rank, ranks))
        window = _Window()
        if self.val and self.step == 0:
            progress.say(self.validate())
        with closing(batches):
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
                if self.val and (self.step % config.val_every == 0 or last):
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
        norm = accelerator.clip_grad_norm_(self.model.parameters(), config.grad_clip)
        self.optimizer.step()
        self.ema.update_parameters(self.policy)
        return {"loss": loss.detach(), **metrics, "grad_norm": norm}

    @torch.no_grad()
    def evaluate(self) -> dict[str, float]:
        """Metrics of the averaged weights on held-out play.

        action_error: mean over the chunk and its numbers, each as a share of its spread in the data (see `scaled`), so
        that a small unit counts like a large one.
        """
        policy = cast(Policy, self.ema.module)
        policy.eval()
        window = _Window()
        for number, batch in enumerate(self.val):
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
        line = self.log("val", self.evaluate())
        self.paces["evaluate"].add(time.monotonic() - began)
        return line

    def progress(self) -> float:
        """The fraction of the run that is done: of updates or of minutes, whichever is more."""
        fraction = self.step / self.config.steps
        if self.config.max_minutes is not None:
            fraction = max(fraction, self.seconds / 60 / self.config.max_minutes)
        return min(fraction, 1.0)

    def pace(self, window: "_Window") -> str:
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
            with self._metrics.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"step": self.step, "seconds": round(self.seconds, 2), **named}) + "\n")
        if self.config.tracker:
            self.accelerator.log(named, step=self.step)
        return f"step {self.step}: " + " ".join(f"{name} {value:.4g}" for name, value in named.items())

    def save(self) -> None:
        """The checkpoint, and the averaged policy beside it."""
        began = time.monotonic()
        if self.accelerator.is_main_process:
            note = {"step": self.step, "seconds": self.seconds}
            save_checkpoint(self.checkpoint, self._modules, self.optimizer.optimizer, note)
            cast(Policy, self.ema.module).save(self.out / "policy")
        self.paces["save"].add(time.monotonic() - began)

    def load(self) -> None:
        note = load_checkpoint(self.checkpoint, self._modules, self.optimizer.optimizer)
        self.step, self.seconds = note["step"], note["seconds"]
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
        for line in outcome.summary():
            print(f"{self.out}: {line}", file=sys.stderr, flush=True)
        complaint = outcome.complaint()
        # A run that starts from a trained policy may end where that was.
        if complaint is not None and self.config.init_from is None:
            raise NotLearnedError(f"{self.out}: {complaint}; the checkpoint and the policy are kept")

    def describe(self) -> None:
        """Save what is run, before it runs."""
        self.out.mkdir(parents=True, exist_ok=True)
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
        }
        atomic_write(self.out / "run.json", json.dumps(record, indent=2, default=dict).encode())

    @property
    def _metrics(self) -> Path:
        return self.out / "metrics.jsonl"

    @property
    def _modules(self) -> dict[str, nn.Module]:
        return {"policy": self.policy, "ema": self.ema}


class _Window:
    """Running means of metrics, kept on the device until they are asked for."""

    def __init__(self) -> None:
        self.sums: dict[str, Tensor] = {}
        self.count = 0
        self.latest: dict[str, float] = {}

    def add(self, metrics: Mapping[str, Tensor]) -> None:
        for name, value in metrics.items():
            self.sums[name] = self.sums[name] + value if name in self.sums else value
        self.count += 1

    def means(self) -> dict[str, float]:
        """Since the last call."""
        self.latest = {name: float(value) / self.count for name, value in self.sums.items()}
        self.sums, self.count = {}, 0
        return self.latest


def _cosine(fraction: float) -> float:
    return 0.5 * (1 + math.cos(math.pi * fraction))


def _generator(*numbers: int) -> torch.Generator:
    """A generator that depends on these numbers only."""
    seed = np.random.SeedSequence([number & 0xFFFFFFFF for number in numbers]).generate_state(1, np.uint64)[0]
    return torch.Generator().manual_seed(int(seed) & 0x7FFFFFFFFFFFFFFF)
