"""Poses of a motion-capture system, from its network protocol to the vehicles."""
