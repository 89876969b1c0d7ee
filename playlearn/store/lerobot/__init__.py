"""LeRobot v3.0 datasets: written from any store (`export`), and read as one (`reader`).

Those import what takes a second; here stands what every command needs.
"""

from playlearn.store.lerobot.config import LeRobotStoreConfig

__all__ = ["LeRobotStoreConfig"]
