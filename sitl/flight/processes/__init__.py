"""A flight with real processes: one agent and one stand-in per vehicle, their start and end; `sitl fly` and `sitl fleet`."""
