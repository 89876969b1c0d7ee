"""Normalization to zero mean and unit std, and back; the statistics are saved with the checkpoint."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from playlearn.batch import Statistics
from playlearn.policies.spec import PolicySpec
from playlearn.quantity import FINEST, TURN, Bounds, Quantities, difference, pools, spellings

LEAST_USED = 0.25  # of the largest share that any bounded action takes of its range


class Normalizer(nn.Module):
    """Per-dimension (x - mean) / std for `state`, `achieved` and `action`; see `scaled` for where these come from."""

    def __init__(self, statistics: Mapping[str, Statistics], quantities: Quantities | None = None) -> None:
        """statistics: of std above 0. quantities: in which spelling an angle or a quaternion may come."""
        super().__init__()
        given = quantities or Quantities()
        self._declared = {"state": given.state, "achieved": given.achieved}
        for name, one in statistics.items():
            self.register_buffer(f"{name}_mean", torch.as_tensor(one.mean, dtype=torch.float32).clone())
            self.register_buffer(f"{name}_std", torch.as_tensor(one.std, dtype=torch.float32).clone())

    def normalize(self, name: str, value: Tensor) -> Tensor:
        """(..., N) in units of the data -> (..., N) of about unit std."""
        return (value - self.get_buffer(f"{name}_mean")) / self.get_buffer(f"{name}_std")

    def restore(self, name: str, value: Tensor) -> Tensor:
        """The inverse of `normalize`."""
        return value * self.get_buffer(f"{name}_std") + self.get_buffer(f"{name}_mean")

    def together(self, name: str, past: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
        """Observations (B, T, N) and a goal (B, N) of them, normalized, in spellings that can be subtracted.

        The latest observation is spelled as is nearest to the data's mean, all else as is nearest to that.
        """
        mean, declared = self.get_buffer(f"{name}_mean"), self._declared[name]
        latest = _nearest(past[:, -1], mean, declared)
        past, goal = _nearest(past, latest.unsqueeze(1), declared), _nearest(goal, latest, declared)
        return self.normalize(name, past), self.normalize(name, goal)

    @classmethod
    def identity(cls, widths: Mapping[str, int], quantities: Quantities | None = None) -> "Normalizer":
        """One that changes nothing: the shapes to load a checkpoint's statistics into."""
        return cls({name: Statistics(np.zeros(n), np.ones(n)) for name, n in widths.items()}, quantities)


def scaled(statistics: Mapping[str, Statistics], spec: PolicySpec) -> dict[str, Statistics]:
    """What to normalize by: of `state` and `achieved` by quantity, of actions by how much of their range is used.

    What does not vary of `state` and `achieved` is only shifted, and so is a dimension of declared unit whose std is
    below `FINEST`: dividing by a tiny std would amplify rounding noise to the size of a signal. A dimension whose unit
    nobody declared is normalized by its own std, at whatever scale.
    """
    state, achieved = (statistics[name] for name in ("state", "achieved"))
    declared = {
        "state": spec.quantities.of("state", len(state.std)),
        "achieved": spec.quantities.of("achieved", len(achieved.std)),
    }
    made = _pooled({"state": state, "achieved": achieved}, declared)
    shifted = {name: _only_shifted(one, declared[name]) for name, one in made.items()}
    if spec.predicts == "actions":
        return {**shifted, "action": _in_own_units(_floored(statistics["action"], spec.bounds))}
    return {**shifted, "action": _only_shifted(statistics["action"], declared["achieved"])}


def _only_shifted(given: Statistics, declared: Sequence[str]) -> Statistics:
    """With a std of 1 where a dimension does not vary, or by less than counts in its unit."""
    floor = np.array([FINEST if text else 0.0 for text in declared])
    flat = ~given.varies | (given.std < floor)
    return Statistics(given.mean, np.where(flat, np.float32(1), given.std))


def _in_own_units(given: Statistics) -> Statistics:
    """With a std for each action that does not vary: its own size, or the least std of those that do.

    What is predicted is off by some share of a std: by a 1 of no unit it would be off by any number of times its size.
    """
    varies, sizes = given.varies, np.abs(given.mean)
    least = given.std[varies].min() if varies.any() else np.float32(1)
    return Statistics(given.mean, np.where(varies, given.std, np.where(sizes > 0, sizes, least)))


def _floored(given: Statistics, bounds: Bounds) -> Statistics:
    """With at least `LEAST_USED` times the largest share of its range for each bounded action.

    An action that is hardly used (the tilt of a gripper that stays upright) would otherwise weigh as much in the loss
    as the others. Without bounds nobody knows what is little.
    """
    reach = np.array([np.nan if pair is None else (pair[1] - pair[0]) / 2 for pair in bounds], np.float32)
    if not len(reach) or np.isnan(reach).all():
        return given
    shares = np.where(given.varies, given.std, 0) / reach
    least = np.float32(LEAST_USED) * np.nanmax(shares) * reach
    return Statistics(given.mean, np.where(np.isnan(reach), given.std, np.fmax(given.std, least)))


def _pooled(statistics: Mapping[str, Statistics], declared: Mapping[str, Sequence[str]]) -> dict[str, Statistics]:
    """The same, with one mean and std for all dimensions that are declared to measure the same.

    Then a normalized difference of two of them means the same distance, whichever two they are. Those that vary
    decide. One that does not (a button's place) takes what they have; it is left as it is where none of them varies.
    """
    rows = [(name, k, text) for name, own in declared.items() for k, text in enumerate(own)]
    made = {name: Statistics(np.array(given.mean), np.array(given.std)) for name, given in statistics.items()}
    for pool in pools([text for _, _, text in rows]):
        own = [rows[member] for member in pool]
        moving = [(name, k) for name, k, _ in own if statistics[name].varies[k]]
        if len(own) == 1 or not moving:
            continue
        means = np.array([statistics[name].mean[k] for name, k in moving], float)
        stds = np.array([statistics[name].std[k] for name, k in moving], float)
        middle = means.mean()
        apart = difference(means[:, None], np.array([middle]), (own[0][2],))[:, 0]
        for name, k, _ in own:
            made[name].mean[k] = middle
            made[name].std[k] = np.sqrt((stds**2 + apart**2).mean())
    return made


def _nearest(value: Tensor, reference: Tensor, declared: Sequence[str]) -> Tensor:
    """`quantity.nearest` of tensors."""
    angles, quaternions = spellings(declared)
    if not angles and not quaternions:
        return value
    reference = reference.expand_as(value)
    spelled = value.clone()
    spelled[..., angles] -= TURN * ((value - reference)[..., angles] / TURN).round()
    for own in quaternions:
        apart = (value[..., own] * reference[..., own]).sum(-1, keepdim=True) < 0
        spelled[..., own] = torch.where(apart, -value[..., own], value[..., own])
    return spelled
