"""Pieces on a table: what scenes of loose blocks share, from robosuite's Lift and Stack to one's own."""

from playlearn.envs.pieces.env import PiecesEnv
from playlearn.envs.pieces.pieces import Piece, Pieces, Table
from playlearn.envs.pieces.skill_library import PiecesSkillLibrary

__all__ = ["Piece", "Pieces", "PiecesEnv", "PiecesSkillLibrary", "Table"]
