"""Command lines of `sitl`: one module per command, light to import."""
