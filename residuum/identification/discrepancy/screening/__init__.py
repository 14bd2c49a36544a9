"""First looks at all effects: what each would explain to first order, or on short stretches."""
