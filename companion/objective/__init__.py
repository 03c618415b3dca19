"""What is good: the paper's six terms (2.6), as published and as flown, and their sum."""
