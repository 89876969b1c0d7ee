"""Laws of the heads."""

import functools

import pytest
import torch

from playlearn.policies.heads import (
    AutoregressiveConfig,
    CVAEConfig,
    DeterministicConfig,
    DiffusionConfig,
    FastConfig,
    FlowConfig,
    GaussianConfig,
    Guidance,
    Head,
    HeadConfig,
    LatentPlanConfig,
    LogisticConfig,
    MixtureConfig,
    draw_noise,
    masked_mean,
)
from tests.policies.parts import generator


def test_masked_mean_counts_what_it_should() -> None:
    error = torch.tensor([[[1.0, 3.0], [float("nan"), 100.0]]])
    assert masked_mean(error, torch.tensor([[True, False]])) == 2.0  # (1 + 3) / 2
    assert masked_mean(error, torch.tensor([[False, False]])) == 0.0


def test_noise_of_a_row_is_its_own_generators() -> None:
    rows = draw_noise((3, 2, 2), [generator(seed) for seed in (5, 6, 7)], torch.device("cpu"))
    assert torch.equal(rows[1], torch.randn(2, 2, generator=generator(6)))


@pytest.mark.parametrize(("loss", "expected"), [("l1", 0.0), ("mse", 0.25)])
def test_the_deterministic_head_finds_the_median_or_the_mean(loss: str, expected: float) -> None:
    """Of actions 0, 0, 0 and 1 the median is 0 and the mean is 0.25."""
    torch.manual_seed(0)
    head = DeterministicConfig(loss=loss, hidden=0).build(1, 1, 1)  # type: ignore[arg-type]
    optimizer = torch.optim.Adam(head.parameters(), lr=0.02)
    chunk = torch.tensor([0.0, 0, 0, 1]).view(4, 1, 1)
    for _ in range(300):
        optimizer.zero_grad()
        value, _ = head.loss(torch.ones(4, 1), chunk, torch.ones(4, 1, dtype=torch.bool), generator())
        value.backward()
        optimizer.step()
    assert head.mode(torch.ones(1, 1)).item() == pytest.approx(expected, abs=0.03)


def taught_two_modes(config: HeadConfig, updates: int = 400, *, settle: bool = False) -> Head:
    """A head that has seen whole chunks (2, 1) of -1 (a quarter of them) and of +1 (three quarters).

    settle: let the rate fall to nothing, so that what comes out is not the last few examples'.
    """
    torch.manual_seed(0)
    head = config.build(2, 2, 1)
    optimizer = torch.optim.Adam(head.parameters(), lr=3e-3)
    last = 0.0 if settle else 1.0
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, last, updates)
    rng = generator(1)
    for update in range(updates):
        head.updates = update
        sign = torch.where(torch.rand(64, generator=rng) < 0.75, 1.0, -1.0)
        chunk = sign.view(64, 1, 1).expand(64, 2, 1)
        optimizer.zero_grad()
        loss, _ = head.loss(torch.ones(64, 2), chunk, torch.ones(64, 2, dtype=torch.bool), rng)
        loss.backward()
        optimizer.step()
        schedule.step()
    return head


MULTIMODAL = {
    "diffusion": DiffusionConfig(width=64, blocks=2, train_steps=50, sample_steps=10, clip=1.2),
    "diffusion of noise": DiffusionConfig(
        width=64, blocks=2, train_steps=50, prediction="epsilon", sample_steps=10, clip=1.2
    ),
    "diffusion of v": DiffusionConfig(
        width=64, blocks=2, train_steps=50, prediction="v_prediction", sample_steps=10, clip=1.2
    ),
    "flow": FlowConfig(width=64, blocks=2, sample_steps=20),
    "mixture": MixtureConfig(components=3, hidden=32),
    "logistic": LogisticConfig(components=3, bins=32, hidden=32),
    "autoregressive": AutoregressiveConfig(bins=32, width=32, layers=1, label_smoothing_bins=0.0),
    "fast": FastConfig(vocabulary=300, width=32, layers=1),
    "autoregressive, a step at a time": AutoregressiveConfig(
        bins=32, order="step", width=32, layers=1, label_smoothing_bins=0.0
    ),
}


WEIGHED = ("diffusion", "flow")  # those of which the shares of the modes are asked more closely


@functools.cache
def settled_on_two_modes(name: str) -> Head:
    """It takes seconds, and is the same every time."""
    return taught_two_modes(MULTIMODAL[name], updates=600, settle=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", MULTIMODAL)
def test_a_multimodal_head_recovers_two_modes(name: str) -> None:
    """Samples must be near -1 or +1, by whole chunks, and never between.

    The mean, 0.5, is what a regression would say. Of 400 samples 300 +- 9 (one standard deviation) are
    expected at +1; 60 allows for a network trained for a second.
    """
    head = settled_on_two_modes(name) if name in WEIGHED else taught_two_modes(MULTIMODAL[name])
    with torch.no_grad():
        drawn = head.sample(torch.ones(400, 2), generator(2)).squeeze(-1)  # (400, 2)
    assert ((drawn.abs() - 1).abs() < 0.25).float().mean() > 0.95
    assert (drawn[:, 0].sign() == drawn[:, 1].sign()).float().mean() > 0.95
    assert (drawn[:, 0] > 0).sum().item() == pytest.approx(300, abs=60)


def test_one_gaussian_averages_two_modes() -> None:
    """What the others are for: mean 0.5 and standard deviation sqrt(0.75), where there is no data at all."""
    head = taught_two_modes(GaussianConfig(hidden=32))
    assert head.mode(torch.ones(1, 2)).flatten().tolist() == pytest.approx([0.5, 0.5], abs=0.1)
    drawn = head.sample(torch.ones(2000, 2), generator(2))
    assert drawn.std().item() == pytest.approx(0.75**0.5, abs=0.08)


LIKELY = {
    "gaussian": GaussianConfig(hidden=8),
    "mixture": MixtureConfig(components=3, hidden=8, std_range=(0.2, 0.8)),
    "logistic": LogisticConfig(components=3, bins=20, hidden=8),
    "autoregressive": AutoregressiveConfig(bins=20, width=16, layers=1, top_p=1.0),
}


@pytest.mark.parametrize("name", LIKELY)
@pytest.mark.parametrize("dimensions", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_likelihood_integrates_to_one_and_is_what_is_sampled(name: str, dimensions: int) -> None:
    """Quadrature over [-10, 10], where spreads are at most 2 and means near 0, and the mean of 20,000 samples."""
    torch.manual_seed(3)
    head = LIKELY[name].build(4, dimensions, 1).double()
    features = torch.randn(1, 4, generator=generator(4)).double()
    axis = torch.arange(-9.975, 10, 0.05).double()  # the middles of 400 cells
    grid = torch.cartesian_prod(*[axis] * dimensions).view(-1, dimensions, 1)
    mask = torch.ones(len(grid), dimensions, dtype=torch.bool)
    with torch.no_grad():
        density = head.log_prob(features.expand(len(grid), -1), grid, mask).exp()  # type: ignore[operator]
        drawn = head.sample(features.expand(20000, -1), generator(5)).squeeze(-1)
    cell = float(axis[1] - axis[0]) ** dimensions
    assert float(density.sum()) * cell == pytest.approx(1.0, abs=1e-3)
    expected = (density[:, None] * grid.squeeze(-1)).sum(0) * cell
    torch.testing.assert_close(drawn.mean(0).double(), expected, atol=0.05, rtol=0)
    squares = (density[:, None] * (grid.squeeze(-1) - expected).square()).sum(0) * cell
    bin_share = {"logistic": 0.5**2 / 12, "autoregressive": 0.5**2 / 12}.get(name, 0.0)  # draws are bins' middles
    torch.testing.assert_close(drawn.var(0).double(), squares - bin_share, atol=0.0, rtol=0.05)


def test_a_masked_step_is_integrated_out() -> None:
    """Of two independent steps, hiding the second leaves the first's own density."""
    torch.manual_seed(0)
    head = GaussianConfig(hidden=8).build(4, 2, 1)
    features = torch.randn(1, 4, generator=generator())
    chunk = torch.tensor([[[0.3], [9.0]]])
    first = head.log_prob(features, chunk, torch.tensor([[True, False]]))
    second = head.log_prob(features, chunk, torch.tensor([[False, True]]))
    torch.testing.assert_close(first + second, head.log_prob(features, chunk, torch.tensor([[True, True]])))
    assert head.log_prob(features, chunk, torch.tensor([[False, False]])) == 0


def test_both_samplers_end_where_a_perfect_denoiser_points() -> None:
    """If the denoiser always answers with the clean chunk c, every sampler must return c."""

    class Oracle(torch.nn.Module):
        def forward(self, noisy: torch.Tensor, time: torch.Tensor, features: torch.Tensor) -> torch.Tensor:
            return features.expand_as(noisy)

    for sampler in ("ddim", "dpm"):
        head = DiffusionConfig(sampler=sampler, sample_steps=8).build(4, 2, 2)  # type: ignore[arg-type]
        head.denoiser = Oracle()
        clean = torch.randn(3, 4, generator=generator())
        torch.testing.assert_close(head.sample(clean, generator(1)).flatten(1), clean, atol=0.05, rtol=0)


class KnowsTheGaussian(torch.nn.Module):
    """The best guess of the clean chunk where the data is N(mean, spread^2): a line through what is seen.

    Seen is x = sqrt(a) c + sqrt(1 - a) noise, so that E[c | x] = mean + g (x - sqrt(a) mean) with
    g = sqrt(a) spread^2 / (a spread^2 + 1 - a).
    """

    def __init__(self, kept: torch.Tensor, mean: float, spread: float) -> None:
        super().__init__()
        self.kept, self.mean, self.spread = kept, mean, spread

    def forward(self, noisy: torch.Tensor, time: torch.Tensor, features: torch.Tensor) -> torch.Tensor:
        a = self.kept[time].unsqueeze(-1)
        gain = a.sqrt() * self.spread**2 / (a * self.spread**2 + 1 - a)
        return self.mean + gain * (noisy - a.sqrt() * self.mean)


@pytest.mark.parametrize("sampler", ["ddim", "dpm"])
def test_all_steps_of_a_sampler_bring_noise_to_the_gaussian_that_is_known(sampler: str) -> None:
    """With the best denoiser of N(0.4, 0.3^2) the path without noise ends in c = 0.4 + 0.3 z of its first draw z.

    Zero noise must end in the mean itself, which is where DDPM's mean path ends too; the spread of many draws
    must be 0.3. The noisiest step keeps a little of the clean chunk, so z is seen up to some per cent.
    """
    mean, spread = 0.4, 0.3
    head = DiffusionConfig(train_steps=200, sample_steps=200, sampler=sampler).build(4, 2, 1)  # type: ignore[arg-type]
    kept = head.noiser.alphas_cumprod
    head.denoiser = KnowsTheGaussian(kept, mean, spread)
    features = torch.zeros(4000, 4)
    with torch.no_grad():
        drawn = head.sample(features, generator(1))
        middle = head.mode(features[:1])
        # DDPM's own mean path: the mean of q(x_{t-1} | x_t, c) at every step, from zero noise
        path = torch.zeros(1, 2, 1)
        for t in range(199, -1, -1):
            before = kept[t - 1] if t else torch.tensor(1.0)
            alpha = kept[t] / before
            clean = head.denoiser(path.flatten(1).unsqueeze(0), torch.full((1, 1), t), features)[0].view(1, 2, 1)
            path = (before.sqrt() * (1 - alpha) * clean + alpha.sqrt() * (1 - before) * path) / (1 - kept[t])
    torch.testing.assert_close(middle, path, atol=0.01, rtol=0)
    torch.testing.assert_close(middle, torch.full_like(middle, mean), atol=0.01, rtol=0)
    assert drawn.mean().item() == pytest.approx(mean, abs=0.015)
    assert drawn.std().item() == pytest.approx(spread, abs=0.015)
    torch.testing.assert_close(
        drawn, mean + spread * draw_noise(drawn.shape, generator(1), drawn.device), atol=0.06, rtol=0
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", WEIGHED)
def test_mode_weights_come_out_within_a_twentieth(name: str) -> None:
    """A quarter of the data is at -1: of 4,000 draws 0.25 +- 0.007 (one standard deviation) are expected there."""
    head = settled_on_two_modes(name)
    with torch.no_grad():
        drawn = head.sample(torch.ones(4000, 2), generator(2)).squeeze(-1)
    assert (drawn[:, 0] < 0).float().mean().item() == pytest.approx(0.25, abs=0.05)


def test_guidance_extrapolates_from_without_to_with_the_goal() -> None:
    guide = Guidance(torch.zeros(1, 1), weight=3.0)
    assert guide.combine(torch.tensor(2.0), torch.tensor(1.0)) == 4.0  # 1 + 3 (2 - 1)


def test_the_bins_of_a_logistic_share_one_out() -> None:
    """Of two numbers, the shares of all 12 x 12 pairs of bins, each density times the bin's area, sum to one.

    Whatever the weights, and with a spread so small that nearly all is in one bin, or in the tails beyond the last.
    """
    data = torch.rand(200, 1, 2, generator=generator()) * torch.tensor([1.0, 3.0]) - 0.5
    for spread in ((0.001, 0.002), (0.5, 1.0), (50.0, 60.0)):
        torch.manual_seed(0)
        head = LogisticConfig(components=3, bins=12, hidden=8, scale_range=spread).build(4, 1, 2).double()
        head.fit_action_statistics(data.double())
        low, width = head.law.get_buffer("low"), head.law.get_buffer("width")
        middles = low + (torch.arange(12)[:, None] + 0.5) * width  # (12, 2)
        grid = torch.cartesian_prod(middles[:, 0], middles[:, 1]).unsqueeze(1)  # (144, 1, 2)
        features = torch.randn(1, 4, generator=generator(1)).double().expand(144, -1)
        mask = torch.ones(144, 1, dtype=torch.bool)
        share = head.log_prob(features, grid, mask).exp() * width.prod()
        assert share.sum().item() == pytest.approx(1.0, abs=1e-9)
        beyond = grid + 12 * width
        assert (head.log_prob(features, beyond, mask) == -torch.inf).all()
        assert head.loss(features, beyond, mask, generator())[0].isfinite()


@pytest.mark.parametrize("binning", ["uniform", "quantile"])
def test_made_words_and_numbers_again_an_action_is_at_most_half_a_bin_off(binning: str) -> None:
    head = AutoregressiveConfig(bins=16, binning=binning, width=8, layers=1, heads=1).build(4, 3, 2)  # type: ignore[arg-type]
    chunk = torch.randn(50, 3, 2, generator=generator()) * torch.tensor([1.0, 0.2])
    head.fit_action_statistics(chunk)
    tokens = head.tokens(chunk)
    edges = head.get_buffer("edges")
    width = (edges[:, 1:] - edges[:, :-1])[torch.arange(2), tokens]
    assert ((head.numbers(tokens) - chunk).abs() <= width / 2 + 1e-4).all()
    if binning == "quantile":  # 300 numbers in 2 x 16 bins: each holds its share, 9.4
        counts = torch.stack([torch.bincount(tokens[..., a].flatten(), minlength=16) for a in range(2)])
        assert counts.min() >= 7


@pytest.mark.parametrize("order", ["token", "step", "parallel"])
def test_decoding_with_a_cache_is_decoding_without(order: str) -> None:
    """Every word chosen turn by turn is the likeliest one in a single pass over all of them."""
    torch.manual_seed(1)
    head = AutoregressiveConfig(bins=8, order=order, width=16, layers=2, heads=2).build(4, 3, 2)  # type: ignore[arg-type]
    features = torch.randn(5, 4, generator=generator())
    with torch.no_grad():
        tokens = head.tokens(head.mode(features))
        again = head._logits(features, tokens).argmax(-1)
    assert torch.equal(tokens, again)


def smooth(count: int, steps: int, actions: int) -> torch.Tensor:
    """Slow waves, of about unit spread."""
    phase, speed = (torch.rand(count, 1, actions, generator=generator(seed)) for seed in (1, 2))
    return 1.4 * torch.sin(6.3 * phase + 0.2 * speed * torch.arange(steps)[:, None])


def test_a_sentence_is_the_chunk_to_its_rounding_and_shorter_than_its_numbers() -> None:
    """A coefficient is at most half a step of 1 / 10 off, and the transform keeps lengths: sqrt(H A) / 20 in all.

    Learned words make a smooth chunk of 16 x 3 numbers less than half as long; without them every number is a word.
    """
    head = FastConfig(width=8, layers=1, heads=1).build(4, 16, 3)
    chunk = smooth(500, 16, 3)
    assert head.token_ids_of(chunk).shape == (500, 16 * 3 + 1)
    head.fit_action_statistics(chunk)
    said = head.token_ids_of(chunk)
    off = (head.numbers(said) - chunk).flatten(1).norm(dim=1)
    assert off.max() <= (16 * 3) ** 0.5 / 20 + 1e-4
    assert (said != head.end).sum(1).float().mean() < 16 * 3 / 2


def test_a_sentence_that_says_too_little_or_too_much_still_is_a_chunk() -> None:
    head = FastConfig(width=8, layers=1, heads=1).build(4, 4, 2)
    zero = head.token_ids_of(torch.zeros(1, 4, 2))[:, :1]
    nothing, much = torch.full((1, 1), head.end), zero.repeat(1, 30)
    for said in (nothing, much):
        assert torch.equal(head.numbers(said), torch.zeros(1, 4, 2))


def test_sentences_are_saved_with_the_weights_and_said_with_a_cache_as_without() -> None:
    torch.manual_seed(1)
    config = FastConfig(vocabulary=300, width=16, layers=2, heads=2)
    head, other = config.build(4, 8, 2), config.build(4, 8, 2)
    head.fit_action_statistics(smooth(200, 8, 2))
    other.load_state_dict(head.state_dict())
    features, words = torch.randn(5, 4, generator=generator()), []
    heard = other.numbers
    other.numbers = lambda said: (words.append(said), heard(said))[1]  # type: ignore[method-assign,func-returns-value]
    with torch.no_grad():
        assert torch.equal(other.mode(features), head.mode(features))
        said = words[0]
        before = torch.nn.functional.pad(other.token_embedding(said[:, :-1]), (0, 0, 1, 0))
        hidden = other.in_proj(features).unsqueeze(1) + other.pos_embedding[: said.shape[1]] + before
        assert torch.equal(other.out_proj(other.decoder(hidden)).argmax(-1), said)


@pytest.mark.slow
def test_a_proposed_plan_is_one_that_was_recognized() -> None:
    """With two answers in the data, its draws lead to both, in their shares, and seldom to what is between."""
    head = taught_two_modes(LatentPlanConfig(latent=2, hidden=32, kl=0.1), updates=1000)
    with torch.no_grad():
        drawn = head.sample(torch.ones(400, 2), generator(2)).squeeze(-1)
    assert ((drawn.abs() - 1).abs() < 0.25).float().mean() > 0.75
    assert (drawn[:, 0] > 0).sum().item() == pytest.approx(300, abs=60)


@pytest.mark.slow
def test_the_latent_matters_where_there_are_two_answers() -> None:
    """And chooses between them. It is continuous, so some of it must lead to what lies between: here one in eight."""
    head = taught_two_modes(CVAEConfig(latent=2, hidden=32, kl=0.1, warmup=100), updates=1500)
    chunk = torch.tensor([1.0, -1.0]).repeat(50).view(100, 1, 1).expand(100, 2, 1)
    with torch.no_grad():
        _, metrics = head.loss(torch.ones(100, 2), chunk, torch.ones(100, 2, dtype=torch.bool), generator())
        drawn = head.sample(torch.ones(400, 2), generator(2)).squeeze(-1)
    assert metrics["z_matters"] > 2  # with the other answer's z the error is three times as large or more
    assert ((drawn.abs() - 1).abs() < 0.25).float().mean() > 0.75
    assert (drawn[:, 0] > 0).sum().item() == pytest.approx(300, abs=60)
