"""Sparkplug B over MQTT: metrics of an edge node as channels, and an edge node of our own."""
