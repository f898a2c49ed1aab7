"""Commands from the live page: what `companion fleet` does, without a terminal."""
