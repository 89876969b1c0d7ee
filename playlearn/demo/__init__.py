"""`playlearn demo`: from play to a policy for goal images in one job, with its estimated time and its result."""

from playlearn.demo.config import DemoConfig
from playlearn.demo.job import demo

__all__ = ["DemoConfig", "demo"]
