"""robosuite's Lift: one cube on a table.

`achieved` (5,): cube.x cube.y cube.z cube.c cube.s, as `playlearn.envs.pieces` has them; the cube looks the
same after every quarter turn.
"""

from dataclasses import dataclass

from playlearn.envs.pieces import Piece, Pieces, PiecesEnv, PiecesSkillLibrary, Table
from playlearn.envs.tabletop import TabletopConfig
from playlearn.oracles import register_skill_library
from playlearn.sim.environment import EnvironmentConfig

PIECES = Pieces((Piece("cube", 0, width=0.042, height=0.042),), Table())


@EnvironmentConfig.register_subclass("lift")
@dataclass(frozen=True)
class LiftConfig(TabletopConfig):
    """robosuite's Lift.

    beyond: fraction of random starts with the cube anywhere within reach; all others are robosuite's own.
    """

    beyond: float = 0.5

    def build(self) -> PiecesEnv:
        return PiecesEnv(self, "Lift", PIECES, beyond=self.beyond)


register_skill_library("lift", lambda _: PiecesSkillLibrary(PIECES))
