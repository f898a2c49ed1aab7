"""Tracks -> figures, tables and plots of a flight."""
