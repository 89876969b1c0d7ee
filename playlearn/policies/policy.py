"""A goal-conditioned policy: encoder, trunk and head over a normalizer."""

import fnmatch
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import chain
from pathlib import Path

import torch
from safetensors.torch import load_file, save
from torch import Tensor, nn

from playlearn.batch import Batch, Inputs, Statistics
from playlearn.config import atomic_write_all, file_digest, from_dict, make_folder, to_dict
from playlearn.errors import CheckpointError, MissingRunError, PlaylearnError, UsageError
from playlearn.policies.checkpoint import first_not_finite
from playlearn.policies.encoders import EncoderConfig, StateConfig
from playlearn.policies.heads import DeterministicConfig, Generators, Guidance, HeadConfig
from playlearn.policies.normalize import Normalizer, scaled
from playlearn.policies.spec import Named, PolicySpec
from playlearn.policies.trunks import TransformerConfig, TrunkConfig

WEIGHTS, DESCRIPTION = "policy.safetensors", "policy.json"
FORMAT = 2
_NOTHING = torch.empty(0)
_NO_ESTIMATES = "this policy makes no pose estimates: train it from images with encoder.state_supervision above 0"


@dataclass(frozen=True)
class PolicyConfig:
    """A policy: encoder, trunk and head.

    encoder: turns observations and goal into tokens.
    trunk: the sequence model over the tokens.
    head: the distribution over action chunks.
    history: observations it reads, the present one included (T).
    chunk: actions predicted at once (H).
    goal_dropout: fraction of training examples without a goal, which makes guidance possible.
    history_dropout: fraction of training examples whose past observations are masked, all but the present one.
    proprio_dropout: fraction of training examples whose robot state is replaced by the mean of the data.

    The last two are against copycat policies: one that can infer its next action from its last ones, or from how the
    arm moves, need not look at the goal (de Haan et al. 2019).

    Raises:
        UsageError: a fraction does not lie between 0 and 1.
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
                raise UsageError(f"policy.{name} is a fraction of the examples, 0 to 1: got {getattr(self, name)}")

    def build(
        self, spec: PolicySpec, statistics: Mapping[str, Statistics] | None, seed: int, *, fetch: bool = True
    ) -> "Policy":
        """A fresh policy; the seed decides its weights, and the global random state stays as it is.

        statistics: of `state`, `achieved` and `action`; None for a policy whose weights are loaded next.
        fetch: whether weights may be downloaded, if the config asks for any.

        Raises:
            UsageError: the config asks for a camera or goal dimension that `spec` does not have, or leaves no goal.
        """
        encoder = self.encoder.complete() if fetch else self.encoder
        for camera in (*encoder.observation_cameras, *encoder.goal_cameras):
            if camera not in spec.cameras:
                raise UsageError(f"the policy's encoder wants camera {camera!r}, there is {sorted(spec.cameras)}")
        encoder.check_goal(spec)
        with torch.random.fork_rng(devices=[]):
            torch.random.manual_seed(seed)
            return Policy(replace(self, encoder=encoder), spec, statistics, fetch=fetch)


class Policy(nn.Module):
    """Goal-conditioned action chunks. Built by `PolicyConfig.build` or `Policy.load`."""

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
            self.normalizer = Normalizer.identity(widths, spec.quantities)
        else:
            self.normalizer = Normalizer(scaled(statistics, spec), spec.quantities)
        width = config.trunk.width
        self.encoder = config.encoder.build(spec, width, fetch=fetch)
        self.trunk = config.trunk.build(self.encoder.goal_tokens + config.history * self.encoder.step_tokens)
        self.head = config.head.build(width, config.chunk, len(spec.action_names))

    @property
    def cameras(self) -> tuple[str, ...]:
        """The cameras it needs, those of the goal included."""
        encoder = self.config.encoder
        return tuple(dict.fromkeys((*encoder.observation_cameras, *encoder.goal_cameras)))

    @property
    def device(self) -> torch.device:
        return next(self.parameters()).device

    def fit_action_statistics(self, actions: Tensor) -> None:
        """Fit what the head needs to know of the training data's actions (n, A), before the first update."""
        self.head.fit_action_statistics(self.normalizer.normalize("action", actions).unsqueeze(1))

    def load_from(self, other: "Policy", source: Path) -> None:
        """Load all parameters of another policy, which may differ in its encoder alone; source: its run.

        Raises:
            UsageError: it differs in more, or a parameter of its encoder does not exist here.
        """
        own, given = self.state_dict(), other.state_dict()
        differ = {entry.name for entry in fields(PolicyConfig) if entry.name != "encoder"}
        differ = {name for name in differ if getattr(self.config, name) != getattr(other.config, name)}
        fits = all(own.get(name, _NOTHING).shape == value.shape for name, value in given.items())
        if not fits or self.config.encoder.goal_names != other.config.encoder.goal_names:
            differ.add("encoder")
        if self.spec.predicts != other.spec.predicts:
            differ.add("target")
        if differ:
            raise UsageError(
                f"init_from: the policy of {source} has another {' and '.join(sorted(differ))}: copy the `policy` "
                "block of that run; to start an image policy from a state policy, match encoder.hidden and set "
                "use_estimated_state: true"
            )
        self.load_state_dict(own | given)

    def behind(self, other: "Policy", source: Path) -> "Policy":
        """A copy of this state policy behind the image encoder of another policy, ready to act.

        other: the policy with the image encoder.
        source: its run.

        Raises:
            UsageError: the two do not fit together, or are normalized differently.
        """
        joined = other.config.build(other.spec, None, seed=0, fetch=False)
        joined.load_state_dict(other.state_dict())
        mine, its = (part.normalizer.state_dict() for part in (self, other))
        if any(not torch.equal(mine[name], its[name]) for name in mine):
            raise UsageError(f"the image encoder of {source} learned from other play: train both on the same store")
        joined.load_from(self, source)
        return joined.to(self.device).eval()

    def freeze_except(self, patterns: Sequence[str]) -> list[nn.Parameter]:
        """The parameters that match some shell-style pattern; all others are frozen.

        Raises:
            UsageError: a pattern matches none.
        """
        named = dict(self.named_parameters())
        for pattern in patterns:
            if not fnmatch.filter(named, pattern):
                there = sorted({".".join(name.split(".")[:2]) + ".*" for name in named})
                raise UsageError(f"trainable: {pattern!r} matches no parameter; there are {', '.join(there)}")
        for name, parameter in named.items():
            if not any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns):
                parameter.requires_grad_(False)
        return [parameter for parameter in named.values() if parameter.requires_grad]

    def forward(
        self, batch: Batch, generator: torch.Generator, updates: int | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Scalar training loss and its parts; all randomness (dropout, augmentation, noise) from `generator`.

        updates: made so far, for what warms up (None: after every warm-up).
        """
        config, normal = self.config, self.normalized(batch)
        if not self.acting_learns:
            # the head's loss has no gradient that any trained parameter receives: only auxiliary losses are computed
            normal = _with_keypoints(normal, batch)
            return _summed(self.encoder.auxiliary(self.encoder.perceive(normal, generator), normal))
        keep = self._kept(config.goal_dropout, batch, generator)
        # at 0 nothing is drawn, so that an option that is off leaves later draws as they are
        if config.history_dropout > 0:
            past = normal.history_mask.clone()
            past[:, :-1] &= self._kept(config.history_dropout, batch, generator)[:, None]
            normal = replace(normal, history_mask=past)
        if config.proprio_dropout > 0:
            kept = self._kept(config.proprio_dropout, batch, generator)
            normal = replace(normal, state=normal.state * kept[:, None, None])
        return self._loss(batch, normal, keep, generator, augment=generator, updates=updates)

    @property
    def acting_learns(self) -> bool:
        """Whether the head's loss trains any parameter; it does not where only the image encoder is trained."""
        parameters = chain(self.encoder.token_parameters(), self.trunk.parameters(), self.head.parameters())
        return any(parameter.requires_grad for parameter in parameters)

    def loss(self, batch: Batch, generator: torch.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        """The same without dropout and augmentation: the validation loss."""
        normal = self.normalized(batch)
        if not self.acting_learns:
            normal = _with_keypoints(normal, batch)
            return _summed(self.encoder.auxiliary(self.encoder.perceive(normal), normal))
        keep = torch.ones(len(batch.state), dtype=torch.bool, device=self.device)
        return self._loss(batch, normal, keep, generator, augment=None)

    @torch.inference_mode()
    def act(
        self, inputs: Inputs, generator: Generators, guidance: float | None = None, *, mode: bool = False
    ) -> Tensor:
        """(B, H, A) float32 on the CPU, in units of the environment; actions clipped to their bounds.

        inputs: on any device.
        generator: one, or one a row, which makes a row independent of the others.
        guidance: weight of the goal, None for the plain prediction (a weight of 1).
        mode: the head's mode rather than a sample.
        """
        normal = self.normalized(inputs)
        batch, weight = len(normal.state), 1.0 if guidance is None else guidance
        keep = torch.full((batch,), weight != 0, device=self.device)
        features = self._features(normal, keep, None)[0]
        guide = None
        if weight not in (0.0, 1.0):
            guide = Guidance(self._features(normal, ~keep, None)[0], weight)
        chunk = self.head.mode(features, guide) if mode else self.head.sample(features, generator, guide)
        chunk = self.normalizer.restore("action", chunk)
        return self._within_bounds(chunk).float().cpu()

    def action_error(self, predicted: Tensor, action: Tensor) -> Tensor:
        """(..., A) and (..., A) in units of the environment -> (...): mean of shares of the spread in the data."""
        std = self.normalizer.get_buffer("action_std").cpu()
        return ((predicted - action) / std).abs().mean(dim=-1)

    @torch.inference_mode()
    def estimate_achieved(self, inputs: Inputs) -> Tensor:
        """(B, G) float32 on the CPU: what is achieved now, estimated from images where the policy reads images.

        Raises:
            UsageError: it reads images and makes no estimates (see `encoder.state_supervision`).
        """
        if not self.config.encoder.observation_cameras:
            return inputs.achieved[:, -1].float().cpu()
        keep = torch.zeros(len(inputs.state), dtype=torch.bool, device=self.device)
        observed = self.encoder(self.normalized(inputs), keep, None).observed
        if observed is None:
            raise UsageError(_NO_ESTIMATES)
        return self.normalizer.restore("achieved", observed[:, -1]).float().cpu()

    @torch.inference_mode()
    def perceived(self, inputs: Inputs) -> tuple[Tensor, Tensor]:
        """(B, T, G) and (B, G) float32 on the CPU: what is achieved, and in the goal, estimated from images.

        Raises:
            UsageError: it does not estimate both from images (see `encoder.state_supervision`).
        """
        tokens = self.encoder.perceive(self.normalized(inputs))
        if tokens.observed is None or tokens.wanted is None or "image" not in self.config.encoder.goals:
            raise UsageError(_NO_ESTIMATES)
        restore = self.normalizer.restore
        return restore("achieved", tokens.observed).float().cpu(), restore("achieved", tokens.wanted).float().cpu()

    def check(self, spec: Named, cameras: Mapping[str, tuple[int, int]]) -> None:
        """Refuse an environment it was not trained for. cameras: name -> (height, width) there.

        Raises:
            CheckpointError: names, fps or cameras differ; the message says which.
        """
        self.spec.check(spec, cameras, self.cameras)

    def save(self, path: Path) -> None:
        """Write `policy.json` and `policy.safetensors` into the folder, both or neither."""
        make_folder(path)
        description = {"format": FORMAT, "config": to_dict(self.config), "spec": asdict(self.spec)}
        weights = save({name: value.contiguous() for name, value in self.state_dict().items()})
        atomic_write_all({path / WEIGHTS: weights, path / DESCRIPTION: json.dumps(description, indent=2).encode()})

    @classmethod
    def load(cls, path: Path, device: str | torch.device = "cpu") -> "Policy":
        """The policy that `save` wrote there, ready to act.

        Raises:
            MissingRunError: files are missing.
            CheckpointError: they are broken, or of another version, or the weights are not finite.
        """
        for name in (DESCRIPTION, WEIGHTS):
            if not (path / name).is_file():
                raise MissingRunError(f"no policy at {path}: {name} is missing; `playlearn train` writes RUN/policy")
        try:
            description = json.loads((path / DESCRIPTION).read_text())
            if description.get("format") != FORMAT:
                raise CheckpointError(
                    f"{path} is of format {description.get('format')}, this version reads {FORMAT}: train it again"
                )
            policy = from_dict(PolicyConfig, description["config"]).build(
                PolicySpec.from_dict(description["spec"]), None, seed=0, fetch=False
            )
            policy.load_state_dict(load_file(path / WEIGHTS))
        except PlaylearnError as error:
            raise CheckpointError(f"the policy at {path} cannot be read: {error}") from error
        except Exception as error:  # a torn file shows itself as any of a dozen types
            raise CheckpointError(f"the policy at {path} cannot be read: {type(error).__name__}: {error}") from error
        wrong = first_not_finite(policy)
        if wrong is not None:
            raise CheckpointError(
                f"the policy at {path} is of a run that diverged ({wrong} is not finite): it cannot act; train again"
            )
        return policy.to(device).eval()

    def _within_bounds(self, chunk: Tensor) -> Tensor:
        """(..., A) actions clipped to their bounds, where they have any."""
        if not self.spec.bounds:
            return chunk
        pairs = [pair or (-math.inf, math.inf) for pair in self.spec.bounds]
        low, high = chunk.new_tensor(pairs).unbind(-1)  # (A,)
        return chunk.clamp(low, high)

    def _kept(self, dropout: float, batch: Batch, generator: torch.Generator) -> Tensor:
        """(B,) bool, False for a fraction of `dropout`."""
        draws = torch.rand(len(batch.state), generator=generator, device=generator.device)
        return (draws >= dropout).to(self.device)

    def _loss(
        self,
        batch: Batch,
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

    def normalized(self, inputs: Inputs) -> Inputs:
        """On this policy's device, normalized, only what it knows: its cameras, and no `achieved` where it has none."""
        encoder, device, together = self.config.encoder, self.device, self.normalizer.together
        raw, known = inputs.state.to(device), slice(len(self.spec.achieved_names))
        state, goal_proprio = together("state", raw, inputs.goal_proprio.to(device))
        objects = inputs.achieved[..., known].to(device), inputs.goal_achieved[..., known].to(device)
        achieved, goal_achieved = together("achieved", *objects)
        events = {name: together("state", raw, pose.to(device))[1] for name, pose in inputs.events.items()}
        return Inputs(
            state=state,
            achieved=achieved,
            history_mask=inputs.history_mask.to(device),
            goal_achieved=goal_achieved,
            goal_proprio=goal_proprio,
            images={camera: inputs.images[camera].to(device) for camera in encoder.observation_cameras},
            goal_images={
                camera: inputs.goal_images[camera].to(device)
                for camera in encoder.goal_cameras
                if camera in inputs.goal_images
            },
            events=events,
        )


def policy_digests(run: Path) -> dict[str, str]:
    """The digests of the files of a run's policy: the same as long as it was not trained again."""
    return {name: file_digest(run / "policy" / name) for name in (WEIGHTS, DESCRIPTION)}


def _with_keypoints(normal: Inputs, batch: Batch) -> Inputs:
    return replace(normal, keypoints=batch.keypoints, goal_keypoints=batch.goal_keypoints)


def _summed(losses: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
    """Their sum, and each by name."""
    return sum(losses.values(), torch.zeros(())), {name: value.detach() for name, value in losses.items()}
