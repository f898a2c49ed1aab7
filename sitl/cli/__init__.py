"""The commands of `sitl`, light to import; companion/cli/program.py has the parser and the ending."""
