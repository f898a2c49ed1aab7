"""The enumerations and short texts of codes.toml, written by `make docs`."""
