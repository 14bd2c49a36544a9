"""`python -m residuum`: the command line."""

from residuum.service.cli import main

main()
