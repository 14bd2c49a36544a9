"""Rolling bearings: their frequencies, and whether a fault's lines stand out."""
