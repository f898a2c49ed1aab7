"""Simulation of many formations at once, in arrays, for statistics. The reference for its model is sitl/flight/lockstep.py."""
