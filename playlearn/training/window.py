"""Metrics between two lines of the log."""

from collections.abc import Mapping

from torch import Tensor


class Window:
    """Running means of metrics, kept on the device until they are asked for."""

    def __init__(self) -> None:
        self.sums: dict[str, Tensor] = {}
        self.count = 0
        self.latest: dict[str, float] = {}

    def add(self, metrics: Mapping[str, Tensor]) -> None:
        for name, value in metrics.items():
            self.sums[name] = self.sums[name] + value if name in self.sums else value
        self.count += 1

    def means(self) -> dict[str, float]:
        """Since the last call."""
        self.latest = {name: float(value) / self.count for name, value in self.sums.items()}
        self.sums, self.count = {}, 0
        return self.latest
