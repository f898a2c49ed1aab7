"""Speed of agents, simulation and batch beside other programs, measured in one run: `make bench`."""
