"""Privileged information: what only a simulator, or a scripted teleoperator in one, knows, and what used it.

word                       what was used
object poses               poses of objects and fixtures, from the simulator
recorded object poses      the same, as a dataset without simulator states has them: where they are from is not known
clean labels               actions without the noise and mistakes that were executed
rendered scenes            images that the simulator rendered of states of its own choice, with the objects' poses
                           and the pixels at which the cameras see them
corrections                labels of displaced moments, which the simulator made
expert                     labels of a scripted expert that reads the simulator
skill annotations          what the scripted teleoperator was doing
simulator state            all of it: of a scripted actor
unknown                    nobody recorded it
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

KEY = "privileged"  # in run.json and results.json
POSES, RECORDED_POSES, LABELS = "object poses", "recorded object poses", "clean labels"
SCENES, CORRECTIONS, EXPERT = "rendered scenes", "corrections", "expert"
SKILLS, SIMULATOR, UNKNOWN = "skill annotations", "simulator state", "unknown"
LABELED_BY_EXPERT = "dagger"  # who acted in episodes whose labels are an expert's


@dataclass(frozen=True)
class Privileges:
    """What privileged information a policy came by; the words of the module, none where it used none.

    training: as its input, label or loss.
    relabeling: in choosing which moments are goals, and which examples are shown how often.
    goal: in the goal that it is given.
    """

    training: tuple[str, ...] = ()
    relabeling: tuple[str, ...] = ()
    goal: tuple[str, ...] = ()

    def __or__(self, other: "Privileges") -> "Privileges":
        """What either used."""
        pairs = ((getattr(self, name), getattr(other, name)) for name in self.__dataclass_fields__)
        return Privileges(*(_each_once((*mine, *its)) for mine, its in pairs))

    def __str__(self) -> str:
        """`none`, or which, as a table shows it."""
        parts = {name: ", ".join(words) for name, words in self.to_dict().items() if words}
        if set(parts.values()) == {UNKNOWN}:
            return UNKNOWN
        return "; ".join(f"{name}: {words}" for name, words in parts.items()) or "none"

    def to_dict(self) -> dict[str, list[str]]:
        """For JSON."""
        return {name: list(getattr(self, name)) for name in self.__dataclass_fields__}

    @classmethod
    def from_dict(cls, written: Mapping[str, Sequence[str]] | None) -> Self:
        """What `to_dict` made; of a record from before there was one, all is unknown."""
        if written is None:
            return cls((UNKNOWN,), (UNKNOWN,), (UNKNOWN,))
        return cls(**{name: tuple(written.get(name, ())) for name in cls.__dataclass_fields__})

    @classmethod
    def of_run(cls, run: Path) -> Self:
        """What a run's record says."""
        path = run / "run.json"
        record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        return cls.from_dict(record.get(KEY))


def _each_once(words: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(words))
