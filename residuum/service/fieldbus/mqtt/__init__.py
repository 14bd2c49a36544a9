"""Plain JSON messages over MQTT: values of them as channels."""
