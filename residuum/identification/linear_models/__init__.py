"""Linear models: parametric identification, uncertainty, model error."""
