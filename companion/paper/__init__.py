"""The paper by itself (profile `paper`, docs/lab/paper.md): nothing here is flown.

`terms` (the objective), `guide` (the tangent rule), the `optimisers` of Table 1, and `plan` (one
plan of them); `compare/`, which computes its table and figures again, and flies `rivals`, the
planners that its introduction names.
"""
