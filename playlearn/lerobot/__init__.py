"""At home in LeRobot: its datasets written with cards and goals, our policies and worlds under its own commands."""
