"""Frames, vectors, curves, shapes and metric of formations, and the airspace, as numbers. Pure."""
