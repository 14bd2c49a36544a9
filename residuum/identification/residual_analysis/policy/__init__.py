"""Every number that residuals are analysed by, a file a question; each with its unit, its meaning, and what set it."""
