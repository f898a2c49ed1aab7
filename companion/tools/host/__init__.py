"""`companion doctor --host`: checks of the companion computer itself. Each is a pure function of a `Board`."""
