"""What holds for every test: examples are the same in every run, and none has a time limit of its own."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("lineside", derandomize=True, deadline=None, max_examples=60)
settings.load_profile("lineside")
