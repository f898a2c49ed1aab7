"""Measurements of speed, size and resources: `make help` lists them."""
