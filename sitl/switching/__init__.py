"""Topologies that switch with range, the paper's future work: from random starts, when does the graph stay connected?"""
