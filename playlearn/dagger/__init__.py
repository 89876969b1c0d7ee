"""DAgger: the policy acts, the expert says what it would have done, and training goes on with what came of it.

Where a cloned policy ends up is decided by the policy; what to do there must be learned from those very states
(Ross, Gordon and Bagnell, 2011). With a gate the expert takes over where the policy has drifted (Kelly et al., 2019).
"""

from playlearn.dagger.config import DaggerConfig
from playlearn.dagger.job import dagger

__all__ = ["DaggerConfig", "dagger"]
