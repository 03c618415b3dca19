"""The paper's comparison again: Table 1, Fig. 3 and Fig. 4; and planners of whole routes."""

PER_SECOND = 1000
"""Evaluations that stand for a second of T: what interpreted Matlab did in 2011, about."""
