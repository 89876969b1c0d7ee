"""How often is often enough.

A closed loop of hundreds of steps through contacts goes another way on another processor: one rounding there, and the
block slips. So what it leads to is no law of one trajectory, but of a share of several, with a margin.
"""

from collections.abc import Iterable


def often(tries: Iterable[bool], done: int = 2, missed: int = 4) -> bool:
    """Whether `done` of the tries succeed before `missed` fail; no more are made than that takes.

    Of what succeeds 95 times in 100, two before four fail once in 30,000 runs, and one before four once in 160,000.
    What succeeds one time in four is found out in two runs of three.
    """
    for success in tries:
        done, missed = done - success, missed - (not success)
        if done == 0 or missed == 0:
            return done == 0
    raise AssertionError("too few tries to tell")
