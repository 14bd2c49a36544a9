"""Each job beside its peers in one run."""
