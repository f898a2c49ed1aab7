"""Frozen values that packages exchange.

World frame: ENU (x east, y north, z up), metres from the fleet origin. Body frame: FLU (x forward, y left, z up).
Euler angles are roll phi, pitch theta, yaw psi with R = Rz(psi) Ry(theta) Rx(phi), in radians. At psi = 0 a positive
pitch accelerates towards +x and a positive roll towards -y. Times are seconds of the agent's own monotonic clock.

A hundred of them are made in every tick, so they are Structs, which cost a sixth of a frozen dataclass to make; none holds
anything that could hold it, so the collector need not look for cycles (gc=False).
"""
