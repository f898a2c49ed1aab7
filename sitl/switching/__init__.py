"""Topologies that switch with range, the paper's future work: how often the graph stays connected from random starts."""
