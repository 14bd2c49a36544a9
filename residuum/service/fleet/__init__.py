"""Windows and records by the thousand, judged or identified anew on many workers."""
