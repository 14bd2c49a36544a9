"""Long work in processes of its own: jobs, workers, fleets."""
