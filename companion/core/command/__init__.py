"""Commands: arbitration, clearance and the flight phases."""
