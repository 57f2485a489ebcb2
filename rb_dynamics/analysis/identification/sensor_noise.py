"""The noise of each sensor, as its own differences show it, whatever the model."""

from __future__ import annotations

import numpy as np

from rb_dynamics.analysis.identification import rotations
from rb_dynamics.analysis.identification.flights import ATTITUDE, POSITION, VELOCITY, Stream
from rb_dynamics.analysis.identification.measurement_model import Model
from rb_dynamics.analysis.identification.residual_whiteness import typical
from rb_dynamics.analysis.noise import third_differences
from rb_dynamics.analysis.track import Array

Key = tuple[str, str, int]
"""Topic, kind and number of the flight: what is noise in one flight may be none in another."""

# Of its scale: no recording is believed to be more exact than that, not even one of a simulation without noise.
_FLOOR = 1e-6
# Of the radius of gyration and of the speed there: a position that stays at zero has no scale of its own.
_RESTING = 1e-3


def noise_shown(model: Model) -> dict[Key, float]:
    """Return the noise of each sensor that its own differences show, whatever the model."""
    return {key: max(_noise_of(stream), floor_of(model, key)) for key, stream in _streams(model).items()}


def floor_of(model: Model, key: Key) -> float:
    """Return the least noise that a sensor is believed to have."""
    return _FLOOR * largest(model, key)


def largest(model: Model, key: Key) -> float:
    """Return the largest number of a sensor, 1 rad of an attitude."""
    stream, arm = _streams(model)[key], _RESTING * model.arm
    if stream.kind == ATTITUDE:
        return 1.0
    least = {POSITION: arm, VELOCITY: arm * model.starts[key[2]].fastest}.get(stream.kind, 1e-9)
    return max(float(np.abs(stream.values).max(initial=0.0)), least)


def _streams(model: Model) -> dict[Key, Stream]:
    return {
        (stream.topic, stream.kind, number): stream
        for number, flight in enumerate(model.flights)
        for stream in flight.streams
        if len(stream.time_ns)
    }


def _noise_of(stream: Stream) -> float:
    """Return the noise that third differences show, which neither smooth motion nor a few wild samples change much."""
    every = _third_differences(stream)
    if not len(every):
        return 0.0
    # Of a coarse sensor most differences may be zero.
    usual = typical(every) or float(np.sqrt(np.mean(every**2)))
    return usual / float(np.sqrt(20.0))


def is_smooth(stream: Stream) -> bool:
    """Return whether a stream shows no noise: of that, neighbouring third differences oppose each other."""
    every = _third_differences(stream)
    return float(np.sum(every[1:] * every[:-1])) >= 0.0


def _third_differences(stream: Stream) -> Array:
    values = stream.values
    if stream.kind == ATTITUDE:
        steps = rotations.logarithms(rotations.products(rotations.conjugates(values[:-1]), values[1:]))
        values = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return third_differences(values, stream.time_ns)
