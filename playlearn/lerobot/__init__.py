"""Integration with LeRobot: datasets with cards and goals; our policies and environments under its commands."""
