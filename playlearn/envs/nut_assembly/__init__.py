"""robosuite's NutAssembly with one nut: the environment, and the skills that thread it onto its peg."""

from playlearn.envs.nut_assembly.env import AREA, PEGS, REST, NutAssemblyConfig, NutAssemblyEnv, on_peg
from playlearn.envs.nut_assembly.skill_library import NutSkillLibrary, handle

__all__ = ["AREA", "PEGS", "REST", "NutAssemblyConfig", "NutAssemblyEnv", "NutSkillLibrary", "handle", "on_peg"]
