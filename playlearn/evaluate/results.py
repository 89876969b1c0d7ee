"""From attempts to `results.json`, `episodes.parquet` and the report's curves and pictures."""

import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from playlearn.evaluate.cohort import Attempt
from playlearn.report.intervals import wilson

CRASHED = "crashed"


def summary(attempts: Sequence[Attempt]) -> dict[str, Any]:
    """Rates and intervals of one contender, over all episodes and by task.

    An episode of several goals is a success when the last of them is; by task each goal that was attempted counts.
    `crashed` counts failures of the machinery, each of which is among the failures too.
    """
    rates = _rates(ends(attempts)) | {
        "crashed": sum(attempt.reason.startswith(CRASHED) for attempt in attempts),
        "steps_to_success": _mean([attempt.steps for attempt in attempts if attempt.success]),
        "tasks": {
            task: _rates([attempt for attempt in attempts if attempt.task == task])
            for task in sorted({attempt.task for attempt in attempts})
        },
    }
    return rates | ({"chain": chain(attempts)} if any(attempt.links > 1 for attempt in attempts) else {})


def ends(attempts: Sequence[Attempt]) -> list[Attempt]:
    """Each episode's last attempt, by episode: of several goals in a row the one that was not reached, if any."""
    last = {attempt.episode: attempt for attempt in sorted(attempts, key=lambda one: (one.episode, one.link))}
    return list(last.values())


def chain(attempts: Sequence[Attempt]) -> dict[str, Any]:
    """How many goals in a row one contender reached.

    length_mean: of the chains, the goals reached before the first that was not. Its interval is Wilson's for a share
    length_mean / links: a quantity in [0, 1] varies no more than a coin of the same mean, so it is rather too wide.
    at_least: the share of chains in which 1, 2, ... were reached. already: the share of the reached goals that were
    there before anything was done. ended_by: at which tasks chains ended, the most frequent first.
    """
    last = ends(attempts)
    links, count = max(attempt.links for attempt in attempts), len(last)
    lengths = [attempt.link + attempt.success for attempt in last]
    low, high = wilson(sum(lengths) / links, count)
    reaching = [sum(length >= k for length in lengths) for k in range(1, links + 1)]
    reached = [attempt for attempt in attempts if attempt.success]
    return {
        "links": links,
        "length_mean": sum(lengths) / count,
        "length_ci95": [links * low, links * high],
        "at_least": [number / count for number in reaching],
        "at_least_ci95": [list(wilson(number, count)) for number in reaching],
        "already": sum(attempt.already for attempt in reached) / max(1, len(reached)),
        "ended_by": dict(Counter(attempt.task for attempt in last if not attempt.success).most_common()),
    }


def _rates(attempts: Sequence[Attempt]) -> dict[str, Any]:
    count, won = len(attempts), sum(attempt.success for attempt in attempts)
    strict = sum(attempt.strict for attempt in attempts)
    return {
        "episodes": count,
        "success_rate": won / count if count else 0.0,
        "ci95": list(wilson(won, count)),
        "strict_rate": strict / count if count else 0.0,
        "strict_ci95": list(wilson(strict, count)),
    }


def _mean(values: Sequence[int]) -> float | None:
    return sum(values) / len(values) if values else None


def curve(attempts: Sequence[Attempt], max_steps: int) -> list[float]:
    """(max_steps + 1,) the share of attempts, each at one goal, that had succeeded by each step."""
    count = max(1, len(attempts))
    return [sum(a.success and a.steps <= step for a in attempts) / count for step in range(max_steps + 1)]


def parquet(attempts: Sequence[Attempt]) -> bytes:
    """One row an attempt."""
    rows = [asdict(attempt) for attempt in attempts]
    numbers = pa.list_(pa.float64())
    kinds: dict[Any, pa.DataType] = {str: pa.string(), int: pa.int64(), bool: pa.bool_()}
    schema = pa.schema([(entry.name, kinds.get(entry.type, numbers)) for entry in fields(Attempt)])
    columns = {name: [list(v) if isinstance(v := row[name], tuple) else v for row in rows] for name in schema.names}
    buffer = io.BytesIO()
    pq.write_table(pa.table(columns, schema=schema), buffer)
    return buffer.getvalue()


def to_show(attempts: Sequence[Attempt], successes: int, failures: int) -> list[Attempt]:
    """The first few successes and failures of every task, by episode: the same whoever finished first."""
    chosen: list[Attempt] = []
    for task in sorted({attempt.task for attempt in attempts}):
        mine = sorted((a for a in attempts if a.task == task), key=lambda attempt: attempt.episode)
        chosen += [a for a in mine if a.success][:successes] + [a for a in mine if not a.success][:failures]
    return chosen


def to_film(shown: Sequence[Attempt], successes: int, failures: int) -> set[int]:
    """The episodes of a few short films, of as many tasks as there are: `shown` goes task by task."""
    filmed: set[int] = set()
    for wanted, success in ((successes, True), (failures, False)):
        mine = [attempt for attempt in shown if attempt.success == success]
        firsts = list({attempt.task: attempt for attempt in reversed(mine)}.values())[::-1]
        others = [attempt for attempt in mine if attempt not in firsts]
        filmed |= {attempt.episode for attempt in (firsts + others)[:wanted]}
    return filmed


def by_policy(attempts: Sequence[Attempt]) -> Mapping[str, list[Attempt]]:
    """Each contender's attempts in the order of the episodes."""
    grouped: dict[str, list[Attempt]] = {}
    for attempt in sorted(attempts, key=lambda attempt: attempt.episode):
        grouped.setdefault(attempt.policy, []).append(attempt)
    return grouped
