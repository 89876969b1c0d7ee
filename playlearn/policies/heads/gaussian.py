"""One Gaussian over a chunk: the baseline that averages what has two answers."""

from dataclasses import dataclass

from playlearn.policies.heads.base import HeadConfig
from playlearn.policies.heads.mog import Gaussian, MixtureConfig, MixtureHead


@HeadConfig.register_subclass("gaussian")
@dataclass(frozen=True)
class GaussianConfig(HeadConfig):
    """hidden, std, temperature: as of the mixture, of which this is the case of one component."""

    hidden: int = 256
    std_range: tuple[float, float] = (0.1, 2.0)
    temperature: float = 1.0

    def build(self, width: int, chunk: int, actions: int) -> MixtureHead:
        mixture = MixtureConfig(1, self.hidden, self.std_range, self.temperature)
        return MixtureHead(mixture, width, chunk, actions, Gaussian())
