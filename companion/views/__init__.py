"""Figures, texts and the progress display of a flight."""
