"""robosuite's Lift: one cube on a table.

`achieved` (5,): cube.x cube.y cube.z cube.c cube.s, as `playlearn.tasks.pieces` has them; the cube looks the
same after every quarter turn.
"""

from dataclasses import dataclass

from playlearn.sim.environment import EnvironmentConfig
from playlearn.tasks.pieces import Piece, Pieces, PiecesDriver, PiecesWorld, Table
from playlearn.tasks.tabletop import TabletopConfig
from playlearn.teleop import register_driver

PIECES = Pieces((Piece("cube", 0, width=0.042, height=0.042),), Table())


@EnvironmentConfig.register_subclass("lift")
@dataclass(frozen=True)
class LiftConfig(TabletopConfig):
    """beyond: share of random starts with the cube anywhere within reach; the others are robosuite's own."""

    beyond: float = 0.5

    def build(self) -> PiecesWorld:
        return PiecesWorld(self, "Lift", PIECES, beyond=self.beyond)


register_driver("lift", lambda _: PiecesDriver(PIECES))
