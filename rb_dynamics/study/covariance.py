"""`covariance`: how an uncertainty of state and body grows along a flight, to first order.

The derivatives of the motion are those of `identify`: the variational equations, under the loads that acted in the
run. It is checked whether they give the motion of the run, and how far the motion is linear: by simulating flights that
are one standard deviation off, in the directions that matter most.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rb_dynamics.analysis.identification import rotations
from rb_dynamics.analysis.identification.flights import (
    ATTITUDE,
    POSITION,
    RATES,
    VELOCITY,
    Flight,
    Stream,
    flight_of,
    with_points,
)
from rb_dynamics.analysis.identification.identify import Identification
from rb_dynamics.analysis.identification.measurement_model import Model
from rb_dynamics.analysis.identification.parameters import AXES, rows_of
from rb_dynamics.analysis.track import Array, Times
from rb_dynamics.errors import LogError, SceneError
from rb_dynamics.formats.log_metadata import RUN
from rb_dynamics.formats.message_types import POSE
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.own_log import logged_scene
from rb_dynamics.motion.fixed_step_kernel import Tally, counted_by
from rb_dynamics.numerics.argument_checks import mapping, shown
from rb_dynamics.numerics.rotation_arrays import rotate_all
from rb_dynamics.scene.model import Scene
from rb_dynamics.study.uncertain_inputs import STATE, Uncertain, uncertain_numbers

QUANTITIES = {
    "attitude": "rad",
    "angular_velocity_body": "rad/s",
    "position_world": "m",
    "linear_velocity_world": "m/s",
}
"""The quantities of a result, three numbers each, with units; the attitude as a turn about body axes."""

# Fewer outputs than this do not show the motion.
_FEWEST = 4
# The largest number of outputs in a result.
_MOST = 1001
# Part of a radian, or of the motion, by which the derivatives' flight may be off the run.
_OFF = 1e-3
# By how much half the steps may change derivatives. The order is four: the error is a fifteenth of it.
_MOVES = 2e-5
# Spread (rad, or relative to the extent of the flight) below which it is linear, or only rounding.
_NONE = 1e-9
# Departure from the linear growth that is called too much.
_BENT = 0.1
_KINDS = (ATTITUDE, RATES, POSITION, VELOCITY)


@dataclass(frozen=True)
class Covariance:
    """The covariance of a motion over time, as far as it is linear.

    Attributes:
        names: of the numbers that are uncertain.
        sigmas: their standard deviations, SI units.
        exact: what a fit could not determine; it is taken as exact.
        time_ns: (n,), outputs of the run.
        matrices: (n, 12, 12), of attitude (turn about body axes), angular velocity (body axes), position and velocity
            (world axes, of the body origin).
        alone: (k, 4), standard deviation of each of `QUANTITIES` at the end, along its worst axis, from each of the
            names alone.
        departure: of flights that are one standard deviation off, how far they are from linear growth, as a part of it:
            the largest over time; infinite if such a body is none.
        linear_until_ns: the last time before that departure exceeds a tenth; None if it never does.
    """

    names: tuple[str, ...]
    sigmas: tuple[float, ...]
    exact: tuple[str, ...]
    time_ns: Times
    matrices: Array
    alone: Array
    departure: float
    linear_until_ns: int | None

    def deviations(self, quantity: str) -> Array:
        """Return the standard deviations (n, 3) of one of `QUANTITIES`, axis by axis."""
        at = 3 * list(QUANTITIES).index(quantity)
        found: Array = np.sqrt(np.maximum(np.diagonal(self.matrices, axis1=1, axis2=2)[:, at : at + 3], 0.0))
        return found

    def largest(self, quantity: str) -> Array:
        """Return the standard deviations (n,) of one of `QUANTITIES` along the axis where they are largest."""
        at = 3 * list(QUANTITIES).index(quantity)
        values = np.linalg.eigvalsh(self.matrices[:, at : at + 3, at : at + 3])
        found: Array = np.sqrt(np.maximum(values[:, -1], 0.0))
        return found

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: standard deviations by time and axis."""
        bent = self.linear_until_ns
        return {
            "time_ns": self.time_ns.tolist(),
            **{name: self.deviations(name).tolist() for name in QUANTITIES},
            "from": [
                {"name": name, "standard_deviation": sigma, "at_end": dict(zip(QUANTITIES, row, strict=True))}
                for name, sigma, row in zip(self.names, self.sigmas, self.alone.tolist(), strict=True)
            ],
            "taken_as_exact": list(self.exact),
            "departure_from_linear": self.departure if math.isfinite(self.departure) else None,
            "linear_until_s": None if bent is None else bent / 1e9,
        }


def covariance(
    log: str | os.PathLike[str], uncertain: Uncertain | None = None, sigmas: Mapping[str, object] | None = None
) -> Covariance:
    """Return how the motion in a log of this package spreads if state and body are uncertain, to first order.

    Args:
        log: of the run.
        uncertain: standard deviations by name: `mass`, `center_of_mass`, `inertia`, `initial.orientation` (rad, a turn
            about body axes), `initial.angular_velocity_body`, `initial.position_world`,
            `initial.linear_velocity_world`, `wrench_scale.TOPIC`, a number of an effect as `effects[0].rotation`; each
            a number for all axes, a list, or by axis as in `inertia.xx`. Or what `identify` returns, or the file of its
            JSON or of such a mapping in YAML.
        sigmas: such a mapping; it goes before what `uncertain` says of the same number.

    Raises:
        TypeError: an argument has the wrong type.
        LogError: `log` is not a log of this package, or the file cannot be read.
        SceneError: a name or a value is wrong, or derivatives of the scene are not known.
    """
    if not isinstance(log, (str, os.PathLike)):
        raise TypeError(f"log is {shown(log)}, expected the path of a log; write its name")
    if not isinstance(uncertain, (str, os.PathLike, Mapping, Identification, type(None))):
        raise TypeError(
            f"uncertain is {shown(uncertain)}, expected standard deviations by name, such as {{'mass': 0.1}}, or what "
            "identify returns, or a file of either"
        )
    if sigmas is not None:
        mapping(sigmas, "sigmas", "write {'mass': 0.1}")
    bag = read_bag(log, repeated=False)
    scene = logged_scene(bag.attachments)
    if scene is None or RUN not in bag.metadata:
        raise LogError(f"{log} is no log of this package, expected one; write it with simulate --mcap")
    if scene.body.is_particle:
        raise SceneError(f"{scene.source}: body: found a particle, expected a body with an inertia; add body.inertia")
    if scene.actuators:
        names = ", ".join(actuator.name for actuator in scene.actuators)
        raise SceneError(
            f"{scene.source}: actuators: found {names}, expected none, as sensitivities do not know what wheels, "
            "thrusters and magnetorquers do when the body moves otherwise; leave them out with --set actuators=[]"
        )
    outputs = max((topic.count for topic in bag.topics.values() if topic.type_name == POSE), default=0)
    if outputs < _FEWEST:
        raise SceneError(
            f"{scene.source}: output_rate: found {outputs} outputs of the run, expected {_FEWEST} or more; raise it"
        )
    # Lever arms change with the centre of mass.
    flight = _thinned(with_points(flight_of(bag, scene), bag, scene), log)
    given = uncertain_numbers(uncertain, sigmas, scene)
    model = Model(scene, [flight], _groups(given.names))
    z = _at_start(model, scene)
    by, matrix = _directions(model, scene, given.names), given.matrix
    with counted_by(Tally()):
        nominal, columns = _steady(model, z)
        growth = columns @ by
        matrices: Array = growth @ matrix @ np.swapaxes(growth, 1, 2)
        deviations = np.sqrt(np.diagonal(matrix))
        end = (growth[-1] * deviations).reshape(4, 3, -1)
        alone = np.linalg.norm(end, axis=1).T
        departure, bent = _departure(model, z, by, matrix, nominal, growth)
    until = None if bent is None else int(flight.streams[0].time_ns[bent])
    return Covariance(
        given.names,
        tuple(deviations.tolist()),
        given.exact,
        flight.streams[0].time_ns,
        matrices,
        alone,
        departure,
        until,
    )


def _groups(names: Sequence[str]) -> tuple[str, ...]:
    """Return the parts of a `Model` that the names need."""
    found = dict.fromkeys(name.partition(".")[0] for name in names if not name.startswith("effects["))
    keys = dict.fromkeys(re.sub(r"\.[xyz]$", "", name) for name in names if name.startswith("effects["))
    return tuple(name for name in (*found, *keys) if name != "initial")


def _thinned(flight: Flight, log: str | os.PathLike[str]) -> Flight:
    """Return the motion of a log at a number of outputs, with velocities in world axes.

    Raises:
        LogError: it has no motion.
    """
    streams = {stream.kind: stream for stream in flight.streams}
    if not set(_KINDS) <= set(streams):
        raise LogError(f"{log}: found no pose and twist, expected those of a run; give the log of a run")
    times = streams[ATTITUDE].time_ns
    count = min(len(times), *(len(streams[kind].time_ns) for kind in _KINDS))
    kept = np.unique(np.linspace(0, count - 1, min(count, _MOST)).round().astype(np.int64))
    found: list[Stream] = []
    for kind in _KINDS:
        stream = streams[kind]
        values = stream.values[kept]
        if kind == VELOCITY and not stream.world:
            values = rotate_all(streams[ATTITUDE].values[kept], values)
        found.append(replace(stream, time_ns=times[kept], values=values, world=kind == VELOCITY))
    return replace(flight, streams=tuple(found))


def _at_start(model: Model, scene: Scene) -> Array:
    """Return the parameters with which a flight begins as the scene says."""
    z = np.zeros(model.layout.count)
    state = scene.initial
    for name in STATE[1:]:
        block = model.layout[f"initial[0].{name}"]
        z[block.at] = (np.array(getattr(state, name)) - block.start) / block.scale
    block = model.layout["initial[0].rotation"]
    z[block.at] = rotations.between(model.starts[0].attitude, np.array(state.orientation_xyzw))
    return z


def _directions(model: Model, scene: Scene, names: Sequence[str]) -> Array:
    """Return how the parameters change with each of the names, (p, k).

    Raises:
        SceneError: a topic of a wrench scale is not in the run.
    """
    by = np.zeros((model.layout.count, len(names)))
    layout = model.layout
    if "shape" in layout:
        inertia_by = np.linalg.inv(model.inertia.derivative(0.0, np.zeros(5))[1])
    vector = rotations.logarithms(np.array(scene.initial.orientation_xyzw))
    for k, name in enumerate(names):
        whole, _, axis = name.rpartition(".")
        place = "xyz".find(axis) if whole else 0
        if name == "mass":
            by[layout["mass"].at, k] = 1.0 / scene.body.mass
        elif whole == "inertia":
            column = inertia_by[:, AXES.index(axis)]
            by[layout["size"].at, k], by[layout["shape"].at, k] = column[:1], column[1:]
        elif name.startswith("wrench_scale."):
            topic = name.partition(".")[2].lstrip("/")
            blocks = {n.partition(".")[2].lstrip("/"): b for n, b in layout.blocks.items() if n.startswith("wrench_s")}
            if topic not in blocks:
                listed = ", ".join(blocks) or "none, as no wrench acted"
                raise SceneError(f"found {name}, expected the scale of a topic of the run: {listed}; correct the name")
            by[blocks[topic].at, k] = 1.0
        elif whole in ("initial.orientation", "initial.rotation"):
            # A fit gives the rotation vector of the attitude, users a rotation from it.
            turns = rotations.right_jacobians(vector) if whole.endswith("rotation") else np.eye(3)
            by[layout["initial[0].rotation"].at, k] = turns[:, place]
        else:
            key = name if name in layout else whole.replace("initial.", "initial[0].")
            block = layout[key]
            at = block.at.start + (0 if key == name else place)
            by[at, k] = 1.0 / block.scale[at - block.at.start]
    return by


def _stacked(model: Model, z: Array) -> tuple[Array, Array]:
    """Return the deviation of a flight from the run (n, 12), and its derivatives (n, 12, p)."""
    parts = {each.key[1]: each for each in model.predict(z)}
    left = np.concatenate([parts[kind].left for kind in _KINDS], axis=1)
    return left, np.concatenate([parts[kind].by for kind in _KINDS], axis=1)


def _steady(model: Model, z: Array) -> tuple[Array, Array]:
    """Return `_stacked` with steps so short that the flight is that of the run, and that half of them change little.

    Raises:
        SceneError: it differs even with the shortest.
    """
    start = model.starts[0]
    speed = max(float(np.abs(s.values).max()) for s in model.flights[0].streams if s.kind == VELOCITY)
    scale = np.repeat([1.0, max(start.fastest, 1e-9), max(start.extent, 1e-9), max(speed, 1e-9)], 3)
    before, found, turn = None, None, model.turn
    for _ in range(7):
        left, by = _stacked(model, z)
        off = float(np.abs(left / scale).max()) if np.isfinite(left).all() else math.inf
        if off <= _OFF and np.isfinite(by).all():
            found, turn = (left, by), model.turn
            if before is not None and _agree(before, by, scale):
                break
            before = by
        elif found is not None:
            break
        model.turn /= 2.0
    if found is not None:
        model.turn = turn
        return found
    raise SceneError(
        f"{model.scene.source}: the flight integrated with the derivatives differs from the run by {off:.2g} of it, "
        "expected the same: the derivatives lack a load, or the motion is too sensitive; run a campaign instead"
    )


def _agree(coarse: Array, fine: Array, scale: Array) -> bool:
    """Return whether derivatives (n, 12, p) with steps of half the length are the same but for `_MOVES` of each."""
    moved, size = (
        np.abs(each / scale[:, np.newaxis]).reshape(len(fine), 4, 3, -1).max((0, 2)) for each in (fine - coarse, fine)
    )
    # What depends on a number by rounding alone never agrees.
    return bool((moved <= np.maximum(_MOVES * size, _NONE * size.max(0))).all())


def _departure(
    model: Model, z: Array, by: Array, matrix: Array, nominal: Array, growth: Array
) -> tuple[float, int | None]:
    """Return the largest departure from linear growth, and the last output before it is too much."""
    worst = np.zeros(len(growth))
    for rows, scale in ((slice(0, 3), 1.0), (slice(6, 9), model.starts[0].extent)):
        last = growth[-1, rows]
        values, axes = np.linalg.eigh(last @ matrix @ last.T)
        if values[-1] <= 0.0:
            continue
        change = matrix @ last.T @ axes[:, -1] / math.sqrt(values[-1])
        straight = growth[:, rows] @ change
        size = np.linalg.norm(straight, axis=1)
        if size.max() <= _NONE * scale:
            continue
        floor = 1e-3 * float(size.max())
        for sign in (1.0, -1.0):
            moved = _moved(model, z, by, sign * change)
            if moved is None:
                return math.inf, 0
            left, _ = _stacked(model, moved)
            gap = np.linalg.norm(left[:, rows] - nominal[:, rows] - sign * straight, axis=1)
            worst = np.fmax(worst, np.where(np.isfinite(gap), gap, np.inf) / np.maximum(size, floor))
    beyond = np.flatnonzero(worst > _BENT)
    return float(worst.max()), max(0, int(beyond[0]) - 1) if len(beyond) else None


def _moved(model: Model, z: Array, by: Array, change: Array) -> Array | None:
    """Return parameters with the numbers changed, mass and inertia in proportion; None if that is not a body."""
    moved: Array = z + by @ change
    if "mass" in model.layout:
        at_mass = model.layout["mass"].at
        if moved[at_mass][0] <= -1.0:
            return None
        # The parameter is the logarithm.
        moved[at_mass] = np.log1p(moved[at_mass])
    if "shape" not in model.layout:
        return moved
    size, shape = model.layout["size"].at, model.layout["shape"].at
    six, six_by = model.inertia.derivative(0.0, np.zeros(5))
    target = six + six_by @ (moved - z)[[size.start, *range(shape.start, shape.stop)]]
    moments = np.linalg.eigvalsh(rows_of(target))
    if moments[0] <= 0.0 or moments[2] >= moments[0] + moments[1]:
        return None
    at = moved[[size.start, *range(shape.start, shape.stop)]]
    for _ in range(20):
        here, here_by = model.inertia.derivative(float(at[0]), at[1:])
        at = at - np.linalg.solve(here_by, here - target)
    moved[size], moved[shape] = at[:1], at[1:]
    return moved
