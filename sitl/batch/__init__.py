"""Many whole formations at once, in arrays: for statistics. What it must agree with is sitl/lockstep.py."""
