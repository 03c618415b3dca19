"""What a path is: B-spline subpaths, and the certificate that a subpath needs to be flown."""
