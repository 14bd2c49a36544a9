"""What data say against an identified model: residual tests, the model of its error, the error on new data."""
