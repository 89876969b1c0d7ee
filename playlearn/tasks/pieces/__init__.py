"""Pieces on a table: what scenes of loose blocks share, from robosuite's Lift and Stack to one's own."""

from playlearn.tasks.pieces.driver import PiecesDriver
from playlearn.tasks.pieces.pieces import Piece, Pieces, Table
from playlearn.tasks.pieces.world import PiecesWorld

__all__ = ["Piece", "Pieces", "PiecesDriver", "PiecesWorld", "Table"]
