"""What LeRobot finds by the name of its distribution; put beside the package in the wheel (see pyproject.toml)."""
