"""Statistics over whole formations: all combinations of varied keys of a scenario, each with many seeds, in batches."""
