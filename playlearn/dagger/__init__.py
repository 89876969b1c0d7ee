"""DAgger: the policy acts, the expert labels every state with its own action, and training continues on those.

A cloned policy decides which states it visits; what to do there must be learned from those states (Ross, Gordon and
Bagnell, 2011). With a gate the expert takes over where the policy has drifted (Kelly et al., 2019).
"""

from playlearn.dagger.config import DaggerConfig
from playlearn.dagger.job import dagger

__all__ = ["DaggerConfig", "dagger"]
