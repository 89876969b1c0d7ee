"""Corrective augmentation: moments of play with the hand put aside, labeled with the way back.

    recorded   o_t --a_t--> o_{t+1} --a_{t+1}--> ...  o_{t+k}
                |                                     ^
    displaced  o'_t --a_t + c_t-->  ...  -------------+          c: what undoes the displacement within k steps

A cloned policy drifts from the states it was shown, and nothing in the play says how to come back (Ross et al., 2011).
Cameras beside a car's own gave that (Pomerleau, 1989; Bojarski et al., 2016); the simulator's saved states give it
to a manipulator.
"""

from playlearn.corrections.config import CorrectionsConfig
from playlearn.corrections.dataset import Corrections
from playlearn.corrections.generate import make_corrections

__all__ = ["Corrections", "CorrectionsConfig", "make_corrections"]
