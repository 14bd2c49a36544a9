"""OPC UA: nodes of a server as channels, and a server of our own."""
