"""The skill library of pieces: what play tries with them, and which comes next on the way to a goal."""

from collections.abc import Sequence

import numpy as np

from playlearn.envs.pieces.pieces import Piece, Pieces
from playlearn.envs.pieces.tasks import PieceTasks, piece_tasks
from playlearn.episode import Array
from playlearn.oracles.end_effector import EndEffector
from playlearn.oracles.skill_library import SkillOption
from playlearn.oracles.skills import Carry, Push, Reach, Skill
from playlearn.sim.environment import Task

_HIGH = 0.14  # meters above the table where an idle gripper rests
_ROOM = 0.012  # meters that fingers are open beyond a piece before they go down around it
_WEIGHTS = {"lift": 0.6, "place": 1.6, "unstack": 2.0}  # how often play tries each kind, where it can


class PiecesSkillLibrary:
    """The `SkillLibrary` of pieces."""

    def __init__(self, pieces: Pieces) -> None:
        self._pieces, self._tasks, self._spots = pieces, piece_tasks(pieces), pieces.table.spots()
        (x0, x1), (y0, y1), z = pieces.table.x, pieces.table.y, pieces.table.z
        self.idle = ((x0, y0, z + 0.12), (x1, y1, z + 0.25))

    def options(self) -> Sequence[SkillOption]:
        return [
            self._option(task, piece) for piece in self._pieces.all for task in PieceTasks(self._pieces, piece).tasks()
        ]

    def holding(self, hand: EndEffector, achieved: Array) -> bool:
        return self._held(hand, achieved) is not None

    def put_down(self, hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
        piece = self._held(hand, achieved)
        if piece is None:
            return self.towards(hand, achieved, achieved)
        tasks = PieceTasks(self._pieces, piece)
        name = "stack" if tasks.bases(achieved) and rng.random() < 0.5 else "place"
        goal = self._tasks[f"{name}_{piece.name}"].command(achieved, rng)
        return self._carry(goal, piece, f"{name}_{piece.name}")

    def towards(self, hand: EndEffector, achieved: Array, goal: Array) -> Skill:
        """What is below comes first, what is to stay in the air last; what is in the way is laid aside."""
        pieces = self._pieces
        wrong = [piece for piece in pieces.all if not pieces.there(achieved, goal, piece)]
        aloft = [piece for piece in pieces.all if not pieces.rests(goal, piece)]
        wrong.sort(key=lambda piece: (piece in aloft, piece.position(goal)[2]))
        held = self._held(hand, achieved)
        first = next(iter([*wrong, *aloft]), held)
        if first is None:
            x, y, _ = hand.position
            return Reach("rest", (float(x), float(y), pieces.table.z + _HIGH))
        if held is not None and held != first:
            return self._lay_down(achieved, goal, held)
        blocker = self._blocker(achieved, goal, first)
        obstacle = pieces.rider(achieved, first) or (blocker and (pieces.rider(achieved, blocker) or blocker))
        return self._carry(goal, first) if obstacle is None else self._lay_down(achieved, goal, obstacle)

    def _lay_down(self, achieved: Array, goal: Array, piece: Piece) -> Skill:
        """At its goal if it would stay there now, else aside."""
        pieces = self._pieces
        under = pieces.supporter(goal, piece)
        stays = pieces.lying(goal, piece) or (under is not None and pieces.there(achieved, goal, under))
        free = self._blocker(achieved, goal, piece) is None
        return self._carry(goal, piece) if stays and free else self._park(achieved, goal, piece)

    def _blocker(self, achieved: Array, goal: Array, piece: Piece) -> Piece | None:
        """What now stands where a piece is to come."""
        to = piece.position(goal)
        for other in self._pieces.others(piece):
            off = other.position(achieved) - to
            level = abs(off[2]) < (piece.height + other.height) / 2 - 0.01
            if level and np.hypot(*off[:2]) < 0.5 * (piece.width + other.width) + 0.012:
                return other
        return None

    def _park(self, achieved: Array, goal: Array, piece: Piece) -> Skill:
        """Lay it aside, at the first spot that nothing else is at or is to come to; always the same one."""
        others = self._pieces.others(piece)
        taken = np.array([other.position(where)[:2] for where in (achieved, goal) for other in others])
        far = np.hypot(*(self._spots[:, None] - taken[None]).transpose(2, 0, 1)).min(axis=1)  # (spots,)
        x, y = self._spots[int(np.argmax(far > 0.10))]
        z = self._pieces.table.z + piece.height / 2
        return Carry(
            f"park_{piece.name}", piece, (float(x), float(y), z), piece.yaw(achieved), room=piece.width + _ROOM
        )

    def _carry(self, goal: Array, piece: Piece, name: str | None = None) -> Carry:
        x, y, z = map(float, piece.position(goal))
        lasting = self._pieces.rests(goal, piece)
        return Carry(
            name or f"carry_{piece.name}", piece, (x, y, z), piece.yaw(goal), lasting, room=piece.width + _ROOM
        )

    def _held(self, hand: EndEffector, achieved: Array) -> Piece | None:
        return next((piece for piece in self._pieces.all if piece.held(hand, achieved)), None)

    def _option(self, task: Task, piece: Piece) -> SkillOption:
        def skill(hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill | None:
            goal = task.command(achieved, rng)
            if np.allclose(goal, achieved, atol=1e-4):
                return None
            x, y, z = map(float, piece.position(goal))
            return Push(task.name, piece, (x, y, z)) if task.kind == "push" else self._carry(goal, piece, task.name)

        return SkillOption(task.name, task.kind, task.precondition, skill, _WEIGHTS.get(task.kind, 1.0))
