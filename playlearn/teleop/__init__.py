"""People drive: keyboard and SpaceMouse."""
