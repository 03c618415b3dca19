"""Planners of whole routes that the paper's introduction names, flown leg by leg as ours is."""
