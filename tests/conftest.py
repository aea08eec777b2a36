"""Property tests draw the same examples in every run; a new seed is a decision, not an accident."""

from hypothesis import settings

settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile("same")
