"""The search: the likely effects estimated in full; one joins, others give way."""
