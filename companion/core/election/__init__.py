"""Leader election: leader beacons, commanded and claimed leadership, succession, mission time."""
