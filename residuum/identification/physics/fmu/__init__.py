"""Models that come as FMUs (FMI 2 and 3): read, loaded in a process of their own, and made models
of balances.
"""
