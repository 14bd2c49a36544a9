"""From balances to compiled equations."""
