"""Effects of heat balances."""
