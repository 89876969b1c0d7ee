"""Which steps of play lead into a failure, by the annotation of its skills."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import Array

FAILURES = frozenset({"mistake", "slip", "gave_up"})


def leads_to_failure(skill: Array, annotations: Sequence[tuple[str, Sequence[str]]]) -> NDArray[np.bool_]:
    """(T,) whether the attempt that each step belongs to fails there or later.

    skill: (T,) indices of `annotations`, each a skill and its marks, such as `slip`. An attempt lasts as long as its
    skill stays the same, and ends where it is given up or begun `again`; it fails at the mark `mistake`, `slip` or
    `gave_up`. What comes after is the recovery, and leads to no failure.
    """
    names = [name for name, _ in annotations]
    first = [names.index(name) for name in names]  # one number a skill, whatever its marks
    attempted = np.array(first)[skill]
    fails, given_up, again = (
        np.array([bool(marks & set(own)) for _, own in annotations])[skill]
        for marks in (FAILURES, {"gave_up"}, {"again"})
    )
    ends = np.append((attempted[1:] != attempted[:-1]) | given_up[:-1] | again[1:], True)
    steps = np.arange(len(skill))
    end, failure = (
        np.minimum.accumulate(np.where(here, steps, len(skill))[::-1])[::-1] for here in (ends, fails)
    )  # at or after each step
    return np.asarray(failure <= end)
