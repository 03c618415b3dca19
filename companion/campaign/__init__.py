"""Thousands of missions from one file, on all cores or on a cluster, and what came of each."""
