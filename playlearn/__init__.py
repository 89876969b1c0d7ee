"""Robots that reach any goal you show them, learned from play."""

__version__ = "0.1.0"
