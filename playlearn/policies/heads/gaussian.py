"""One Gaussian over a chunk: the baseline that averages two modes."""

from dataclasses import dataclass

from playlearn.policies.heads.base import HeadConfig
from playlearn.policies.heads.mog import Gaussian, MixtureConfig, MixtureHead


@HeadConfig.register_subclass("gaussian")
@dataclass(frozen=True)
class GaussianConfig(HeadConfig):
    """A mixture of one component.

    hidden: units of the hidden layer.
    std_range: least and greatest standard deviation; see MixtureConfig.
    temperature: scales the standard deviation of what is sampled.
    """

    hidden: int = 256
    std_range: tuple[float, float] = (0.1, 2.0)
    temperature: float = 1.0

    unimodal = True

    def build(self, width: int, chunk: int, actions: int) -> MixtureHead:
        mixture = MixtureConfig(1, self.hidden, self.std_range, self.temperature)
        return MixtureHead(mixture, width, chunk, actions, Gaussian())
