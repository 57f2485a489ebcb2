"""`in_segments`: a long flight as several short ones, each of which begins anew.

Errors of the start grow along a flight, fast near a middle axis, and so does what a small disturbance did. The body is
the same in all segments, and the motion within each tells it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rb_dynamics.analysis.identification.flights import Flight
from rb_dynamics.analysis.identification.prediction import Model

# rad that the body turns in a segment, about, and samples in it at least.
_TURN, _SAMPLES = 15.0, 40
# Of all flights together: they tell enough, and each adds a start to be fitted.
_MOST = 8


def in_segments(model: Model) -> list[Flight]:
    """Return segments of the flights of a model, spread over all of their time; none of flights that are short."""
    found = []
    for flight, start in zip(model.flights, model.starts, strict=True):
        first, last = flight.span_ns
        samples = max(len(stream.time_ns) for stream in flight.streams)
        count = int(min((last - first) * 1e-9 * start.fastest / _TURN, samples / _SAMPLES))
        if count < 2:
            return []
        ends = np.linspace(first, last, count + 1).astype(np.int64)
        kept = np.unique(np.linspace(0, count - 1, max(2, _MOST // len(model.flights))).astype(int))
        found += [_between(flight, int(ends[k]), int(ends[k + 1])) for k in kept.tolist()]
    return found


def _between(flight: Flight, first: int, end: int) -> Flight:
    """Return what was measured from `first` to before `end`."""
    streams = []
    for stream in flight.streams:
        of = slice(*np.searchsorted(stream.time_ns, [first, end]).tolist())
        streams.append(replace(stream, time_ns=stream.time_ns[of], values=stream.values[of]))
    name = f"{flight.name} ({first * 1e-9:.6g} to {end * 1e-9:.6g} s)"
    return replace(flight, name=name, streams=tuple(streams), notes=())
