"""LeRobot datasets: written from any store (`export`, v3.0), and read as one (`reader`, v3.0 and v2.1).

Those import what takes a second; here stands what every command needs.
"""

from playlearn.store.lerobot.config import LeRobotStoreConfig

__all__ = ["LeRobotStoreConfig"]
