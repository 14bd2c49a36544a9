"""What a machine's values do over many windows."""
