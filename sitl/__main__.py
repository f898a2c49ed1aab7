"""`python -m sitl`, the same as `sitl`."""

from sitl.cli import main

main()
