"""Statistics over whole formations: every combination of some keys of a scenario, each with many seeds, in batches."""
