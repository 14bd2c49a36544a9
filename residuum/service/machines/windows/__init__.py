"""Windows cut out of the streams of a machine, and those that are still kept."""
