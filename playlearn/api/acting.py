"""Environments, policies, goals and rollouts."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from playlearn.api.configs import Where

if TYPE_CHECKING:
    from playlearn.episode import Goal
    from playlearn.policies import Policy
    from playlearn.rollout import Outcome
    from playlearn.sim.environment import Actor, Environment, EnvironmentConfig


def make_env(name_or_config: "str | Mapping[str, Any] | EnvironmentConfig", **options: Any) -> "Environment":
    """An environment by its `type:` ("playtable", "lift", "door" ...), its config, or a mapping of its fields.

    options: fields of its config: `make_env("playtable", robot="Sawyer", stacked=0.0)`.

    Raises:
        UsageError: no such environment, an unknown field, or a value of a wrong type.
    """
    from playlearn.envs import make_env as make

    return make(name_or_config, **options)


def load_policy(run: Where, *, encoder: Where | None = None, device: str = "cpu") -> "Policy":
    """The policy of a training run, ready to act.

    run: the --out folder of `playlearn train`, or a shipped one such as `eval/pretrained/image`.
    encoder: a run behind whose image encoder a state policy then acts.

    Raises:
        CheckpointError: there is no policy, or it is broken or of another version.
        UsageError: the two runs do not fit.
    """
    from playlearn.policies import Policy

    policy = Policy.load(Path(run) / "policy", device)
    return policy if encoder is None else policy.behind(Policy.load(Path(encoder) / "policy", device), Path(encoder))


def make_actor(
    policy: "Policy | Literal['expert', 'random']",
    env: "Environment",
    *,
    goal: Literal["image", "state"] | None = None,
    n_action_steps: int | None = None,
    guidance: float | None = None,
) -> "Actor":
    """Whoever acts in rollouts: a policy that executes its chunks, the scripted expert, or smooth random actions.

    goal: how the policy is shown its goal (None: as it was trained; where both, image).
    n_action_steps: actions of a chunk that are executed before the next plan (None: half of the chunk).
    guidance: weight of the goal (classifier-free guidance; None: no guidance).

    Raises:
        UsageError: the policy lacks something in this environment, or the environment has no expert.
    """
    from playlearn.evaluation.actor_recipes import scripted
    from playlearn.policies import PolicyActor
    from playlearn.rollout import RandomActor

    if policy == "expert":
        return scripted(env)
    if policy == "random":
        return RandomActor(len(env.spec.action_names))
    missing = set(policy.cameras) - set(env.spec.cameras)
    images = {} if missing else env.observe(policy.cameras).images
    policy.check(env.spec, {camera: (image.shape[0], image.shape[1]) for camera, image in images.items()})
    steps = max(1, policy.config.chunk // 2) if n_action_steps is None else n_action_steps
    bounds = env.spec.quantities.action_bounds
    return PolicyActor(policy, n_action_steps=steps, guidance=guidance, goal=goal, bounds=bounds)


def make_goal(env: "Environment", cameras: Sequence[str] | None = None) -> "Goal":
    """The environment's present state as a goal: achieved (G,), the robot's state (S,) and an image for each camera.

    cameras: those that show it (None: all).
    """
    from playlearn.evaluation.suite import goal_from

    return goal_from(env, env.spec.cameras if cameras is None else cameras)


def load_goal(policy: "Policy", pictures: Mapping[str, Where], *, keep_aspect: bool = True) -> "Goal":
    """A goal from picture files (PNG, JPEG), a camera's each, scaled to what the policy sees.

    pictures: camera -> file. Take it with the camera that the play was recorded with, from the same place.
    keep_aspect: whether a picture of another shape is refused; else it is squeezed, as the images of the play were.

    Raises:
        UsageError: the policy reads no goal images, a camera is missing or another one, or a file is no color picture
            of at least that size and of that shape.
    """
    import numpy as np

    from playlearn.episode import Goal
    from playlearn.errors import UsageError
    from playlearn.picture import read_picture

    wanted = policy.config.encoder.goal_cameras
    if set(pictures) != set(wanted):
        reads = f"reads goal images of {', '.join(wanted)}" if wanted else "reads no goal images"
        raise UsageError(f"the policy {reads}, and pictures are given of {', '.join(pictures) or 'none'}")
    sizes = policy.spec.cameras
    images = {camera: read_picture(Path(pictures[camera]), sizes[camera], keep_aspect=keep_aspect) for camera in wanted}
    return Goal(np.zeros(len(policy.spec.achieved_names), np.float32), images)


def run_rollout(
    env: "Environment",
    actor: "Actor",
    goal: "Goal | None" = None,
    *,
    seed: int = 0,
    max_steps: int = 200,
    cameras: Sequence[str] = (),
) -> "Outcome":
    """Let an actor act from the environment's present state until the goal is reached, or `max_steps` are over.

    seed: the actor's randomness. cameras: those that the recorded episode keeps images of.
    The outcome's `ended` is "stopped" where the goal was reached; for many environments in lockstep see
    `playlearn.rollout.rollout`.
    """
    from playlearn.rollout import rollout

    stop = None if goal is None else lambda _, seen: env.reached(seen.achieved, goal.achieved)
    return rollout([env], actor, [goal], seeds=[seed], max_steps=max_steps, stop=stop, cameras=cameras)[0]
