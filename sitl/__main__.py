"""`python -m sitl`, the same as `sitl`."""

from sitl.cli.main import main

main()
