"""Where a model errs: along which signal, and in which region of it."""
