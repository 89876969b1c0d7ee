"""Laws that hold for every registered way of drawing goals, then what is particular to each."""

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest
from scipy.stats import chi2

from playlearn.errors import UsageError
from playlearn.relabeling import (
    UNIFORMS,
    EpisodeConfig,
    FinalConfig,
    FinalSettledConfig,
    FixedConfig,
    FutureConfig,
    GeometricConfig,
    GoalSamplerConfig,
    MixtureConfig,
    RandomConfig,
    RelabelIndex,
    SettledConfig,
    SettlingConfig,
    UniformConfig,
    WeightedSampler,
)
from tests.synthetic import ACHIEVED, FPS, QUANTITIES, make_episode

NEGATIVES = {"random", "episode"}  # HER's strategies that ask for what was not reached afterwards
KINDS = sorted(set(GoalSamplerConfig.get_known_choices()) - NEGATIVES)


def _table(lengths: tuple[int, ...] = (300, 1, 37, 200)) -> RelabelIndex:
    rng = np.random.default_rng(0)
    return RelabelIndex.build(
        [make_episode(rng, steps).achieved for steps in lengths], ACHIEVED, FPS, SettlingConfig(), QUANTITIES.achieved
    )


TABLE = _table()


def _steps(table: RelabelIndex) -> tuple[np.ndarray, np.ndarray]:
    """Every (episode, t)."""
    episodes = np.repeat(np.arange(len(table.lengths)), table.lengths)
    return episodes, np.arange(len(episodes)) - table.starts[episodes]


def _drawn(config: GoalSamplerConfig, table: RelabelIndex = TABLE, seed: int = 0) -> tuple[np.ndarray, ...]:
    """(episodes, t, goals) of every valid step."""
    sampler = config.build()
    episodes, t = _steps(table)
    valid = sampler.valid(table, episodes, t)
    episodes, t = episodes[valid], t[valid]
    uniforms = np.random.default_rng(seed).random((len(t), UNIFORMS))
    return episodes, t, sampler.draw(table, episodes, t, uniforms)


@pytest.fixture(params=KINDS)
def config(request: pytest.FixtureRequest) -> GoalSamplerConfig:
    return GoalSamplerConfig.get_choice_class(request.param)()


def test_a_goal_is_later_and_never_leaves_its_episode(config: GoalSamplerConfig) -> None:
    for seed in range(5):
        episodes, t, goals = _drawn(config, seed=seed)
        assert len(t) > 300
        assert goals.dtype == np.int64
        assert (goals > t).all()
        assert (goals <= TABLE.lengths[episodes]).all()


def test_the_extreme_numbers_stay_inside_too(config: GoalSamplerConfig) -> None:
    sampler = config.build()
    episodes, t = _steps(TABLE)
    valid = sampler.valid(TABLE, episodes, t)
    for value in (0.0, np.nextafter(1.0, 0.0)):
        goals = sampler.draw(TABLE, episodes[valid], t[valid], np.full((valid.sum(), UNIFORMS), value))
        assert (goals > t[valid]).all()
        assert (goals <= TABLE.lengths[episodes[valid]]).all()


def test_an_example_does_not_depend_on_its_batch(config: GoalSamplerConfig) -> None:
    sampler = config.build()
    episodes, t, goals = _drawn(config)
    uniforms = np.random.default_rng(0).random((len(t), UNIFORMS))
    some = np.random.default_rng(1).permutation(len(t))[:50]
    np.testing.assert_array_equal(sampler.draw(TABLE, episodes[some], t[some], uniforms[some]), goals[some])


EPISODE, NOW = 0, 50  # where the goals of the laws below are drawn; the episode has 300 steps at 20 Hz


def even(goals: object) -> dict[int, float]:
    listed = [int(goal) for goal in goals]  # type: ignore[attr-defined]
    return dict.fromkeys(listed, 1 / len(listed))


def mixed(*parts: tuple[float, Mapping[int, float]]) -> dict[int, float]:
    total: dict[int, float] = {}
    for weight, part in parts:
        for goal, share in part.items():
            total[goal] = total.get(goal, 0.0) + weight * share
    return total


MOMENTS, ENDS = (found[TABLE.settled(EPISODE)[0] > NOW] for found in TABLE.settled(EPISODE))
NEAR = even(range(51, 56))  # a quarter of a second
TENTHS = {50 + k: 0.9 ** (k - 1) * 0.1 / (1 - 0.9**250) for k in range(1, 251)}  # geometric, mean 10, cut after 250
LAWS = [
    (FinalConfig(), {300: 1.0}),
    (FinalSettledConfig(), even(range(MOMENTS[-1], 301))),
    (FixedConfig(seconds=2.0), {90: 1.0}),
    (UniformConfig(horizon=0.25), NEAR),
    (UniformConfig(horizon=100.0), even(range(51, 301))),
    (FutureConfig(), even(range(51, 301))),
    (GeometricConfig(mean=0.5), TENTHS),
    (SettledConfig(until_next_change=False), {int(MOMENTS[0]): 1.0}),
    (SettledConfig(), even(range(MOMENTS[0], ENDS[0] + 1))),
    (SettledConfig(ahead=3, until_next_change=False), even(MOMENTS[:3])),
    (
        SettledConfig(ahead=2),
        mixed(*((0.5, even(range(MOMENTS[k], ENDS[k] + 1))) for k in range(2))),
    ),
    (SettledConfig(ahead=1000, until_next_change=False), even(MOMENTS)),  # no more than are left
    (
        MixtureConfig(
            [
                WeightedSampler(SettledConfig(ahead=2, until_next_change=False), 3.0),
                WeightedSampler(UniformConfig(horizon=0.25), 2.0),
                WeightedSampler(FinalConfig(), 1.0),
            ]
        ),
        mixed((3 / 6, even(MOMENTS[:2])), (2 / 6, NEAR), (1 / 6, {300: 1.0})),
    ),
    # A share that can draw nothing here (20 s ahead of 12.5 s) is taken over by the others.
    (
        MixtureConfig(
            [
                WeightedSampler(FixedConfig(seconds=20.0), 5.0),
                WeightedSampler(UniformConfig(horizon=0.25), 1.0),
                WeightedSampler(FinalConfig(), 3.0),
            ]
        ),
        mixed((1 / 4, NEAR), (3 / 4, {300: 1.0})),
    ),
    (EpisodeConfig(), even(goal for goal in range(301) if goal != NOW)),
    (RandomConfig(), even(range(TABLE.rows[-1]))),  # episode 0 begins in row 0
]


@pytest.mark.parametrize(("config", "law"), LAWS, ids=lambda value: getattr(type(value), "__name__", ""))
def test_goals_are_distributed_as_is_said(config: GoalSamplerConfig, law: Mapping[int, float]) -> None:
    """Chi-square of 60,000 draws; by chance it would fail once in 10,000 seeds."""
    n = 60_000
    uniforms = np.random.default_rng(0).random((n, UNIFORMS))
    goals = config.build().draw(TABLE, np.full(n, EPISODE), np.full(n, NOW), uniforms)
    assert abs(sum(law.values()) - 1) < 1e-9
    assert set(goals.tolist()) <= set(law)
    expected = n * np.array(list(law.values()))
    counts = np.array([(goals == goal).sum() for goal in law])
    rare = expected < 10  # together, as the statistic asks for
    expected = np.append(expected[~rare], expected[rare].sum() or 1e-9)
    counts = np.append(counts[~rare], counts[rare].sum())
    statistic = float(((counts - expected) ** 2 / expected).sum())
    assert statistic <= max(chi2.isf(1e-4, len(expected) - 1), 1e-6)


def test_every_kind_has_its_law() -> None:
    known = {GoalSamplerConfig.get_choice_class(kind) for kind in GoalSamplerConfig.get_known_choices()}
    assert {type(config) for config, _ in LAWS} == known


@pytest.mark.parametrize("kind", ["fixed", "future", "geometric", "mixture", "uniform"])
def test_windows_are_in_seconds(kind: str) -> None:
    """Goals lie as far ahead at 100 Hz as at 20 Hz, but for whole steps: a step, and 0.5 of 60 in a geometric mean."""
    steps = 60_000  # long enough that nothing is cut at its end
    slow, fast = (
        dataclasses.replace(
            RelabelIndex.build(
                [np.zeros((steps * k + 1, 1), np.float32)], ("red.x",), FPS, SettlingConfig(), ("length x",)
            ),
            fps=FPS * k,
        )
        for k in (1, 5)
    )
    n = 1000
    uniforms = np.random.default_rng(0).random((n, UNIFORMS))
    sampler = GoalSamplerConfig.get_choice_class(kind)().build()
    at = np.zeros(n, np.int64)
    ahead = [sampler.draw(table, at, at, uniforms) / table.fps for table in (slow, fast)]
    assert (np.abs(ahead[0] - ahead[1]) <= 1.001 / FPS + 0.01 * ahead[1]).all()


def test_settled_goals_are_settled(config: GoalSamplerConfig) -> None:
    """Whatever is drawn without `hold` is the k-th next settled moment, 1 <= k <= ahead."""
    episodes, t, goals = _drawn(SettledConfig(ahead=3, until_next_change=False))
    ranks = []
    for e, now, goal in zip(episodes, t, goals, strict=True):
        moments, _ = TABLE.settled(e)
        later = moments[moments > now]
        assert goal in later
        ranks.append(int(np.flatnonzero(later == goal)[0]) + 1)
    assert set(ranks) == {1, 2, 3}


def test_hold_draws_from_the_whole_time_a_configuration_lasts() -> None:
    episodes, t, goals = _drawn(SettledConfig())
    following = TABLE.following(episodes, t)
    share = (goals - TABLE.moments[following]) / np.maximum(TABLE.ends[following] - TABLE.moments[following], 1)
    assert ((share >= 0) & (share <= 1)).all()
    # Even over the interval: its mean is 1/2, with a standard error of 0.29 / sqrt(n).
    assert abs(share.mean() - 0.5) < 4 * 0.29 / np.sqrt(len(t)) + 0.02


def test_slack_keeps_a_configuration_for_a_while_and_no_longer() -> None:
    slack = 0.25  # 5 steps
    episodes, t, goals = _drawn(SettledConfig(settle_slack=slack))
    stays = 0
    for e, now, goal in zip(episodes, t, goals, strict=True):
        moments, ends = TABLE.settled(e)
        own = np.flatnonzero(moments <= now)
        if len(own) and now <= moments[own[-1]] + 5 and now < ends[own[-1]]:
            assert now < goal <= ends[own[-1]]
            stays += 1
        else:
            assert goal >= moments[moments > now][0]
    # 5 steps past each settled moment, and the moment itself, unless the interval is shorter.
    assert 4 * len(TABLE.moments) < stays <= 6 * len(TABLE.moments)


def test_steps_after_the_last_settled_moment_are_left_out() -> None:
    """A step has a settled goal as long as a settled moment of its own episode is still to come."""
    episodes, t = _steps(TABLE)
    moments = [TABLE.settled(e)[0] for e in range(len(TABLE.lengths))]
    last = np.array([settled[-1] if len(settled) else 0 for settled in moments])
    valid = SettledConfig().build().valid(TABLE, episodes, t)
    np.testing.assert_array_equal(valid, t < last[episodes])
    assert 0 < valid.sum() < len(valid)


def test_a_store_that_never_settles_has_no_settled_goal() -> None:
    still = RelabelIndex.build(
        [np.zeros((50, 2), np.float32)], ("red.x", "red.y"), FPS, SettlingConfig(), ("length x", "length y")
    )
    for slack in (0.0, 1.0):
        assert not SettledConfig(settle_slack=slack).build().valid(still, *_steps(still)).any()


def test_final_is_the_end() -> None:
    episodes, _, goals = _drawn(FinalConfig())
    np.testing.assert_array_equal(goals, TABLE.lengths[episodes])


def test_fixed_is_always_as_far_ahead() -> None:
    episodes, t, goals = _drawn(FixedConfig(seconds=2.0))
    assert set((goals - t).tolist()) == {40}
    assert len(t) == sum(max(0, length - 39) for length in TABLE.lengths)  # t = 0 ... T - 40
    assert set(episodes.tolist()) == {0, 3}


def test_geometric_has_its_mean_and_is_cut_at_the_end() -> None:
    table = _table((20_000,))
    _, t, goals = _drawn(GeometricConfig(mean=2.0), table)
    ahead = (goals - t)[:-1000]
    # Mean 40 steps, standard deviation just below 40, so a standard error of 0.29.
    assert abs(ahead.mean() - 40) < 5 * 0.29
    # P(k <= 28) = 1 - (1 - 1/40)^28 = 0.508.
    assert abs((ahead <= 28).mean() - 0.508) < 5 * 0.0036
    assert goals[-1] == 20_000


def test_geometric_near_the_end_is_the_same_law_over_what_is_left() -> None:
    n = 20_000
    episodes, t = np.zeros(n, np.int64), np.full(n, TABLE.lengths[0] - 2)
    uniforms = np.random.default_rng(0).random((n, UNIFORMS))
    goals = GeometricConfig(mean=2.0).build().draw(TABLE, episodes, t, uniforms)
    # k is 1 or 2 with P(2) / P(1) = 1 - 1/40, so P(2) = 0.494.
    assert abs((goals == TABLE.lengths[0]).mean() - 0.494) < 5 * 0.0035


def test_mixture_goes_on_with_those_that_can() -> None:
    mixture = MixtureConfig([WeightedSampler(SettledConfig(), 0.5), WeightedSampler(FinalConfig(), 0.5)])
    episodes, t, goals = _drawn(mixture)
    assert len(t) == TABLE.lengths.sum()
    none = TABLE.following(episodes, t) == TABLE.offsets[episodes + 1]
    np.testing.assert_array_equal(goals[none], TABLE.lengths[episodes[none]])


@pytest.mark.parametrize(
    ("config", "field"),
    [
        (SettledConfig(ahead=0), "settled.ahead"),
        (SettledConfig(settle_slack=-1.0), "settled.settle_slack"),
        (UniformConfig(horizon=0.0), "uniform.horizon"),
        (GeometricConfig(mean=-1.0), "geometric.mean"),
        (FixedConfig(seconds=0.0), "fixed.seconds"),
        (MixtureConfig([]), "mixture.samplers"),
        (MixtureConfig([WeightedSampler(FinalConfig(), 0.0)]), "mixture.samplers.weight"),
    ],
)
def test_a_setting_out_of_range_is_named(config: GoalSamplerConfig, field: str) -> None:
    with pytest.raises(UsageError, match=field):
        config.build()


def test_ending_is_any_moment_of_what_lasts_until_the_end() -> None:
    """At rest from 5 on, moved between 20 and 25, at rest until 60: any goal in 25 + the rest's seconds ... 60."""
    x = np.interp(np.arange(61), [0, 20, 25, 60], [0.0, 0.0, 0.1, 0.1])
    settling = SettlingConfig(change={"default": 0.015}, rest={"default": 0.004}, rest_seconds=0.3)
    table = RelabelIndex.build([x[:, None], x[:24, None]], ("x",), FPS, settling)
    moment = int(table.moments[0])
    assert 25 <= moment <= 25 + settling.window(FPS)
    goals = np.concatenate([_drawn(FinalSettledConfig(), table, seed)[2] for seed in range(40)])
    episodes, t, _ = _drawn(FinalSettledConfig(), table)
    whole, rest = np.tile(episodes == 0, 40), np.tile(t, 40)
    assert set(goals[whole & (rest < moment)].tolist()) == set(range(moment, 61))
    assert (goals[~whole] == 23).all(), "still on the way when the recording ended: its last observation"
