"""Effects that tie a balance to other signals: a forgotten input, a coupling of two balances, a learned curve."""
