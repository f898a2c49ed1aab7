"""Comparison of formation laws: laws by graphs by conditions by seeds, in batches, with figures, statistics and a page."""
