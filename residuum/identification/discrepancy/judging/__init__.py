"""What is made of what a search tried: probabilities, verdict, what is left over."""
