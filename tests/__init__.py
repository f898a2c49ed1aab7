"""Tests of the product, and the laboratory that measures it: bench, soak and fuzz."""
