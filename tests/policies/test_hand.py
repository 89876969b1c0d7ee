"""Laws of the encoder that learns where the hand goes: what it reads, in training and in acting, and how it moves."""

import dataclasses

import pytest
import torch

from playlearn.batch import EVENTS
from playlearn.errors import UsageError
from playlearn.policies.encoders.hand import EventEstimator, hand_dimensions
from playlearn.quantity import Quantities
from tests.policies.parts import SPEC, S, examples, generator, policy


def calibrated(channels: int = 8, size: tuple[int, int] = (32, 48)) -> EventEstimator:
    torch.manual_seed(0)
    estimate = EventEstimator(S, [0, 1], channels, size)
    estimate.get_buffer("projection")[1:3] = torch.tensor([[0.3, 0.0], [0.0, 0.3]])  # x and y are seen as they are
    return estimate


def test_true_events_teach_the_estimator_and_estimates_are_acted_on() -> None:
    """What is learned of acting does not depend on the recording's future, in training as in acting."""
    made = policy("hand").train()
    batch = examples()
    other = dataclasses.replace(batch, events=examples(seed=5).events)
    parts = [made(one, generator())[1] for one in (batch, other)]
    assert torch.equal(parts[0]["head"], parts[1]["head"])
    assert not torch.equal(parts[0]["state"], parts[1]["state"])
    made.eval()
    plain = made.act(batch, generator())
    assert torch.equal(made.act(dataclasses.replace(batch, events={}), generator()), plain)
    seen = dataclasses.replace(batch, goal_images=examples(seed=5).goal_images)
    assert not torch.equal(made.act(seen, generator()), plain)


def test_the_policy_does_not_bend_the_estimates() -> None:
    made = policy("hand").train()
    made(dataclasses.replace(examples(), events={}), generator())[0].backward()
    grown = {name for name, one in made.named_parameters() if one.grad is not None}
    assert not any(name.startswith("encoder.estimate.") for name in grown)
    assert grown == {name for name, _ in made.named_parameters() if not name.startswith("encoder.estimate.")}


def test_what_does_not_lie_ahead_is_read_as_nothing() -> None:
    """An event that is over tells nothing of where it was: whatever stands there, the tokens are the same."""
    made = policy("hand").eval()
    over = {name: torch.full((5, S), torch.nan) for name in EVENTS}
    batch = dataclasses.replace(examples(), events=over)
    made.encoder.estimate.ahead[-1].bias.data.fill_(-100.0)
    plain = made.act(batch, generator())
    made.encoder.estimate.answer[-1].bias.data += 3.0
    assert torch.equal(made.act(batch, generator()), plain)
    loss, parts = policy("hand").train()(batch, generator())
    assert torch.isfinite(loss)
    assert float(parts["where"]) == float(parts["state"]) == float(parts["refined"]) == 0


def test_shifted_images_are_matched_by_shifted_cells() -> None:
    """Labels move with the images, so the loss of a drawn scene is the same wherever in the image it is drawn."""
    estimate = calibrated()
    frames = torch.zeros(1, 32, 48, 3, dtype=torch.uint8)
    frames[:, 12:16, 20:24] = 200
    goal, state = torch.zeros_like(frames), torch.zeros(1, S)
    goal[:, 16:20, 28:32] = 200
    moved = torch.tensor([[[-4]], [[-4]]])  # the picture goes down and right by a cell
    here = estimate(frames, goal, state, None)
    there = estimate(frames.roll((4, 4), (1, 2)), goal.roll((4, 4), (1, 2)), state, moved)
    assert torch.allclose(there.shift, torch.tensor([[-8 / 48, -8 / 32]]))
    states = [one.states.unflatten(2, (8, 12)) for one in (here, there)]
    assert torch.allclose(states[0][:, :, 3:5, 4:7], states[1][:, :, 4:6, 5:8], atol=0.2)


@pytest.mark.parametrize("size", [(32, 48), (34, 50)])  # whole cells, and sides that none divides
def test_cells_learn_where_events_are_seen(size: tuple[int, int]) -> None:
    """A white block in the observation is grasped, one in the goal is where it goes."""
    (height, width), estimate, rng = size, calibrated(size=size), generator()
    optimizer = torch.optim.Adam(estimate.parameters(), lr=3e-3)

    def scenes(count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, dict[str, torch.Tensor]]:
        frames = torch.full((2, count, height, width, 3), 100, dtype=torch.uint8)
        events = {}
        for which, name in enumerate(EVENTS):
            rows, columns = torch.randint(2, 28, (count,), generator=rng), torch.randint(2, 44, (count,), generator=rng)
            for k in range(count):
                frames[which, k, rows[k] - 2 : rows[k] + 2, columns[k] - 2 : columns[k] + 2] = 255
            place = torch.stack([2 * columns / width - 1, 2 * rows / height - 1], 1) / 0.3
            events[name] = torch.cat([place, torch.zeros(count, S - 2)], 1)
        return frames[0], frames[1], torch.zeros(count, S), events

    for _ in range(120):
        frames, goal, state, events = scenes(16)
        loss = sum(estimate.loss(estimate(frames, goal, state, None), events).values(), torch.zeros(()))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    frames, goal, state, events = scenes(64)
    with torch.no_grad():
        found = estimate.most_likely(estimate(frames, goal, state, None))
    for name in EVENTS:
        apart = (found[name] - events[name])[:, :2].abs().max(1).values * 0.3 * width / 2  # pixels
        assert apart.nanmedian() < 3


def test_where_the_hand_is_decides_where_declared() -> None:
    assert hand_dimensions(SPEC) == [0, 1, 2]
    declared = Quantities(state=("length x", "length y", "direction r00", "length z", "length opening"))
    spec = dataclasses.replace(SPEC, state_names=tuple("abcde"), quantities=declared)
    assert hand_dimensions(spec) == [0, 1, 3]


def test_a_goal_is_an_image() -> None:
    with pytest.raises(UsageError, match="reads goal images only"):
        policy("hand", encoder_options={"goal": "both"})
