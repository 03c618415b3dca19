"""What a path is: B-spline subpaths, and the dense check that a subpath must pass."""
