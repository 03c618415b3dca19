"""A flight in the browser: live, and again from its run folder (decision 0024)."""
