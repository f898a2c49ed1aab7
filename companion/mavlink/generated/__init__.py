"""Written by `make mavlink`: `companion.mavlink.generate`."""
