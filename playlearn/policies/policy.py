"""A goal-conditioned policy: encoder, trunk and head over a normalizer."""

import fnmatch
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import chain
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save
from torch import Tensor, nn

from playlearn.config import atomic_write, from_dict, to_dict
from playlearn.errors import CheckpointError, PlaylearnError, UsageError
from playlearn.policies.encoders import EncoderConfig, StateConfig
from playlearn.policies.heads import DeterministicConfig, Generators, Guidance, HeadConfig
from playlearn.policies.inputs import Inputs, Labeled, Named, Observed, PolicySpec
from playlearn.policies.normalize import Normalizer, Statistics, pooled
from playlearn.policies.trunks import TransformerConfig, TrunkConfig

WEIGHTS, DESCRIPTION = "policy.safetensors", "policy.json"
FORMAT = 1
_NOTHING = torch.empty(0)
_UNTOLD = "this policy cannot tell where things are: train it from images with encoder.state_supervision above 0"


@dataclass(frozen=True)
class PolicyConfig:
    """history: observations it sees, the present one included. chunk: H, actions predicted at once.

    goal_dropout: share of training examples whose goal is withheld, which makes guidance possible.
    history_dropout: share whose past observations are hidden, all but the present one; proprio_dropout: share
    whose robot state is withheld (the mean of the data is shown). Both against copying: a policy that can
    tell its next action from its last ones, or from how the arm moves, need not look at the goal
    (de Haan et al. 2019).

    Raises:
        UsageError: a share does not lie between 0 and 1.
    """

    encoder: EncoderConfig = field(default_factory=StateConfig)
    trunk: TrunkConfig = field(default_factory=TransformerConfig)
    head: HeadConfig = field(default_factory=DeterministicConfig)
    history: int = 1
    chunk: int = 8
    goal_dropout: float = 0.1
    history_dropout: float = 0.0
    proprio_dropout: float = 0.0

    def __post_init__(self) -> None:
        for name in ("goal_dropout", "history_dropout", "proprio_dropout"):
            if not 0 <= getattr(self, name) <= 1:
                raise UsageError(f"policy.{name} is a share of the examples, 0 to 1: got {getattr(self, name)}")

    def build(
        self, spec: PolicySpec, statistics: Mapping[str, Statistics] | None, seed: int, *, fetch: bool = True
    ) -> "Policy":
        """A fresh policy; the seed decides its weights, and global random state is left as it was.

        statistics: of `state`, `achieved` and `action`; None for a policy whose weights are loaded next.

        Raises:
            UsageError: the config asks for a camera or goal dimension that `spec` does not have.
        """
        encoder = self.encoder.complete() if fetch else self.encoder
        for camera in (*encoder.observation_cameras, *encoder.goal_cameras):
            if camera not in spec.cameras:
                raise UsageError(f"the policy's encoder wants camera {camera!r}, there is {sorted(spec.cameras)}")
        with torch.random.fork_rng(devices=[]):
            torch.random.manual_seed(seed)
            return Policy(replace(self, encoder=encoder), spec, statistics, fetch=fetch)


class Policy(nn.Module):
    """Goal-conditioned chunks of actions. Built by `PolicyConfig.build` or `Policy.load`."""

    def __init__(
        self, config: PolicyConfig, spec: PolicySpec, statistics: Mapping[str, Statistics] | None, *, fetch: bool
    ) -> None:
        super().__init__()
        self.config, self.spec = config, spec
        widths = {
            "state": len(spec.state_names),
            "achieved": len(spec.achieved_names),
            "action": len(spec.action_names),
        }
        if statistics is None:
            self.normalizer = Normalizer.identity(widths)
        else:
            names = {"state": spec.state_names, "achieved": spec.achieved_names}
            # one that is hardly used must not count as much as the others; of what changes, all counts alike
            share = {} if spec.clipped else {"action_share": 0.0}
            self.normalizer = Normalizer(pooled(statistics, names), **share)
        width = config.trunk.width
        self.encoder = config.encoder.build(spec, width, fetch=fetch)
        self.trunk = config.trunk.build(self.encoder.goal_tokens + config.history * self.encoder.step_tokens)
        self.head = config.head.build(width, config.chunk, len(spec.action_names))

    @property
    def cameras(self) -> tuple[str, ...]:
        """The cameras it must see, those of the goal included."""
        encoder = self.config.encoder
        return tuple(dict.fromkeys((*encoder.observation_cameras, *encoder.goal_cameras)))

    @property
    def device(self) -> torch.device:
        return next(self.parameters()).device

    def fit_action_statistics(self, actions: Tensor) -> None:
        """Let the head look at the training data's actions (n, A), before the first update."""
        self.head.fit_action_statistics(self.normalizer.normalize("action", actions).unsqueeze(1))

    def load_from(self, other: "Policy", source: Path) -> None:
        """Take over all of another policy, which may differ in its encoder alone; source: its run.

        Raises:
            UsageError: it differs in more, or something of its encoder has no place here.
        """
        own, given = self.state_dict(), other.state_dict()
        apart = {entry.name for entry in fields(PolicyConfig) if entry.name != "encoder"}
        apart = {name for name in apart if getattr(self.config, name) != getattr(other.config, name)}
        placed = all(own.get(name, _NOTHING).shape == value.shape for name, value in given.items())
        if not placed or self.config.encoder.goal_names != other.config.encoder.goal_names:
            apart.add("encoder")
        if self.spec.predicts != other.spec.predicts:
            apart.add("sort of labels")
        if apart:
            raise UsageError(
                f"init: the policy of {source} has another {' and '.join(sorted(apart))}: give its own `policy` block; "
                "eyes for a policy of states need its `hidden`, and use_estimated_state: true"
            )
        self.load_state_dict(own | given)

    def behind(self, seeing: "Policy", source: Path) -> "Policy":
        """A state policy, this one, behind the image encoder of another one, whose run is `source`, ready to act.

        Raises:
            UsageError: the two do not fit together, or their numbers are scaled differently.
        """
        joined = seeing.config.build(seeing.spec, None, seed=0, fetch=False)
        joined.load_state_dict(seeing.state_dict())
        mine, its = (part.normalizer.state_dict() for part in (self, seeing))
        if any(not torch.equal(mine[name], its[name]) for name in mine):
            raise UsageError(f"the image encoder of {source} learned from other play: train both on the same store")
        joined.load_from(self, source)
        return joined.to(self.device).eval()

    def freeze_except(self, patterns: Sequence[str]) -> list[nn.Parameter]:
        """The parameters that some shell-style pattern names; all others are frozen.

        Raises:
            UsageError: a pattern names none.
        """
        named = dict(self.named_parameters())
        for pattern in patterns:
            if not fnmatch.filter(named, pattern):
                there = sorted({".".join(name.split(".")[:2]) + ".*" for name in named})
                raise UsageError(f"learn: {pattern!r} names no parameter; there are {', '.join(there)}")
        for name, parameter in named.items():
            if not any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns):
                parameter.requires_grad_(False)
        return [parameter for parameter in named.values() if parameter.requires_grad]

    def forward(
        self, batch: Labeled, generator: torch.Generator, updates: int | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Scalar training loss and its parts; all randomness (dropout, augmentation, noise) from `generator`.

        updates: made so far, for what warms up (None: after every warm-up).
        """
        config, normal = self.config, self._normalized(batch)
        if not self.acting_learns:
            # no gradient of the head's loss would reach anything: only what is learned beside it is computed
            normal = _with_keypoints(normal, batch)
            return _summed(self.encoder.auxiliary(self.encoder.perceive(normal, generator), normal))
        keep = self._kept(config.goal_dropout, batch, generator)
        # at 0 nothing is drawn, so that what is drawn next does not depend on an option that is not used
        if config.history_dropout > 0:
            past = normal.history_mask.clone()
            past[:, :-1] &= self._kept(config.history_dropout, batch, generator)[:, None]
            normal = replace(normal, history_mask=past)
        if config.proprio_dropout > 0:
            felt = self._kept(config.proprio_dropout, batch, generator)
            normal = replace(normal, state=normal.state * felt[:, None, None])
        return self._loss(batch, normal, keep, generator, augment=generator, updates=updates)

    @property
    def acting_learns(self) -> bool:
        """Whether some parameter that the head's loss teaches is trained; the image encoder alone may be."""
        taught = chain(self.encoder.token_parameters(), self.trunk.parameters(), self.head.parameters())
        return any(parameter.requires_grad for parameter in taught)

    def loss(self, batch: Labeled, generator: torch.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        """The same with nothing withheld and no augmentation: what held-out play is judged by."""
        normal = self._normalized(batch)
        if not self.acting_learns:
            normal = _with_keypoints(normal, batch)
            return _summed(self.encoder.auxiliary(self.encoder.perceive(normal), normal))
        keep = torch.ones(len(batch.state), dtype=torch.bool, device=self.device)
        return self._loss(batch, normal, keep, generator, augment=None)

    @torch.inference_mode()
    def act(
        self, inputs: Observed, generator: Generators, guidance: float | None = None, *, mode: bool = False
    ) -> Tensor:
        """(B, H, A) float32 on the CPU, in units of the environment; actions clipped to [-1, 1].

        inputs: on any device. generator: one, or one a row, which makes a row independent of the others.
        guidance: weight of the goal, None for the plain prediction (a weight of 1). mode: the head's mode
        rather than a sample.
        """
        normal = self._normalized(inputs)
        batch, weight = len(normal.state), 1.0 if guidance is None else guidance
        shown = torch.full((batch,), weight != 0, device=self.device)
        features = self._features(normal, shown, None)[0]
        guide = None
        if weight not in (0.0, 1.0):
            guide = Guidance(self._features(normal, ~shown, None)[0], weight)
        chunk = self.head.mode(features, guide) if mode else self.head.sample(features, generator, guide)
        chunk = self.normalizer.restore("action", chunk)
        return (chunk.clamp(-1, 1) if self.spec.clipped else chunk).float().cpu()

    @torch.inference_mode()
    def estimate_achieved(self, inputs: Observed) -> Tensor:
        """(B, G) float32 on the CPU: what is achieved now, read from its images where it looks through cameras.

        Raises:
            UsageError: it looks through cameras and was not taught to tell (`encoder.state_supervision`).
        """
        if not self.config.encoder.observation_cameras:
            return inputs.achieved[:, -1].float().cpu()
        keep = torch.zeros(len(inputs.state), dtype=torch.bool, device=self.device)
        observed = self.encoder(self._normalized(inputs), keep, None).observed
        if observed is None:
            raise UsageError(_UNTOLD)
        return self.normalizer.restore("achieved", observed[:, -1]).float().cpu()

    @torch.inference_mode()
    def perceived(self, inputs: Observed) -> tuple[Tensor, Tensor]:
        """(B, T, G) and (B, G) float32 on the CPU: what is achieved, and in the goal, as its images tell.

        Raises:
            UsageError: it was not taught to tell either from images (`encoder.state_supervision`).
        """
        tokens = self.encoder.perceive(self._normalized(inputs))
        if tokens.observed is None or tokens.wanted is None or "image" not in self.config.encoder.goals:
            raise UsageError(_UNTOLD)
        restore = self.normalizer.restore
        return restore("achieved", tokens.observed).float().cpu(), restore("achieved", tokens.wanted).float().cpu()

    def check(self, spec: Named, cameras: Mapping[str, tuple[int, int]]) -> None:
        """Refuse an environment it was not trained for. cameras: name -> (height, width) there.

        Raises:
            CheckpointError: names, fps or cameras differ; the message says which.
        """
        self.spec.check(spec, cameras, self.cameras)

    def save(self, path: Path) -> None:
        """Write `policy.json` and `policy.safetensors` into the folder, each atomically."""
        path.mkdir(parents=True, exist_ok=True)
        description = {"format": FORMAT, "config": to_dict(self.config), "spec": asdict(self.spec)}
        atomic_write(path / DESCRIPTION, json.dumps(description, indent=2).encode())
        atomic_write(path / WEIGHTS, save({name: value.contiguous() for name, value in self.state_dict().items()}))

    @classmethod
    def load(cls, path: Path, device: str | torch.device = "cpu") -> "Policy":
        """The policy that `save` wrote there, ready to act.

        Raises:
            CheckpointError: files are missing, broken, or of another version.
        """
        for name in (DESCRIPTION, WEIGHTS):
            if not (path / name).is_file():
                raise CheckpointError(f"no policy at {path}: {name} is missing; `playlearn train` writes RUN/policy")
        try:
            description = json.loads((path / DESCRIPTION).read_text())
            if description.get("format") != FORMAT:
                raise CheckpointError(f"{path} is of format {description.get('format')}, this version reads {FORMAT}")
            policy = from_dict(PolicyConfig, description["config"]).build(
                spec_from_dict(description["spec"]), None, seed=0, fetch=False
            )
            policy.load_state_dict(load_file(path / WEIGHTS))
        except PlaylearnError as error:
            raise CheckpointError(f"the policy at {path} cannot be read: {error}") from error
        except Exception as error:  # a torn file shows itself as any of a dozen types
            raise CheckpointError(f"the policy at {path} cannot be read: {type(error).__name__}: {error}") from error
        return policy.to(device).eval()

    def _kept(self, dropout: float, batch: Labeled, generator: torch.Generator) -> Tensor:
        """(B,) bool, False for a share of `dropout`."""
        draws = torch.rand(len(batch.state), generator=generator, device=generator.device)
        return (draws >= dropout).to(self.device)

    def _loss(
        self,
        batch: Labeled,
        normal: Inputs,
        keep: Tensor,
        generator: torch.Generator,
        augment: torch.Generator | None,
        updates: int | None = None,
    ) -> tuple[Tensor, dict[str, Tensor]]:
        features, extra = self._features(_with_keypoints(normal, batch), keep, augment)
        chunk = self.normalizer.normalize("action", batch.action)
        loss, metrics = self.head.loss(features, chunk, batch.action_mask, generator, updates)
        total, parts = _summed({"head": loss, **extra})
        return total, {**parts, **{name: value.detach() for name, value in metrics.items()}}

    def _features(
        self, inputs: Inputs, keep: Tensor, augment: torch.Generator | None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """(B, D) and the encoder's weighted auxiliary losses."""
        encoded = self.encoder(inputs, keep, augment)
        tokens = torch.cat([encoded.goal, encoded.steps.flatten(1, 2)], dim=1)  # (B, N + T M, D)
        mask = None
        if inputs.history_mask.shape[1] > 1:
            steps = inputs.history_mask.repeat_interleave(self.encoder.step_tokens, dim=1)
            mask = torch.cat([steps.new_ones(len(steps), self.encoder.goal_tokens), steps], dim=1)
        return self.trunk(tokens, mask), self.encoder.auxiliary(encoded, inputs)

    def _normalized(self, inputs: Observed) -> Inputs:
        """On this policy's device, numbers normalized, only the cameras it reads."""
        encoder, device, normalize = self.config.encoder, self.device, self.normalizer.normalize
        return Inputs(
            state=normalize("state", inputs.state.to(device)),
            achieved=normalize("achieved", inputs.achieved.to(device)),
            history_mask=inputs.history_mask.to(device),
            goal_achieved=normalize("achieved", inputs.goal_achieved.to(device)),
            goal_proprio=normalize("state", inputs.goal_proprio.to(device)),
            images={camera: inputs.images[camera].to(device) for camera in encoder.observation_cameras},
            goal_images={
                camera: inputs.goal_images[camera].to(device)
                for camera in encoder.goal_cameras
                if camera in inputs.goal_images
            },
        )


def _with_keypoints(normal: Inputs, batch: Labeled) -> Inputs:
    return replace(normal, keypoints=batch.keypoints, goal_keypoints=batch.goal_keypoints)


def _summed(losses: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
    """Their sum, and each by its name."""
    return sum(losses.values(), torch.zeros(())), {name: value.detach() for name, value in losses.items()}


def spec_from_dict(written: Mapping[str, Any]) -> PolicySpec:
    """What `dataclasses.asdict` made of a PolicySpec and JSON gave back."""
    return PolicySpec(
        state_names=tuple(written["state_names"]),
        achieved_names=tuple(written["achieved_names"]),
        action_names=tuple(written["action_names"]),
        fps=written["fps"],
        cameras={camera: (size[0], size[1]) for camera, size in written["cameras"].items()},
        controller=written["controller"],
        predicts=written.get("predicts", "actions"),
        bounded=written.get("bounded", True),
    )
