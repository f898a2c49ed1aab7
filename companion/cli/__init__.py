"""Command lines: the parser and ending of both programs, and the commands of `companion`, light to import."""
