"""Command lines: one module per command, light to import."""
