"""Residual generators: what makes a signal of a model and a record that only a fault moves."""
