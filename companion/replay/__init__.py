"""Recorded inputs, given to the agent again: the same commands bit for bit, or those of other settings."""
