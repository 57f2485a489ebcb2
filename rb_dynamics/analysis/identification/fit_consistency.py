"""Whether two fits, each to its own recordings, can be of one body: their difference against the errors of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rb_dynamics.analysis.identification.flights import Flight
from rb_dynamics.analysis.identification.measurement_model import Model
from rb_dynamics.analysis.identification.model_omissions import TOLD
from rb_dynamics.analysis.identification.parameters import Layout
from rb_dynamics.analysis.track import Array
from rb_dynamics.scene.model import Scene

# Of each recording, and not of the body or its sensors.
_OF_A_FLIGHT = ("initial[", "gyro_bias[", "accelerometer_bias[")
# What no scene has.
_OF_SENSORS = ("gyro_bias", "gyro_scale", "gyro_alignment", "accelerometer", "delay", "wrench_scale")


class Estimate(NamedTuple):
    """What a fit found.

    Attributes:
        layout: of the parameters.
        z: (p,), parameters.
        covariance: (p, p), of them.
        freedom: degrees of freedom of the noise that it is based on.
    """

    layout: Layout
    z: Array
    covariance: Array
    freedom: float


def predicting(model: Model, z: Array, scene: Scene, flights: Sequence[Flight]) -> Model:
    """Return the model of other flights of `scene`, what was found: their start and biases alone are to be fitted.

    What the scene does not have, as a delay or the scale of a gyro, is held as it was found. The flights were read for
    the scene of `model`.
    """
    moved = np.array(scene.body.center_of_mass) - np.array(model.scene.body.center_of_mass)
    flights = [flight.about(moved) for flight in flights]
    other = Model(scene, flights, ("initial", *(name for name in model.fit if name in _OF_SENSORS)))
    for name in _shared(model.layout, other.layout):
        found = model.layout[name]
        other.layout.blocks[name] = replace(
            found, at=other.layout[name].at, start=found.values(z), scale=np.zeros_like(found.scale)
        )
    return other


def model_of_others(model: Model, z: Array, flights: Sequence[Flight]) -> Model:
    """Return the model of other flights, in which the numbers of the body mean the same."""
    other = Model(model.scene, flights, model.fit, model.body(z))
    for name in _shared(model.layout, other.layout):
        other.layout.blocks[name] = replace(model.layout[name], at=other.layout[name].at)
    return other


def chance_of_one_body(one: Estimate, other: Estimate) -> float:
    """Return the chance that fits of one body differ at least as much as these; 1 if they know nothing in common.

    Both are of the models of `model_of_others`. Directions that either of them did not determine do not count.
    """
    from scipy.special import fdtrc

    names = _shared(one.layout, other.layout)
    if not names:
        return 1.0
    places = [
        np.concatenate([np.arange(each.layout[name].at.start, each.layout[name].at.stop) for name in names])
        for each in (one, other)
    ]
    apart = other.z[places[1]] - one.z[places[0]]
    both = sum(each.covariance[np.ix_(at, at)] for each, at in zip((one, other), places, strict=True))
    values, axes = np.linalg.eigh(both)
    known = values <= 2.0 * TOLD**2
    count = int(known.sum())
    if not count:
        return 1.0
    squares = float(np.sum((axes.T[known] @ apart) ** 2 / values[known]))
    return float(fdtrc(count, max(1.0, min(one.freedom, other.freedom)), squares / count))


def _shared(one: Layout, other: Layout) -> list[str]:
    return [name for name in one.blocks if name in other and not name.startswith(_OF_A_FLIGHT)]
