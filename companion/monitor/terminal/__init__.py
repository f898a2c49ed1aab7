"""`companion monitor --tui`: the fleet in a terminal of 80, 120 or 200 columns."""
