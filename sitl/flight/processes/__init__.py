"""A flight with real processes: one agent per vehicle, the stand-ins, their start and end; `sitl fly` and `sitl fleet`."""
