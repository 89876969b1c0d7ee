"""`playlearn demo`: from play to goal images reached in one job, which says how long it takes and what came of it."""

from playlearn.demo.config import DemoConfig
from playlearn.demo.job import demo

__all__ = ["DemoConfig", "demo"]
