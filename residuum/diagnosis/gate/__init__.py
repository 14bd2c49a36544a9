"""The gate actuator: its model, movements, features and classifiers."""
