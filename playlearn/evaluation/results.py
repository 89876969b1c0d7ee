"""From attempts to `results.json`, `episodes.parquet` and the report's curves and pictures."""

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


def summary(episode_results: Sequence[EpisodeResult]) -> dict[str, Any]:
    """Rates and intervals of one contender, over all episodes and by task.

    An episode of several goals is a success when the last of them is; by task each goal that was attempted counts.
    `crashed` counts failures of the machinery, each of which is among the failures too.
    """
    rates = _rates(ends(episode_results)) | {
        "crashed": sum(episode_result.reason.startswith(CRASHED) for episode_result in episode_results),
        "steps_to_success": _mean(
            [episode_result.steps for episode_result in episode_results if episode_result.success]
        ),
        "tasks": {
            task: _rates([episode_result for episode_result in episode_results if episode_result.task == task])
            for task in sorted({episode_result.task for episode_result in episode_results})
        },
    }
    return rates | (
        {"chain": chain(episode_results)} if any(episode_result.links > 1 for episode_result in episode_results) else {}
    )


def ends(episode_results: Sequence[EpisodeResult]) -> list[EpisodeResult]:
    """Each episode's last attempt, by episode: of several goals in a row the one that was not reached, if any."""
    last = {
        episode_result.episode: episode_result
        for episode_result in sorted(episode_results, key=lambda one: (one.episode, one.link))
    }
    return list(last.values())


def chain(episode_results: Sequence[EpisodeResult]) -> dict[str, Any]:
    """How many goals in a row one contender reached.

    length_mean: of the chains, the goals reached before the first that was not. Its interval is Wilson's for a share
    length_mean / links: a quantity in [0, 1] varies no more than a coin of the same mean, so it is rather too wide.
    at_least: the share of chains in which 1, 2, ... were reached. already: the share of the reached goals that were
    there before anything was done. ended_by: at which tasks chains ended, the most frequent first.
    """
    last = ends(episode_results)
    links, count = max(episode_result.links for episode_result in episode_results), len(last)
    lengths = [episode_result.link + episode_result.success for episode_result in last]
    low, high = wilson(sum(lengths) / links, count)
    reaching = [sum(length >= k for length in lengths) for k in range(1, links + 1)]
    reached = [episode_result for episode_result in episode_results if episode_result.success]
    return {
        "links": links,
        "length_mean": sum(lengths) / count,
        "length_ci95": [links * low, links * high],
        "at_least": [number / count for number in reaching],
        "at_least_ci95": [list(wilson(number, count)) for number in reaching],
        "already": sum(episode_result.already for episode_result in reached) / max(1, len(reached)),
        "ended_by": dict(
            Counter(episode_result.task for episode_result in last if not episode_result.success).most_common()
        ),
    }


def _rates(episode_results: Sequence[EpisodeResult]) -> dict[str, Any]:
    count, won = len(episode_results), sum(episode_result.success for episode_result in episode_results)
    strict = sum(episode_result.strict for episode_result in episode_results)
    return {
        "episodes": count,
        "success_rate": won / count if count else 0.0,
        "ci95": list(wilson(won, count)),
        "strict_rate": strict / count if count else 0.0,
        "strict_ci95": list(wilson(strict, count)),
    }


def _mean(values: Sequence[int]) -> float | None:
    return sum(values) / len(values) if values else None


def curve(episode_results: Sequence[EpisodeResult], max_steps: int) -> list[float]:
    """(max_steps + 1,) the share of attempts, each at one goal, that had succeeded by each step."""
    count = max(1, len(episode_results))
    return [sum(a.success and a.steps <= step for a in episode_results) / count for step in range(max_steps + 1)]


def parquet(episode_results: Sequence[EpisodeResult]) -> bytes:
    """One row an attempt."""
    rows = [asdict(episode_result) for episode_result in episode_results]
    numbers = pa.list_(pa.float64())
    kinds: dict[Any, pa.DataType] = {str: pa.string(), int: pa.int64(), bool: pa.bool_()}
    schema = pa.schema([(entry.name, kinds.get(entry.type, numbers)) for entry in fields(EpisodeResult)])
    columns = {name: [list(v) if isinstance(v := row[name], tuple) else v for row in rows] for name in schema.names}
    buffer = io.BytesIO()
    pq.write_table(pa.table(columns, schema=schema), buffer)
    return buffer.getvalue()


def to_show(episode_results: Sequence[EpisodeResult], successes: int, failures: int) -> list[EpisodeResult]:
    """The first few successes and failures of every task, by episode: the same whoever finished first."""
    chosen: list[EpisodeResult] = []
    for task in sorted({episode_result.task for episode_result in episode_results}):
        mine = sorted((a for a in episode_results if a.task == task), key=lambda episode_result: episode_result.episode)
        chosen += [a for a in mine if a.success][:successes] + [a for a in mine if not a.success][:failures]
    return chosen


def to_film(shown: Sequence[EpisodeResult], successes: int, failures: int) -> set[int]:
    """The episodes of a few short films, of as many tasks as there are: `shown` goes task by task."""
    filmed: set[int] = set()
    for wanted, success in ((successes, True), (failures, False)):
        mine = [episode_result for episode_result in shown if episode_result.success == success]
        firsts = list({episode_result.task: episode_result for episode_result in reversed(mine)}.values())[::-1]
        others = [episode_result for episode_result in mine if episode_result not in firsts]
        filmed |= {episode_result.episode for episode_result in (firsts + others)[:wanted]}
    return filmed


def by_policy(episode_results: Sequence[EpisodeResult]) -> Mapping[str, list[EpisodeResult]]:
    """Each contender's attempts in the order of the episodes."""
    grouped: dict[str, list[EpisodeResult]] = {}
    for episode_result in sorted(episode_results, key=lambda episode_result: episode_result.episode):
        grouped.setdefault(episode_result.policy, []).append(episode_result)
    return grouped
