"""Modbus TCP: registers by a register map, read from a device or served."""
