"""What a recorded motion shows about its body: unexplained wrench, and whether an inertia and a mass explain it.

With J and P the impulses of the recorded torques and forces (`impulse.py`), R I w - J and m v - P for the centre of
mass are constant: exact, over any time, and nothing is differentiated. What changes by more than its own noise
(`noise.py`) has a cause. What has one, and which, is said by the fit of `identify` (`identification/given_inertia.py`):
it sees smaller changes, in a part of a long recording. Where impulses are not known, nothing is judged.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rb_dynamics.analysis.identification.given_inertia import (
    FittedInertia,
    FittedMass,
    FittedTorque,
    InertiaScore,
    fitted_mass,
    score_inertia,
    score_inertia_in_parts,
)
from rb_dynamics.analysis.identification.other_units import doubt_of_mass
from rb_dynamics.analysis.identification.parameters import PLACES
from rb_dynamics.analysis.impulse import Impulse, impulse_blocks, wander
from rb_dynamics.analysis.noise import Labels, Noise, centred, judge, means, typical
from rb_dynamics.analysis.track import (
    Array,
    Times,
    TimeSeries,
    Track,
    in_blocks,
    largest,
    motion_blocks,
    shared,
)
from rb_dynamics.analysis.velocities_from_poses import rates_of
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.formats.message_types import COMMAND
from rb_dynamics.logs.messages import APPLIED
from rb_dynamics.numerics.growing_array import GrowingArray, give_back, stored
from rb_dynamics.numerics.rotation_arrays import rotate_all, rotate_all_inverse

_LEAST_INTERVALS = 10
# An interval counts if the error of its impulse is at most this fraction of the momentum.
_ROUGH = 1e-4
# A torque is significant at this multiple of its typical noise, which is larger where the body turns faster; means are
# taken over as many samples as that needs.
_STANDS_OUT = 16.0
# A body turns about one axis if its rate about others is this fraction of the whole, or this multiple of its noise.
_ONE_AXIS, _NOISE = 1e-3, 2.0
# Two inertias are equal if they differ by at most so many standard errors.
_ALIKE = 3.0
# Part of the time of a recording that is as good as all of it.
_WHOLE = 0.9
# What a fit finds may be due to errors of the times of commands, unless so many repetitions, each with other times
# within these errors, change it by less than one part of so many.
_REFITS, _CLEAR = 3, 8.0
TELLS = 0.5
"""A motion does not determine an inertia if each moment may have a larger undetected relative error, or if that part of
the angular momentum in a sample is noise."""

SHORT = "no part without a hole, in which all wrenches are known, has enough samples of each sensor"
"""Why nothing can be told where nothing can be fitted."""

# Why nothing can be told, without noise, of a body that does not turn, or turns steadily about one axis.
_SAME_MOTION = "a body with other moments of inertia would move in the same way"


@dataclass(frozen=True)
class Stretch:
    """The interval with the largest unexplained torque: everywhere above half its peak.

    Attributes:
        start_ns: start of its first interval.
        end_ns: end of its last.
        torque_body: mean, N m, body axes.
        torque_world: mean, N m, world axes.
        peak: largest size, N m.
    """

    start_ns: int
    end_ns: int
    torque_body: Array
    torque_world: Array
    peak: float


@dataclass(frozen=True)
class Residual:
    """How well the given body explains the motion.

    Attributes:
        start_ns: start of each interval.
        time_ns: end of each interval.
        force_world: mean residual force in each interval, N, world axes.
        torque_world: mean residual torque about the centre of mass, N m, world axes.
        torque_body: the same in body axes at the end of the interval.
        relative: unexplained angular momentum relative to the largest, or to the largest impulse of the torques if that
            is larger, root mean square.
        best: the same with the best-fitting inertia.
        inertia: the best-fitting inertia, kg m^2, body axes, with the scale of the given one if no torque determines
            it; the given one unless another explains the motion.
        moment_errors: standard errors of its principal moments, ascending, kg m^2; None for the given one.
        scaled: whether a torque determines the scale.
        mass: the mass that fits best, kg; None if no force determines it, or no inertia explains the motion.
        mass_error: its standard error, kg.
        mass_explained: whether the given mass explains the motion as well, or may do so.
        mass_untold: why nothing can be said about the given mass, although another fits better; "" if something can.
        given_mass: kg.
        unit: of the positions, if only with that a mass fits; "" for m.
        explained: whether the given inertia leaves at most `bound`, or only noise.
        explainable: whether some physical inertia explains the motion.
        noise: standard deviation of the angular momentum, relative to the same; 0 if it is within `bound`.
        unseen: for each principal moment, ascending, the relative error that noise may hide.
        bias: the constant error of the rates that explains the residual, rad/s, body axes; None if none does.
        axis: the only axis about which the body turns, body axes; None if about several.
        recorded: whether the recording has the wrenches that acted.
        with_rates: whether it has rates; otherwise they are differences of the pose, and the fit alone judges.
        covered: fraction of the time of which it is known that the given inertia explains the motion, if it does.
        untold: why nothing can be said about the inertia; "" if something can.
        pieces: the unrecorded torque by the fit, where only that tells it from noise.
        fitted_ns: begin and end of the part that was fitted; None if none was.
        factor: of all recorded torques, which explains the motion as well as another inertia; None if none does.
        mistimed: whether the errors of the times of commands may leave as much.
    """

    start_ns: Times
    time_ns: Times
    force_world: Array
    torque_world: Array
    torque_body: Array
    relative: float
    best: float
    inertia: Array
    moment_errors: tuple[float, float, float] | None
    scaled: bool
    mass: float | None
    mass_error: float
    mass_explained: bool
    mass_untold: str
    given_mass: float
    unit: str
    explained: bool
    explainable: bool
    noise: float
    unseen: tuple[float, float, float]
    bias: Array | None
    axis: Array | None
    recorded: bool
    with_rates: bool
    covered: float
    untold: str
    pieces: FittedTorque | None
    fitted_ns: tuple[int, int] | None
    factor: float | None = None
    mistimed: bool = False

    @property
    def told(self) -> bool:
        """Whether the recording allows any statement about the inertia."""
        return not self.untold

    @property
    def mass_words(self) -> str:
        """The mass that the forces fit, with its error, and what is doubtful; "" if it is not known."""
        if self.mass is None:
            return ""
        decimals = max(0, 1 - math.floor(math.log10(self.mass_error)))
        told = f"the forces fit a mass of {self.mass:.{decimals}f} ± {self.mass_error:.2g} kg best"
        if self.unit:
            return f"{told} if positions are in {self.unit}; with those in m no mass fits"
        if self.mass_untold:
            return f"{told} at the times as recorded, but {self.mass_untold}"
        return ", ".join(filter(None, (told, doubt_of_mass(self.mass, self.given_mass))))

    @property
    def strongest(self) -> Stretch:
        """The interval in which the residual torque has the largest effect."""
        start_ns, end_ns, world, body = self.start_ns, self.time_ns, self.torque_world, self.torque_body
        if self.pieces is not None:
            start_ns, end_ns = self.pieces.edges_ns[:-1], self.pieces.edges_ns[1:]
            world, body = self.pieces.world, self.pieces.body
        size = np.linalg.norm(world, axis=1)
        seconds = (end_ns - start_ns) * 1e-9
        strong = size >= 0.5 * size.max()
        follows = strong[1:] & strong[:-1] & (start_ns[1:] == end_ns[:-1])
        label = np.cumsum(np.concatenate([[True], ~follows]))
        impulse = np.bincount(label, np.where(strong, size * seconds, 0.0))
        within = label == impulse.argmax()
        return Stretch(
            start_ns=int(start_ns[within][0]),
            end_ns=int(end_ns[within][-1]),
            torque_body=np.average(body[within], axis=0, weights=seconds[within]),
            torque_world=np.average(world[within], axis=0, weights=seconds[within]),
            peak=float(size[within].max()),
        )

    @property
    def root_mean_square(self) -> tuple[float, float]:
        """Of the residual force (N) and torque (N m)."""
        force, torque = (np.sqrt(np.mean(np.sum(v**2, axis=1))) for v in (self.force_world, self.torque_world))
        return float(force), float(torque)


def residual(track: Track, bound: float) -> Residual | None:
    """Return the residual.

    None for a log of this package, a particle, no pose that was measured, or too few samples with known impulses. Where
    no twist with the stamps of the pose is recorded, differences of the pose give the wrench over time; their noise is
    not that of independent samples, so that the fit alone judges.
    """
    pose, body = track.pose, track.body
    if track.own or pose is None or body is None or body.is_particle or track.from_imu(pose):
        return None
    direct = track.twist is not None and not track.twist.partial
    if direct and track.twist is not None:
        direct = len(shared(pose.time_ns, track.twist.time_ns)[0]) > _LEAST_INTERVALS
    moving, in_world = (track.twist, track.twist_in_world) if direct else (None, False)
    if moving is None:
        rates = rates_of(pose)
        if rates is None:
            return None
        moving = rates.twist
    time_ns, *_ = shared(pose.time_ns, moving.time_ns)
    if len(time_ns) <= _LEAST_INTERVALS:
        return None
    shown = track if direct else replace(track, twist=moving, twist_in_world=False)
    moved = _Moved.of(pose, moving, in_world, body)
    push, turn = (_Pushed.of(shown, kind, time_ns) for kind in ("force", "torque"))
    # Over a gap the quadrature is meaningless, whatever its error estimate.
    known = np.isfinite(push.error) & (turn.error <= _ROUGH * moved.scale if direct else np.isfinite(turn.error))
    known[1:] &= np.diff(time_ns) > 0
    known &= ~track.moved_before(time_ns)
    if int(known[1:].sum()) < _LEAST_INTERVALS:
        return None
    known[:1] = False
    stretch = np.cumsum(~known, dtype=np.int_)
    given = np.array(body.inertia)
    left = _left(given, moved, turn, stretch)
    noise = judge(left, stretch, turn.steps)
    wrench = _wrench(
        time_ns, moved.attitude, _differences(body.mass, moved.speed, push.sums), left, stretch,
        _block(left, stretch, noise),
    )  # fmt: skip
    # What does not turn despite a torque is as far from explained as can be.
    scale = max(moved.scale, largest(turn.sums)) or np.inf
    relative = best = _rms(left) / scale
    # An error of the quadrature is an explanation.
    accepted = bound + float(turn.error[known].sum()) / scale
    changes = direct and noise.beyond and relative > accepted
    worst = wrench["time_ns"][np.linalg.norm(wrench["torque_world"], axis=1).argmax()] if changes else None
    found = (
        score_inertia(track, body, moving, None if worst is None else int(worst))
        if direct
        else score_inertia_in_parts(track, body, moving)
    )
    if found is None and not direct:
        return None
    # The error of the quadrature may hide what the fit, which has none, rejects.
    explained = (direct and relative <= bound) or not (changes or (found is not None and not found.explained))
    inertia, other = given, None
    if not explained and found is not None and (other := found.inertia) is not None:
        after = _left(other.matrix, moved, turn, stretch)
        explains = other.explains
        if changes:
            explains = _rms(after) <= accepted * scale or not judge(after, stretch, turn.steps).beyond
        if explains:
            inertia, best = other.matrix, _rms(after) / scale
        else:
            other = None
    bias = None if explained or found is None else found.bias
    level = noise.level / scale if direct else found.noise if found is not None else np.inf
    level = level if relative > bound else 0.0
    unseen = (np.inf, np.inf, np.inf) if found is None else found.unseen
    pieces = None if changes or found is None else found.torque
    beyond_noise = math.sqrt(max((relative * scale) ** 2 - noise.level**2, 0.0))
    unknown_times = times_unknown(track)
    doubtful = bool(unknown_times) and not explained

    def left_by(acting: Track) -> float:
        """Return what the given inertia leaves beyond noise where commands act at other times."""
        rows = _left(given, moved, _Pushed.of(acting, "torque", time_ns), stretch)
        return math.sqrt(max(_rms(rows) ** 2 - noise.level**2, 0.0))

    mistimed = doubtful and (
        _on_arrival(shown, body, moving, left_by if direct else None)
        or _mistimed(track, body, moving, found, beyond_noise if direct else np.inf)
    )
    # A fit that finds an error of a sensor, or of the whole nothing beyond coloured noise, confirms no torque.
    blamed = found is not None and (_share(found, track) < _WHOLE if found.explained else found.pushed)
    turned = RigidBody.from_matrix(body.mass, inertia.tolist(), body.center_of_mass)
    mass = fitted_mass(track, turned, moving, not explained) if explained or other is not None else None
    mass = mass or FittedMass(None, np.inf, True)
    mass_mistimed = _mass_mistimed(mass, track, body.mass, _rms(centred(moved.speed, stretch)))
    caused = (changes and blamed) or bias is not None or other is not None
    return Residual(
        **wrench,
        relative=relative,
        best=best,
        inertia=inertia,
        moment_errors=None if other is None else other.errors,
        scaled=found is not None and (found if other is None else other).scaled,
        mass=mass.value,
        mass_error=mass.error,
        mass_explained=mass.explained or mass_mistimed,
        mass_untold=f"{unknown_times} would explain the one given as well" if mass_mistimed else "",
        given_mass=body.mass,
        unit=mass.unit,
        explained=explained,
        explainable=explained or other is not None,
        noise=level,
        unseen=unseen,
        bias=bias,
        axis=_one_axis(moved.omega, stretch),
        recorded=track.acted,
        with_rates=direct,
        covered=1.0 if direct or found is None or not explained else _share(found, track),
        untold=_untold(
            found, explained, level, scale < np.inf, caused, _actuated(track), unknown_times if mistimed else ""
        ),
        mistimed=mistimed,
        pieces=pieces,
        fitted_ns=None if found is None else (found.begin_ns, found.end_ns),
        factor=None if other is None else _factor(given, other),
    )


def _factor(given: Array, other: FittedInertia) -> float | None:
    """Return the factor of the torques that does as well as an inertia of the same ratios as the given one."""
    factor = float(np.trace(given) / np.trace(other.matrix))
    alike = np.linalg.norm(other.matrix - given / factor) <= _ALIKE * np.linalg.norm(other.errors)
    return factor if other.scaled and alike else None


def _share(found: InertiaScore, track: Track) -> float:
    """Return the fraction of the time of the recording that was fitted."""
    begin, end = track.span_ns
    return min(1.0, (found.end_ns - found.begin_ns) / max(end - begin, 1))


def _actuated(track: Track) -> str:
    """Return the commands to actuators whose wrenches are not known; those of thrusters are, in a log or by a scene."""
    bag, known = track.bag, {each.topic for each in track.wrenches}
    told = {name for name in bag.actuated if name in known or name.removesuffix(COMMAND) + APPLIED in bag.topics}
    return ", ".join(name for name in bag.actuated if name not in told)


def late_impulse(track: Track, kind: str, late: bool = True) -> float:
    """Return the impulse of force or torque that is missing where each command acts at a time of its own error.

    With `late` it may act on arrival, too.
    """
    offs = [math.hypot(each.within_ns, each.late_ns * late) for each in track.wrenches]
    steps = (np.diff(getattr(each, kind), axis=0) for each in track.wrenches)
    return math.sqrt(sum((1e-9 * off) ** 2 * float(np.sum(step**2)) for off, step in zip(offs, steps, strict=True)))


def _mass_mistimed(found: FittedMass, track: Track, given: float, speed: float) -> bool:
    """Return whether errors of the times of commands may be why another mass fits better."""
    if found.explained or found.value is None or found.unit:
        return False
    # The fit has a delay beside the mass.
    return abs(found.value - given) * speed <= late_impulse(track, "force", late=False)


def times_unknown(track: Track) -> str:
    """Return why times of commands are not known, as text; "" if all are."""
    topics = [track.bag.topics[each.topic] for each in track.wrenches if each.within_ns]
    if not topics:
        return ""
    if any(not topic.stamps_given for topic in topics):
        return "the commands have no stamps, and the error of the times at which they were logged"
    if any(topic.name in track.bag.unset for topic in topics):
        return "some of the commands have no stamps, and the error of the times at which they were logged"
    return "the stamps of commands are rounded or stray, or these act on arrival, and the error of their times"


def _mistimed(track: Track, body: RigidBody, moving: TimeSeries, found: InertiaScore | None, left: float) -> bool:
    """Return whether commands at other times, each within its error, leave as much.

    What a fit found is then not found again, or changes by a part of `_CLEAR`. If it found nothing, it is what is
    `left` (rms, N m s).
    """

    def told(by: InertiaScore | None) -> Array | None:
        if found is not None and found.inertia is not None and found.inertia.explains:
            return None if by is None or by.inertia is None else by.inertia.matrix - np.array(body.inertia)
        return None if by is None or by.torque is None else by.torque.body

    first = told(found)
    if found is None or first is None:
        return left <= late_impulse(track, "torque", late=False)
    for seed in range(_REFITS):
        random = np.random.default_rng(seed)
        acting = []
        for each in track.acting:
            errors = random.integers(-each.within_ns, each.within_ns, len(each.time_ns), endpoint=True)
            acting.append(replace(each, time_ns=np.sort(each.time_ns + errors)))
        middle = (found.begin_ns + found.end_ns) // 2
        other = told(score_inertia(replace(track, by_scene=tuple(acting)), body, moving, around_ns=middle))
        if other is None or _CLEAR * np.linalg.norm(other - first) > np.linalg.norm(first):
            return True
    return False


def _on_arrival(track: Track, body: RigidBody, moving: TimeSeries, left_by: Callable[[Track], float] | None) -> bool:
    """Return whether the given inertia may explain the motion if commands act when they were logged.

    `left_by` returns what it leaves of the angular momentum beyond noise; without it, a fit decides.
    """
    if not any(each.late_ns for each in track.acting):
        return False
    arrived = tuple(replace(each, time_ns=each.time_ns + each.late_ns) for each in track.acting)
    other = replace(track, by_scene=arrived)
    if left_by is not None:
        return left_by(other) <= late_impulse(track, "torque", late=False)
    found = score_inertia_in_parts(other, body, moving)
    return found is not None and found.explained


def _untold(
    found: InertiaScore | None,
    explained: bool,
    noise: float,
    turned: bool,
    caused: bool,
    actuated: str,
    mistimed: str,
) -> str:
    """Return why nothing can be said.

    Args:
        found: by the fit.
        explained: whether the given inertia explains the motion.
        noise: of the angular momentum, relative.
        turned: whether the body turned, or a torque acted.
        caused: whether a cause is found of what is not explained.
        actuated: commands to actuators whose wrenches are not recorded.
        mistimed: why the times of commands may be so far off that as much is left, if they may.
    """
    if explained:
        if found is None:
            return SHORT if noise > 0.0 or not turned else ""
        if noise < TELLS and min(found.unseen) < TELLS:
            return ""
        return "the noise of the recording hides it" if noise > 0.0 else _SAME_MOTION
    if actuated:
        return f"{actuated} may command actuators, and what these did to the body is not recorded"
    if mistimed:
        return f"{mistimed} would explain what is left as well"
    if found is None:
        return "" if caused else SHORT
    if found.late:
        return "a delay of a sensor or of the commands would explain what is left as well"
    if found.gyro is not None:
        factors, turn = ", ".join(f"{each:.4g}" for each in found.gyro[:3]), np.rad2deg(np.linalg.norm(found.gyro[3:]))
        what = f"factors of ({factors}) and axes turned by {turn:.3g}°" if turn >= 0.0 else "of factors and axes"
        return f"errors of the measured rates, {what}, would explain what is left as well"
    if caused or found.torque is not None:
        return ""
    left = "neither another inertia nor a torque that is constant in each twelfth of the time explains what is left"
    if found.noiseless:
        return f"{left}, and the sensors show no noise; a torque that varies faster is one possible cause"
    return f"{left}, as of coloured noise or of a torque that varies faster"


def _left(inertia: Array, moved: _Moved, turn: _Pushed, stretch: Labels) -> Array:
    """Return what an inertia leaves of the angular momentum."""
    return centred(_differences(np.array([inertia[i, j] for i, j in PLACES]), moved.basis, turn.sums), stretch)


@dataclass(frozen=True)
class _Moved:
    """The motion at the stamps that pose and twist share.

    Attributes:
        attitude: (n, 4), body to world.
        omega: (n, 3), rad/s, body axes.
        speed: (n, 3), m/s, of the centre of mass, world axes.
        basis: (n, 18), of which row i, as (3, 6), times the six numbers of an inertia is the angular momentum.
        scale: largest angular momentum.
    """

    attitude: Array
    omega: Array
    speed: Array
    basis: Array
    scale: float

    @staticmethod
    def of(pose: TimeSeries, twist: TimeSeries, twist_in_world: bool, body: RigidBody) -> _Moved:
        inertia, center, scale = np.array(body.inertia), np.array(body.center_of_mass), 0.0

        def blocks() -> Iterator[Array]:
            nonlocal scale
            for motion in motion_blocks(pose, twist, twist_in_world):
                attitude, omega = motion.orientation_xyzw, motion.angular_velocity_body
                scale = max(scale, float(np.linalg.norm(omega @ inertia, axis=1).max()))
                speed = rotate_all(attitude, motion.linear_velocity_body + np.cross(omega, center))
                basis = np.stack([rotate_all(attitude, omega @ unit) for unit in _UNITS], axis=2)
                yield np.hstack([attitude, omega, speed, basis.reshape(-1, 18)])

        rows = stored(blocks(), 28)
        return _Moved(rows[:, :4], rows[:, 4:7], rows[:, 7:10], rows[:, 10:], scale)


@dataclass(frozen=True)
class _Pushed:
    """Impulses from the first sample to each.

    Attributes:
        sums: (n, 3), of force or torque, where it is known.
        error: (n,), of each interval, see `Impulse`.
        steps: (n,), variance that the noise of the attitude adds in each interval.
    """

    sums: Array
    error: Array
    steps: Array

    @staticmethod
    def of(track: Track, kind: str, time_ns: Times) -> _Pushed:
        error, turning = np.empty(len(time_ns)), GrowingArray()

        def blocks() -> Iterator[Array]:
            last, first = np.empty((0, 3)), 0
            for each in impulse_blocks(track, kind, time_ns):
                error[first : first + len(each.error)] = each.error
                turning.add(each.turning)
                first += len(each.error)
                sums = np.cumsum(np.concatenate([last, _impulse(each)]), axis=0)
                yield sums[len(last) :]
                last = sums[-1:]

        sums = stored(blocks(), 3)
        return _Pushed(sums, error, wander(track, in_blocks(turning.view("f8").reshape(-1, 3)), time_ns))


def _differences(factor: float | Array, rows: Array, less: Array) -> Array:
    """Return `rows` times a factor, or as matrices (3, 6) times six numbers, minus `less`, (n, 3)."""
    blocks = zip(in_blocks(rows), in_blocks(less), strict=True)
    return stored((_times(part, factor) - other for part, other in blocks), 3)


def _times(rows: Array, factor: float | Array) -> Array:
    result: Array = rows.reshape(-1, 3, 6) @ factor if isinstance(factor, np.ndarray) else factor * rows
    return result


def _wrench(
    time_ns: Times, attitude: Array, of_force: Array, left: Array, stretch: Labels, size: int
) -> dict[str, Any]:
    """Return the force and torque that change what is left, from means of `size` samples: fields of `Residual`."""
    rows = np.arange(len(time_ns)).astype(np.float64)
    (at, of), seconds = means(rows, stretch, size), means((time_ns - time_ns[0]) * 1e-9, stretch, size)[0]
    follows = np.diff(of) == 0
    ends = np.rint(at).astype(np.intp)

    def changes(values: Array) -> Array:
        mean = means(values, stretch, size)[0]
        blocks = zip(in_blocks(mean, 1), in_blocks(seconds, 1), in_blocks(of, 1), strict=True)
        return stored(((np.diff(a, axis=0) / np.diff(s)[:, None])[np.diff(k) == 0] for a, s, k in blocks), 3)

    torque, last = changes(left), ends[1:][follows]

    def in_body() -> Iterator[Array]:
        for rows, part in zip(in_blocks(last), in_blocks(torque), strict=True):
            yield rotate_all_inverse(attitude[rows], part)
            give_back(attitude)

    return {
        "start_ns": time_ns[ends[:-1][follows]],
        "time_ns": time_ns[last],
        "force_world": changes(of_force),
        "torque_world": torque,
        "torque_body": stored(in_body(), 3),
    }


# I = sum of x_k unit_k, x = (Ixx, Iyy, Izz, Ixy, Ixz, Iyz).


def _unit(i: int, j: int) -> Array:
    matrix = np.zeros((3, 3))
    matrix[i, j] = matrix[j, i] = 1.0
    return matrix


_UNITS = tuple(_unit(i, j) for i, j in PLACES)


def _triangle(blocks: Iterable[Array], columns: int) -> Array:
    """Return R of the factors Q R of the rows of all blocks, which has their singular values and least squares."""
    result: Array = np.empty((0, columns))
    for block in blocks:
        result = np.asarray(np.linalg.qr(np.concatenate([result, block]), mode="r"))
    return result


def _one_axis(omega: Array, stretch: Labels) -> Array | None:
    """Return the axis (unit, body axes) about which the body turns; None if about more than one, or none."""
    _, sizes, axes = np.linalg.svd(_triangle(in_blocks(omega), 3))
    beside = float(np.hypot(sizes[1], sizes[2]))
    noise = _NOISE * typical(omega, stretch) * np.sqrt(len(omega))
    if sizes[0] == 0.0 or beside > max(_ONE_AXIS * float(sizes[0]), min(noise, 0.5 * float(sizes[0]))):
        return None
    axis: Array = axes[0] * np.sign(axes[0][np.abs(axes[0]).argmax()])
    return axis


def _impulse(impulse: Impulse) -> Array:
    return impulse.exact + np.where(np.isfinite(impulse.error)[:, None], impulse.turning, 0.0)


def _block(left: Array, stretch: Labels, noise: Noise) -> int:
    """Return over how many samples to average so that the largest torque is significant."""
    size = 1
    while noise.sizes and size < noise.sizes[-1]:
        mean, of = means(left, stretch, size)
        blocks = zip(in_blocks(mean, 1), in_blocks(of, 1), strict=True)
        steps = [np.linalg.norm(np.diff(a, axis=0), axis=1)[np.diff(k) == 0].max(initial=0.0) for a, k in blocks]
        if max(steps, default=0.0) > _STANDS_OUT * typical(mean, of):
            break
        size *= 2
    return size


def _rms(left: Array) -> float:
    return float(np.sqrt(np.mean(np.concatenate([np.sum(rows**2, axis=1) for rows in in_blocks(left)]))))
