"""Results as the contract's JSON objects and as short reports, for the command line, the interface
and notebooks alike.
"""
