"""CAN: frames by a DBC file, from a bus or a log."""
