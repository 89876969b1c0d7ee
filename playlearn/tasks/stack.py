"""robosuite's Stack: a small red cube (A), a larger green one (B), either to be put on the other.

`achieved` (10,): cubeA.x .y .z .c .s, then cubeB's, as `playlearn.tasks.pieces` has them; a cube looks the
same after every quarter turn.
"""

from dataclasses import dataclass

from playlearn.sim.environment import EnvironmentConfig
from playlearn.tasks.pieces import Piece, Pieces, PiecesDriver, PiecesWorld, Table
from playlearn.tasks.tabletop import TabletopConfig
from playlearn.teleop import register_driver

PIECES = Pieces((Piece("cubeA", 0, width=0.04, height=0.04), Piece("cubeB", 1, width=0.05, height=0.05)), Table())


@EnvironmentConfig.register_subclass("stack")
@dataclass(frozen=True)
class StackConfig(TabletopConfig):
    """beyond: share of random starts with the cubes anywhere within reach. stacked: share with one on the other.

    All others are robosuite's own.
    """

    beyond: float = 0.4
    stacked: float = 0.2

    def build(self) -> PiecesWorld:
        return PiecesWorld(self, "Stack", PIECES, beyond=self.beyond, stacked=self.stacked)


register_driver("stack", lambda _: PiecesDriver(PIECES))
