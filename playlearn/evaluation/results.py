"""From episode results to `results.json`, `episodes.parquet`, curves, and the episodes that the report shows."""

import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from playlearn.evaluation.worker import EpisodeResult
from playlearn.report.intervals import wilson

CRASHED = "crashed"


def summary(results: Sequence[EpisodeResult]) -> dict[str, Any]:
    """Rates and intervals of one policy, over all episodes and by task.

    An episode of several goals succeeds if its last goal does. By task, every attempted goal counts.
    `crashed` counts rollouts that raised or were lost; each is also counted as a failure.
    """
    rates = _rates(last_goals(results)) | {
        "crashed": sum(row.reason.startswith(CRASHED) for row in results),
        "steps_to_success": _mean([row.steps for row in results if row.success]),
        "tasks": {
            task: _rates([row for row in results if row.task == task]) for task in sorted({row.task for row in results})
        },
    }
    return rates | ({"chain": chain(results)} if any(row.num_goals > 1 for row in results) else {})


def last_goals(results: Sequence[EpisodeResult]) -> list[EpisodeResult]:
    """The row of each episode's last attempted goal, by episode: in a chain, the failed one if there is one."""
    return list({row.episode: row for row in sorted(results, key=lambda row: (row.episode, row.goal_index))}.values())


def chain(results: Sequence[EpisodeResult]) -> dict[str, Any]:
    """How many goals in a row one policy reached.

    num_goals: goals of a chain.
    length_mean: goals reached before the first failure. Its interval is Wilson's for the fraction length_mean /
        num_goals: a quantity in [0, 1] varies no more than a coin of the same mean, so it is conservative.
    at_least: fraction of chains with 1, 2, ... goals reached.
    solved_at_start: fraction of the reached goals that were satisfied before the first action.
    ended_by: tasks at which chains ended, the most frequent first.
    """
    last = last_goals(results)
    num_goals, count = max(row.num_goals for row in results), len(last)
    lengths = [row.goal_index + row.success for row in last]
    low, high = wilson(sum(lengths) / num_goals, count)
    at_least = [sum(length >= k for length in lengths) for k in range(1, num_goals + 1)]
    reached = [row for row in results if row.success]
    return {
        "num_goals": num_goals,
        "length_mean": sum(lengths) / count,
        "length_ci95": [num_goals * low, num_goals * high],
        "at_least": [number / count for number in at_least],
        "at_least_ci95": [list(wilson(number, count)) for number in at_least],
        "solved_at_start": sum(row.solved_at_start for row in reached) / max(1, len(reached)),
        "ended_by": dict(Counter(row.task for row in last if not row.success).most_common()),
    }


def _rates(results: Sequence[EpisodeResult]) -> dict[str, Any]:
    count, successes = len(results), sum(row.success for row in results)
    strict = sum(row.strict for row in results)
    return {
        "episodes": count,
        "success_rate": successes / count if count else 0.0,
        "ci95": list(wilson(successes, count)),
        "strict_rate": strict / count if count else 0.0,
        "strict_ci95": list(wilson(strict, count)),
    }


def _mean(values: Sequence[int]) -> float | None:
    return sum(values) / len(values) if values else None


def curve(results: Sequence[EpisodeResult], max_steps: int) -> list[float]:
    """(max_steps + 1,) fraction of the attempted goals that were reached by each step."""
    count = max(1, len(results))
    return [sum(row.success and row.steps <= step for row in results) / count for step in range(max_steps + 1)]


def parquet(results: Sequence[EpisodeResult]) -> bytes:
    """One row for each attempted goal."""
    rows = [asdict(result) for result in results]
    numbers = pa.list_(pa.float64())
    kinds: dict[Any, pa.DataType] = {str: pa.string(), int: pa.int64(), bool: pa.bool_()}
    schema = pa.schema([(entry.name, kinds.get(entry.type, numbers)) for entry in fields(EpisodeResult)])
    columns = {name: [list(v) if isinstance(v := row[name], tuple) else v for row in rows] for name in schema.names}
    buffer = io.BytesIO()
    pq.write_table(pa.table(columns, schema=schema), buffer)
    return buffer.getvalue()


def to_show(results: Sequence[EpisodeResult], successes: int, failures: int) -> list[EpisodeResult]:
    """The first few successes and failures of every task, by episode: independent of which worker finished first."""
    chosen: list[EpisodeResult] = []
    for task in sorted({row.task for row in results}):
        own = sorted((row for row in results if row.task == task), key=lambda row: row.episode)
        chosen += [row for row in own if row.success][:successes] + [row for row in own if not row.success][:failures]
    return chosen


def to_film(shown: Sequence[EpisodeResult], successes: int, failures: int) -> set[int]:
    """The episodes of a few short films, of as many tasks as possible; `shown` goes task by task."""
    filmed: set[int] = set()
    for wanted, success in ((successes, True), (failures, False)):
        own = [row for row in shown if row.success == success]
        firsts = list({row.task: row for row in reversed(own)}.values())[::-1]
        others = [row for row in own if row not in firsts]
        filmed |= {row.episode for row in (firsts + others)[:wanted]}
    return filmed


def by_policy(results: Sequence[EpisodeResult]) -> Mapping[str, list[EpisodeResult]]:
    """The results of each policy, by episode."""
    grouped: dict[str, list[EpisodeResult]] = {}
    for row in sorted(results, key=lambda row: row.episode):
        grouped.setdefault(row.policy, []).append(row)
    return grouped
