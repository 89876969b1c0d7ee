"""Laws that hold for every registered way of drawing goals, then what is particular to each."""

import numpy as np
import pytest

from playlearn.errors import UsageError
from playlearn.relabel import (
    UNIFORMS,
    FinalConfig,
    FixedConfig,
    GeometricConfig,
    GoalSamplerConfig,
    MixtureConfig,
    SettledConfig,
    SettlingConfig,
    Share,
    Table,
    UniformConfig,
)
from tests.synthetic import ACHIEVED, FPS, make_episode

NEGATIVES = {"random", "episode"}  # HER's strategies that ask for what was not reached afterwards
KINDS = sorted(set(GoalSamplerConfig.get_known_choices()) - NEGATIVES)


def _table(lengths: tuple[int, ...] = (300, 1, 37, 200)) -> Table:
    rng = np.random.default_rng(0)
    return Table.build([make_episode(rng, steps).achieved for steps in lengths], ACHIEVED, FPS, SettlingConfig())


TABLE = _table()


def _steps(table: Table) -> tuple[np.ndarray, np.ndarray]:
    """Every (episode, t)."""
    episodes = np.repeat(np.arange(len(table.lengths)), table.lengths)
    return episodes, np.arange(len(episodes)) - table.starts[episodes]


def _drawn(config: GoalSamplerConfig, table: Table = TABLE, seed: int = 0) -> tuple[np.ndarray, ...]:
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


@pytest.mark.parametrize("kind", sorted(NEGATIVES))
def test_negatives_are_even_over_where_they_come_from(kind: str) -> None:
    """Chi-square over 20 equal parts: 19 degrees of freedom have mean 19 and standard deviation 6.2."""
    config = GoalSamplerConfig.get_choice_class(kind)()
    table = _table((400, 400))
    sampler, n = config.build(), 40_000
    episodes, t = np.ones(n, np.int64), np.full(n, 399)
    uniforms = np.random.default_rng(0).random((n, UNIFORMS))
    rows = table.rows[1] + sampler.draw(table, episodes, t, uniforms)
    low, high = {"random": (0, 802), "episode": (401, 802)}[kind]
    assert rows.min() >= low
    assert rows.max() < high
    if kind == "episode":
        assert (rows != 401 + 399).all()  # never where it stands
    counts, _ = np.histogram(rows, bins=20, range=(low, high))
    width = np.diff(np.ceil(np.linspace(low, high, 21)))  # rows in each part
    expected = n * width / width.sum()
    assert ((counts - expected) ** 2 / expected).sum() < 19 + 5 * 6.2


def test_settled_goals_are_settled(config: GoalSamplerConfig) -> None:
    """Whatever is drawn without `hold` is the k-th next settled moment, 1 <= k <= ahead."""
    episodes, t, goals = _drawn(SettledConfig(ahead=3, hold=False))
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
    sampler = SettledConfig().build()
    episodes, t = _steps(TABLE)
    np.testing.assert_array_equal(
        sampler.valid(TABLE, episodes, t), np.concatenate([TABLE.valid(e) for e in range(len(TABLE.lengths))])
    )


def test_a_store_that_never_settles_has_no_settled_goal() -> None:
    still = Table.build([np.zeros((50, 2), np.float32)], ("red.x", "red.y"), FPS, SettlingConfig())
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


def test_uniform_is_even_over_its_horizon() -> None:
    table = _table((4000,))
    _, t, goals = _drawn(UniformConfig(horizon=0.5), table)
    counts = np.bincount((goals - t)[:-10], minlength=11)
    assert counts[0] == 0
    # 10 equally likely distances: 400 each, standard deviation 19.
    assert (np.abs(counts[1:] - counts.sum() / 10) < 5 * 19).all()


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


def test_mixture_keeps_its_shares() -> None:
    table = _table((4000,))
    mixture = MixtureConfig([Share(FinalConfig(), 3.0), Share(FixedConfig(seconds=0.05), 1.0)])
    _, t, goals = _drawn(mixture, table)
    final = (goals == 4000)[:-1].mean()
    assert abs(final - 0.75) < 5 * 0.0069  # sqrt(0.75 * 0.25 / 4000)
    assert (goals[goals != 4000] == t[goals != 4000] + 1).all()


def test_mixture_goes_on_with_those_that_can() -> None:
    mixture = MixtureConfig([Share(SettledConfig(), 0.5), Share(FinalConfig(), 0.5)])
    episodes, t, goals = _drawn(mixture)
    assert len(t) == TABLE.lengths.sum()
    none = TABLE.following(episodes, t) == TABLE.offsets[episodes + 1]
    np.testing.assert_array_equal(goals[none], TABLE.lengths[episodes[none]])


def test_a_mixed_strategy_draws_as_it_does_alone() -> None:
    """The number that chose a strategy is again even over [0, 1) inside it."""
    table = _table((4000,))
    _, t, goals = _drawn(MixtureConfig([Share(FinalConfig(), 1.0), Share(UniformConfig(horizon=0.5), 1.0)]), table)
    counts = np.bincount((goals - t)[goals < 3990], minlength=11)[1:11]
    # About 2,000 draws over 10 distances: 200 each, standard deviation 13.
    assert (np.abs(counts - counts.sum() / 10) < 5 * 13).all()


@pytest.mark.parametrize(
    ("config", "field"),
    [
        (SettledConfig(ahead=0), "settled.ahead"),
        (SettledConfig(settle_slack=-1.0), "settled.settle_slack"),
        (UniformConfig(horizon=0.0), "uniform.horizon"),
        (GeometricConfig(mean=-1.0), "geometric.mean"),
        (FixedConfig(seconds=0.0), "fixed.seconds"),
        (MixtureConfig([]), "mixture.shares"),
        (MixtureConfig([Share(FinalConfig(), 0.0)]), "mixture.shares.weight"),
    ],
)
def test_a_setting_out_of_range_is_named(config: GoalSamplerConfig, field: str) -> None:
    with pytest.raises(UsageError, match=field):
        config.build()
