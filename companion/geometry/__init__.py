"""Curves, shapes of formations and ways between them, as numbers. Pure."""
