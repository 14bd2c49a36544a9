"""`python -m residuum`: the command line."""

from residuum.service.entry import main

main()
