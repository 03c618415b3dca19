"""What people look at: figures, words, and the progress of a flight."""
