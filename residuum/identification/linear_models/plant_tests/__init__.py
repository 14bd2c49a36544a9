"""What a record says of its plant before any model is trusted: does it integrate, does its input answer its noise, how late."""
