"""What is good: the six terms of the paper's objective (2.6) and their weighted sum."""
