"""Corrective augmentation: moments of play with the end effector displaced, labeled with the way back.

    recorded   o_t --a_t--> o_{t+1} --a_{t+1}--> ...  o_{t+k}
                |                                     ^
    displaced  o'_t --a_t + c_t-->  ...  -------------+          c: what undoes the displacement within k steps

A cloned policy drifts from the states in its data, and play does not show how to return (Ross et al., 2011). For cars,
shifted cameras gave such labels (Pomerleau, 1989; Bojarski et al., 2016); for a manipulator, the simulator's saved
states do.
"""

from playlearn.collection.corrections.generate import make_corrections

__all__ = ["make_corrections"]
