"""The paper by itself (profile `paper`, docs/results/paper.md): nothing here is flown.

`terms` (the objective), `guide` (the tangent rule) and `plan` (one plan of them); the optimisers of
Table 1 in `evolution`, `swarm` and `genetic`; `compare/`, which computes its table and figures
again, and flies the planners that its introduction names.
"""
