"""The steps of an improvement: effects join, data kept aside judge them, the last estimate."""
