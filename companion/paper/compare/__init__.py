"""The paper's comparison again: Table 1, Fig. 3 and Fig. 4; and planners of whole routes."""
