"""Linear systems: state space, factorisations, norms."""
