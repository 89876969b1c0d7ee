"""Teleoperation by people: keyboard and SpaceMouse."""
