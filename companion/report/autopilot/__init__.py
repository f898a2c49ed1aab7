"""Logs of the autopilots themselves, beside the recordings of the agents."""
