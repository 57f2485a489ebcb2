"""Fixtures: the recorded runs and bags of `test/support/recorded_runs.py`."""

from recorded_runs import bagger, coasting, flight, flown

__all__ = ["bagger", "coasting", "flight", "flown"]
