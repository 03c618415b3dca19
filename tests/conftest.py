"""Hypothesis profiles: `dev` by default, `--hypothesis-profile=ci` searches longer."""

from hypothesis import settings

settings.register_profile("dev", max_examples=50, derandomize=True, database=None, deadline=None)
settings.register_profile("ci", max_examples=200, derandomize=True, database=None, deadline=None)
settings.load_profile("dev")
