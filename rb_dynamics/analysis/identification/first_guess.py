"""`first_guess`: mass and inertia from balances of momentum over short pieces of the flights, linear in both.

    I w + int w x (I w + h) + h = int t        m (x - x0 - v0 t - int int g) = int int f

Rates enter as measured, so noise makes the result rough: it only serves as a starting point for a fit, independent of
the values in the scene.
"""

from __future__ import annotations

import numpy as np

from rb_dynamics.analysis.identification import rotations
from rb_dynamics.analysis.identification.flights import ATTITUDE, POSITION, RATES, Flight, Stream, usual_interval
from rb_dynamics.analysis.identification.measurement_model import Model
from rb_dynamics.analysis.identification.parameters import PLACES, rows_of
from rb_dynamics.analysis.track import Array, Times
from rb_dynamics.loads.drag import LinearDrag, QuadraticDrag
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.numerics.nanoseconds import NANOSECONDS

# rad that the body turns in a mean of samples, and in a piece over which momentum is balanced.
_SMOOTH, _PIECE = 0.1, 0.5
_LEAST_PIECES = 8
# Of the largest second moment of mass, the least.
_THIN = 1e-2


def first_guess(model: Model) -> Array | None:
    """Return parameters with the mass and the inertia of the balances; None if these determine neither."""
    z, layout = np.zeros(model.layout.count), model.layout
    inertia = _inertia(model) if "shape" in layout else None
    mass = _mass(model) if "mass" in layout else None
    if inertia is not None:
        z[layout["size"].at], z[layout["shape"].at] = model.inertia.parameters(inertia)
    if mass is not None:
        z[layout["mass"].at] = np.log(mass / model.scene.body.mass)
    return None if inertia is None and mass is None else z


def _inertia(model: Model) -> Array | None:
    """Return the inertia; of a flight without torque with the trace of the scene's."""
    rows, wanted, sizes = [], [], []
    for number, flight in enumerate(model.flights):
        turning = _turning(flight, model.starts[number].fastest)
        if turning is None:
            continue
        times, rates = turning
        knots, held = model.grid(np.zeros(model.layout.count), flight, int(times[0]), times)
        if held[:, 9:12].any():
            # Its axes turn, and the attitude may not be known.
            continue
        seconds = (knots - times[0]) / NANOSECONDS
        spans = np.diff(seconds, prepend=0.0)[:, None]
        at = np.stack([np.interp(knots, times, column) for column in rates.T], axis=1)
        middle = 0.5 * (at + np.vstack([at[:1], at[:-1]]))
        rotor = held[:, 12:15] + 0.5 * spans * held[:, 15:18]
        turned = np.cumsum(spans * (held[:, 3:6] - held[:, 15:18] - np.cross(middle, rotor)), axis=0)
        momenta = _momenta(at)
        columns = [momenta + np.cumsum(spans[:, :, None] * (rotations.hats(middle) @ _momenta(middle)), axis=0)]
        for i, effect in enumerate(model.scene.effects):
            if isinstance(effect, (LinearDrag, QuadraticDrag)) and f"effects[{i}].rotation" in model.layout:
                speed = 1.0 if isinstance(effect, LinearDrag) else np.linalg.norm(middle, axis=1, keepdims=True)
                columns.append(np.cumsum(spans * speed * middle, axis=0)[:, :, None] * np.eye(3))
        half = 0.5 * _PIECE / model.starts[number].fastest
        # Where one piece ends and the next begins.
        ends = np.append(0, np.flatnonzero(np.diff(np.floor(seconds / half))) + 1)
        begin, end = ends[:-2], ends[2:]
        every = np.concatenate(columns, axis=2)
        rows.append((every[end] - every[begin]).reshape(-1, every.shape[2]))
        sizes.append((momenta[end] - momenta[begin]).reshape(-1, 6))
        wanted.append((turned[end] - turned[begin]).ravel())
    if sum(len(each) for each in wanted) < 3 * _LEAST_PIECES or len({each.shape[1] for each in rows}) != 1:
        return None
    balance, torque, size = np.vstack(rows), np.concatenate(wanted), np.vstack(sizes)
    if torque.any():
        six = np.linalg.lstsq(balance, torque, rcond=None)[0][:6]
    else:
        # Of all inertias, that which leaves least of the momentum that it has itself.
        scale = size.T @ size
        values, axes = np.linalg.eigh(scale)
        if not values[-1] > 0.0:
            # Rates without any change tell nothing.
            return None
        root = axes / np.sqrt(np.maximum(values, 1e-12 * values[-1]))
        part = balance[:, :6] - balance[:, 6:] @ np.linalg.lstsq(balance[:, 6:], balance[:, :6], rcond=None)[0]
        six = root @ np.linalg.svd(part @ root, full_matrices=False)[2][-1]
        six *= model.inertia.trace / six[:3].sum()
    second = 0.5 * six[:3].sum() * np.eye(3) - rows_of(six)
    if not (np.isfinite(second).all() and np.trace(second) > 0.0):
        return None
    # The nearest that a body has.
    values, axes = np.linalg.eigh(second)
    values = np.maximum(values, _THIN * values.max())
    found: Array = values.sum() * np.eye(3) - (axes * values) @ axes.T
    return found


def _momenta(rates: Array) -> Array:
    """Return the derivatives (n, 3, 6) of I w by Ixx, Iyy, Izz, Ixy, Ixz and Iyz."""
    found = np.zeros((len(rates), 3, 6))
    for k, (i, j) in enumerate(PLACES):
        found[:, i, k], found[:, j, k] = rates[:, j], rates[:, i]
    return found


def _turning(flight: Flight, fastest: float) -> tuple[Times, Array] | None:
    """Return times and rates in body axes, smoothed; None where none are measured."""
    found: tuple[Times, Array] | None = None
    for stream in flight.streams:
        if stream.kind == RATES and not stream.world:
            found = stream.time_ns, stream.values @ stream.mount
            break
        if stream.kind == ATTITUDE:
            found = _differences(stream)
    if found is None or len(found[0]) < 2:
        return None
    times, rates = found
    # A short recording may have fewer samples than are smoothed.
    size = min(len(times) // 2, max(1, int(_SMOOTH / (fastest * usual_interval(times) / NANOSECONDS))))
    count = len(times) // size
    first = int(times[0])
    means = (times[: count * size] - first).reshape(count, size).mean(axis=1)
    return first + np.rint(means).astype(np.int64), rates[: count * size].reshape(count, size, 3).mean(axis=1)


def _differences(stream: Stream) -> tuple[Times, Array]:
    kept = np.diff(stream.time_ns, append=np.iinfo(np.int64).max) > 0
    times, attitudes = stream.time_ns[kept], stream.values[kept]
    steps = rotations.between(attitudes[:-1], attitudes[1:])
    spans = np.diff(times)
    return times[:-1] + spans // 2, steps / (spans[:, None] / NANOSECONDS)


def _mass(model: Model) -> float | None:
    """Return the mass; lever arms of the body origin are left out."""
    rows, wanted = [], []
    gravity = np.sum([e.acceleration_world for e in model.scene.effects if isinstance(e, UniformGravity)], axis=0)
    for flight in model.flights:
        by_kind = {stream.kind: stream for stream in flight.streams if len(stream.time_ns) > 3}
        if not {POSITION, ATTITUDE} <= by_kind.keys():
            continue
        position, attitude = by_kind[POSITION], by_kind[ATTITUDE]
        times = position.time_ns
        knots, held = model.grid(np.zeros(model.layout.count), flight, int(times[0]), times)
        spans = np.diff((knots - times[0]) / NANOSECONDS, prepend=0.0)[:, None]
        near = np.clip(np.searchsorted(attitude.time_ns, knots), 0, len(attitude.time_ns) - 1)
        force = np.einsum("nij,nj->ni", rotations.matrices(attitude.values[near]), held[:, :3]) + held[:, 6:9]
        pushed = np.cumsum(spans * force, axis=0)
        gone = np.cumsum(spans * (pushed - 0.5 * spans * force), axis=0)[np.searchsorted(knots, times)]
        seconds = (times - times[0]) / NANOSECONDS
        fall = 0.5 * seconds[:, None] ** 2 * gravity
        line = np.column_stack([np.ones_like(seconds), seconds])
        project = [
            values - line @ np.linalg.lstsq(line, values, rcond=None)[0] for values in (gone, position.values - fall)
        ]
        rows.append(project[0].ravel())
        wanted.append(project[1].ravel())
    if not rows:
        return None
    by, moved = np.concatenate(rows), np.concatenate(wanted)
    along = float(by @ moved)
    return float(by @ by) / along if along > 0.0 else None
