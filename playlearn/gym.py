"""Goal-conditioned episodes as gymnasium environments: `gymnasium.make("playlearn/PlayTable-v0", suite=...)`.

gymnasium has no plug-ins: an environment is known once a package has registered it. To import playlearn does so, at
once where gymnasium is imported already, else when it is, so that `import playlearn` stays quick.
`gymnasium.make("playlearn.gym:playlearn/PlayTable-v0")` needs no import of playlearn at all.
"""

import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from playlearn.evaluation import SuiteConfig
    from playlearn.evaluation.goal_env import GoalEnv

# gymnasium's name -> `type:` of the environment's config.
ENVIRONMENTS = {
    "Door": "door",
    "Lift": "lift",
    "NutAssembly": "nut_assembly",
    "OgbenchCube": "ogbench_cube",
    "OgbenchScene": "ogbench_scene",
    "PickPlace": "pick_place",
    "PlayTable": "playtable",
    "Stack": "stack",
    "Wipe": "wipe",
}
_GYMNASIUM = "gymnasium"


def make(
    environment: str,
    suite: "Path | str | SuiteConfig | None" = None,
    max_steps: int | None = None,
    render_mode: str = "rgb_array",
) -> "GoalEnv":
    """What `gymnasium.make` builds.

    environment: the `type:` of its config. suite: a YAML file (eval/suites/) or config that fixes start states,
    goals and budgets; None for all named tasks of the environment from random starts. Episode n of it is set up by
    `reset(seed=n)`. max_steps: instead of the suite's.

    Raises:
        UsageError: the suite is wrong, or of another environment.
    """
    from playlearn.errors import UsageError
    from playlearn.evaluation import SuiteConfig, TasksConfig, load_suite
    from playlearn.evaluation.goal_env import GoalEnv
    from playlearn.sim import EnvironmentConfig

    kind: Any = EnvironmentConfig.get_choice_class(environment)
    if suite is None:
        suite = SuiteConfig(name=environment, environment=kind(), kind=TasksConfig())
    config = suite if isinstance(suite, SuiteConfig) else load_suite(Path(suite))
    if not isinstance(config.environment, kind):
        other = config.environment.get_choice_name(type(config.environment))
        raise UsageError(f"suite {config.name} is of environment {other}, not of {environment}")
    return GoalEnv(config, max_steps, render_mode=render_mode)


def register() -> None:
    """Make every environment known to gymnasium."""
    import gymnasium

    for name, environment in ENVIRONMENTS.items():
        identifier = f"playlearn/{name}-v0"
        if identifier not in gymnasium.registry:
            gymnasium.register(identifier, entry_point="playlearn.gym:make", kwargs={"environment": environment})


def register_when_imported() -> None:
    """Register now where gymnasium is imported, else once it is."""
    if hasattr(sys.modules.get(_GYMNASIUM), "registry"):
        register()
    elif not any(isinstance(finder, _WhenImported) for finder in sys.meta_path):
        sys.meta_path.insert(0, _WhenImported())


class _WhenImported(MetaPathFinder):
    """Finds gymnasium as the other finders do, and registers once it has been executed."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name != _GYMNASIUM:
            return None
        others = (finder for finder in sys.meta_path if finder is not self)
        spec = next((found for finder in others if (found := finder.find_spec(name, path, target)) is not None), None)
        if spec is not None and spec.loader is not None:
            spec.loader = _Registering(spec.loader)
        return spec


class _Registering(Loader):
    """Another loader, and `register` after it."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        module.__loader__ = self._loader
        if module.__spec__ is not None:
            module.__spec__.loader = self._loader
        self._loader.exec_module(module)
        register()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loader, name)
