"""Verdicts on the theory of sections 2 to 4, computed on graphs."""
