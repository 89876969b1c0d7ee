"""The configs of OGBench's environments and of its play; its package is needed only to build one."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

from playlearn.errors import UsageError
from playlearn.oracles import ExpertPolicy, PlayPolicyConfig, register_expert
from playlearn.sim.environment import CameraConfig, Environment, EnvironmentConfig

if TYPE_CHECKING:
    from playlearn.envs.ogbench.cube import OgbenchCubeEnv
    from playlearn.envs.ogbench.play_policy import OgbenchPlayPolicy
    from playlearn.envs.ogbench.scene import OgbenchSceneEnv

MOST_CUBES = 4


def needed() -> None:
    """Raises UsageError where OGBench's package is not installed."""
    try:
        import ogbench  # noqa: F401
    except ImportError as error:
        raise UsageError(
            f"OGBench's environments need the extra `ogbench`: pip install 'playlearn[ogbench]' ({error})"
        ) from error


@dataclass(frozen=True)
class OgbenchConfig(EnvironmentConfig):
    """What OGBench's environments share.

    cameras: `front`, OGBench's own view of its pixel environments, and the size of the images.
    see_through: draw the arm all but transparent, as OGBench's pixel environments do.
    exact: draw every pixel as OGBench does, some 15 times slower than with meshes as fine as the image can show.
    """

    cameras: dict[str, CameraConfig] = field(default_factory=lambda: {"front": CameraConfig(64, 64)})
    see_through: bool = True
    exact: bool = False

    def __post_init__(self) -> None:
        for name in self.cameras:
            if name != "front":
                raise UsageError(f"cameras: OGBench's environments have no camera {name!r}, only `front`")


@EnvironmentConfig.register_subclass("ogbench_cube")
@dataclass(frozen=True)
class OgbenchCubeConfig(OgbenchConfig):
    """OGBench's cube environments.

    cubes: 1 is cube-single, 2 cube-double, 3 cube-triple, 4 cube-quadruple.
    """

    cubes: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.cubes <= MOST_CUBES:
            raise UsageError(f"cubes: between 1 and {MOST_CUBES}, got {self.cubes}")

    def build(self) -> "OgbenchCubeEnv":
        needed()
        from playlearn.envs.ogbench.cube import OgbenchCubeEnv

        return OgbenchCubeEnv(self, self.cubes, self.cameras, see_through=self.see_through, exact=self.exact)


@EnvironmentConfig.register_subclass("ogbench_scene")
@dataclass(frozen=True)
class OgbenchSceneConfig(OgbenchConfig):
    """OGBench's scene.

    unseen: end an episode whose cube leaves the view without being in the drawer: OGBench keeps no such play.
    """

    unseen: bool = False

    def build(self) -> "OgbenchSceneEnv":
        needed()
        from playlearn.envs.ogbench.scene import OgbenchSceneEnv

        return OgbenchSceneEnv(
            self, self.cameras, see_through=self.see_through, exact=self.exact, end_unseen=self.unseen
        )


@PlayPolicyConfig.register_subclass("ogbench")
@dataclass(frozen=True)
class OgbenchPlayConfig(PlayPolicyConfig):
    """OGBench's own play.

    noise: of an oracle's plan, drawn once for each.
    smoothing: of that noise along the plan.
    """

    noise: float = 0.1
    smoothing: float = 0.5

    def __post_init__(self) -> None:
        if min(self.noise, self.smoothing) < 0:
            raise UsageError(f"noise and smoothing are not negative, got {self.noise:g} and {self.smoothing:g}")

    def build(self, environment: Environment) -> "OgbenchPlayPolicy":
        needed()
        from playlearn.envs.ogbench.play_policy import OgbenchPlayPolicy

        return OgbenchPlayPolicy(environment, self.noise, self.smoothing)

    def noisier(self, noise: float) -> Self:
        return replace(self, noise=max(noise, self.noise))


def _cube_expert(environment: Environment) -> ExpertPolicy:
    from playlearn.envs.ogbench.expert import CubeExpert

    return CubeExpert(environment)


def _scene_expert(environment: Environment) -> ExpertPolicy:
    from playlearn.envs.ogbench.expert import SceneExpert

    return SceneExpert(environment)


register_expert("ogbench_cube", _cube_expert)
register_expert("ogbench_scene", _scene_expert)
