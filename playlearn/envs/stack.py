"""robosuite's Stack: a small red cube (A), a larger green one (B), either to be put on the other.

`achieved` (10,): cubeA.x .y .z .c .s, then cubeB's, as `playlearn.envs.pieces` has them; a cube looks the
same after every quarter turn.
"""

from dataclasses import dataclass

from playlearn.envs.pieces import Piece, Pieces, PiecesEnv, PiecesSkillLibrary, Table
from playlearn.envs.tabletop import TabletopConfig
from playlearn.oracles import register_skill_library
from playlearn.sim.environment import EnvironmentConfig

PIECES = Pieces((Piece("cubeA", 0, width=0.04, height=0.04), Piece("cubeB", 1, width=0.05, height=0.05)), Table())


@EnvironmentConfig.register_subclass("stack")
@dataclass(frozen=True)
class StackConfig(TabletopConfig):
    """robosuite's Stack.

    beyond: fraction of random starts with the cubes anywhere within reach.
    stacked: fraction with one on the other; all others are robosuite's own.
    """

    beyond: float = 0.4
    stacked: float = 0.2

    def build(self) -> PiecesEnv:
        return PiecesEnv(self, "Stack", PIECES, beyond=self.beyond, stacked=self.stacked)


register_skill_library("stack", lambda _: PiecesSkillLibrary(PIECES))
