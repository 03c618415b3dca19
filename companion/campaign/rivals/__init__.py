"""Planners of whole routes that ours is held against, flown by one driver (`flight.fly`)."""
