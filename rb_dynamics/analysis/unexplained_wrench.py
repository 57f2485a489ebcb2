"""What a recorded motion shows about its body: unexplained wrench, and best-fitting inertia and mass.

With J and P the impulses of the recorded torques and forces (`impulse.py`), R I w - J and m v - P for the centre of
mass are constant: exact, and linear in I and m. Nothing is differentiated. What changes by more than its own noise
(`noise.py`) has a cause: a different inertia, a constant error of the rates, or a torque that is not in the
recording, for which time, axis and size are given. Where impulses are not known, nothing is judged.

Noisy rates appear on both sides of the fit, which would bias plain least squares towards zero. The rates of
neighbouring samples, whose noise is independent, therefore serve as instruments (Fuller, Measurement Error Models,
1.4).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.impulse import Impulse, impulse_blocks, wander
from rb_dynamics.analysis.noise import Labels, Noise, centred, judge, means, typical
from rb_dynamics.analysis.track import Array, Times, TimeSeries, Track, in_blocks, largest, motion_blocks, shared
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.numerics.growing_array import GrowingArray, give_back, stored
from rb_dynamics.numerics.rotation_arrays import rotate_all, rotate_all_inverse

# Directions of the inertia that the motion excites less than this, relative to the best, keep their given value.
_SEEN = 1e-6
# The same, relative to the effect of noise.
_ABOVE_NOISE = 10.0
# A torque whose impulse is a smaller fraction of the momentum does not determine the scale of the inertia.
_FELT = 1e-3
_LEAST_INTERVALS = 10
# An interval counts if the error of its impulse is at most this fraction of the momentum.
_ROUGH = 1e-4
# An inertia, or an error of the rates, explains the residual if it leaves at most this fraction of it.
_FITS = 0.1
# Torques that ask for an inertia this many times larger or smaller are of other units.
_OTHER_SIZE = 3.0
# A body has I1 + I2 >= I3; a fit to noisy data may violate that by this fraction of I3.
_FLAT = 0.01
# A torque is significant at this multiple of its noise; means are taken over as many samples as that needs.
_STANDS_OUT = 8.0
# A body turns about one axis if its rate about others is this fraction of the whole, or this multiple of its noise.
_ONE_AXIS, _NOISE = 1e-3, 2.0
# A mass is given if its relative standard deviation is less than this.
_TOLD = 0.1
TELLS = 0.5
"""A motion does not determine an inertia if each moment may have a larger undetected relative error."""


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
        relative: unexplained angular momentum relative to the largest, root mean square.
        best: the same with the best-fitting inertia.
        inertia: the best-fitting inertia, kg m^2, body axes; with the scale of the given one if no torque determines
            it.
        scaled: whether a torque determines the scale.
        mass: the best-fitting mass, kg; None if no force determines it.
        mass_error: standard deviation of `mass`, from noise and from forces that were not recorded, kg.
        explained: whether the given inertia leaves at most `bound`, or only noise.
        explainable: whether some physical inertia explains the motion.
        noise: standard deviation of the angular momentum relative to the largest; 0 if it is within `bound`.
        unseen: for each principal moment, ascending, the relative error that noise may hide.
        bias: the constant error of the rates that explains the residual, rad/s, body axes; None if none does.
        axis: the only axis about which the body turns, body axes; None if about several.
        recorded: whether the recording has the wrenches that acted.
    """

    start_ns: Times
    time_ns: Times
    force_world: Array
    torque_world: Array
    torque_body: Array
    relative: float
    best: float
    inertia: Array
    scaled: bool
    mass: float | None
    mass_error: float
    explained: bool
    explainable: bool
    noise: float
    unseen: tuple[float, float, float]
    bias: Array | None
    axis: Array | None
    recorded: bool

    @property
    def told(self) -> bool:
        """Whether the noise allows any statement about the inertia."""
        return not self.explained or self.noise == 0.0 or min(self.unseen) < TELLS

    @property
    def strongest(self) -> Stretch:
        """The interval in which the residual torque has the largest effect."""
        size = np.linalg.norm(self.torque_world, axis=1)
        seconds = (self.time_ns - self.start_ns) * 1e-9
        strong = size >= 0.5 * size.max()
        follows = strong[1:] & strong[:-1] & (self.start_ns[1:] == self.time_ns[:-1])
        label = np.cumsum(np.concatenate([[True], ~follows]))
        impulse = np.bincount(label, np.where(strong, size * seconds, 0.0))
        within = label == impulse.argmax()
        return Stretch(
            start_ns=int(self.start_ns[within][0]),
            end_ns=int(self.time_ns[within][-1]),
            torque_body=np.average(self.torque_body[within], axis=0, weights=seconds[within]),
            torque_world=np.average(self.torque_world[within], axis=0, weights=seconds[within]),
            peak=float(size[within].max()),
        )

    @property
    def root_mean_square(self) -> tuple[float, float]:
        """Of the residual force (N) and torque (N m)."""
        force, torque = (np.sqrt(np.mean(np.sum(v**2, axis=1))) for v in (self.force_world, self.torque_world))
        return float(force), float(torque)


def residual(track: Track, bound: float) -> Residual | None:
    """Return the residual.

    None for a log of this package, a particle, rates without a velocity, or too few samples with known impulses.
    """
    pose, twist, body = track.pose, track.twist, track.body
    if track.own or pose is None or twist is None or body is None or body.is_particle:
        return None
    time_ns, *_ = shared(pose.time_ns, twist.time_ns)
    if twist.partial or len(time_ns) <= _LEAST_INTERVALS:
        return None
    moved = _Moved.of(pose, twist, track.twist_in_world, body)
    push, turn = (_Pushed.of(track, kind, time_ns) for kind in ("force", "torque"))
    # Over a gap the quadrature is meaningless, whatever its error estimate.
    known = (turn.error <= _ROUGH * moved.scale) & np.isfinite(push.error)
    known[1:] &= np.diff(time_ns) > 0
    if int(known[1:].sum()) < _LEAST_INTERVALS:
        return None
    known[:1] = False
    stretch = np.cumsum(~known, dtype=np.int_)
    mass, mass_error = _of_mass(moved.speed, push.sums, stretch, push.steps)
    fit = _of_inertia(np.array(body.inertia), moved.basis, turn.sums, stretch, turn.steps)
    relative, best = (_rms(left) / fit.scale if fit.scale > 0.0 else 0.0 for left in (fit.left, fit.best_left))
    # An error of the quadrature is an explanation.
    accepted = bound + (float(turn.error[known].sum()) / moved.scale if moved.scale > 0.0 else 0.0)
    explained = relative <= accepted or not fit.noise.beyond
    fits = best <= max(_FITS * relative, accepted) or not judge(fit.best_left, stretch, turn.steps).beyond
    explainable = fits and _possible(fit.inertia)
    found = None if explained or explainable else _of_another_size(fit, moved.basis, turn, time_ns, stretch)
    if found is not None:
        explainable, best = True, _rms(found.best_left) / fit.scale
    bias = None if explained else _bias(body, moved.attitude, fit.left, stretch, turn.steps)
    noise = fit.noise.level / fit.scale if fit.scale > 0.0 else 0.0
    of_force = _differences(body.mass, moved.speed, push.sums)
    return Residual(
        **_wrench(time_ns, moved.attitude, of_force, fit.left, stretch, _block(fit.left, stretch, fit.noise)),
        relative=relative,
        best=best,
        inertia=(found or fit).inertia,
        scaled=(found or fit).scaled,
        mass=mass,
        mass_error=mass_error,
        explained=explained,
        explainable=explainable,
        noise=noise if relative > bound else 0.0,
        unseen=fit.unseen,
        bias=bias,
        axis=_one_axis(moved.omega, stretch),
        recorded=track.acted,
    )


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
_PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def _unit(i: int, j: int) -> Array:
    matrix = np.zeros((3, 3))
    matrix[i, j] = matrix[j, i] = 1.0
    return matrix


_UNITS = tuple(_unit(i, j) for i, j in _PLACES)


@dataclass(frozen=True)
class _Fit:
    given: Array
    left: Array
    best_left: Array
    inertia: Array
    scaled: bool
    scale: float
    noise: Noise
    unseen: tuple[float, float, float]


def _of_another_size(fit: _Fit, basis: Array, turn: _Pushed, time_ns: Times, stretch: Labels) -> _Fit | None:
    """Return the fit from an inertia of the size that the torques show, if it explains the motion; else None.

    Where the torques or the inertia given are in other units, what is felt, known and seen is told by that size.
    """
    given = np.array([fit.given[i, j] for i, j in _PLACES])
    momentum = centred(stored((_times(rows, given) for rows in in_blocks(basis)), 3), stretch)
    size = _product(momentum, centred(turn.sums, stretch)) / max(_product(momentum, momentum), 1e-300)
    if not size > 0.0 or 1.0 / _OTHER_SIZE < size < _OTHER_SIZE:
        return None
    known = turn.error <= _ROUGH * size * fit.scale
    known[1:] &= np.diff(time_ns) > 0
    known[:1] = False
    if int(known[1:].sum()) < _LEAST_INTERVALS:
        return None
    stretch = np.cumsum(~known, dtype=np.int_)
    found = _of_inertia(size * fit.given, basis, turn.sums, stretch, turn.steps)
    fits = _rms(found.best_left) <= _FITS * _rms(found.left) or not judge(found.best_left, stretch, turn.steps).beyond
    return found if fits and found.scaled and _possible(found.inertia) else None


def _product(one: Array, other: Array) -> float:
    """Return the sum of all products."""
    return sum(float(np.sum(a * b)) for a, b in zip(in_blocks(one), in_blocks(other), strict=True))


def _of_inertia(matrix: Array, basis: Array, turned: Array, stretch: Labels, steps: Array) -> _Fit:
    """Return the residual of `basis` (n, 18) times the inertia and the impulses so far (n, 3), as given and best."""
    given = np.array([matrix[i, j] for i, j in _PLACES])
    scale = max(float(np.linalg.norm(_times(rows, given), axis=1).max()) for rows in in_blocks(basis))
    left = centred(_differences(given, basis, turned), stretch)
    noise = judge(left, stretch, steps)
    felt = largest(centred(turned, stretch))
    scaled = felt > max(_FELT * scale, noise.level)
    # Without a torque every multiple of an inertia fits as well, so only changes that keep the size of the momentum
    # are fitted: of a body that turns about one axis, none is left.
    free = np.eye(6) if scaled else _across(_along(basis, given))
    normal, pull, count = _normal(centred(basis, stretch), left, stretch)
    values, vectors = np.linalg.eigh(free.T @ (normal + normal.T) @ free / 2.0)
    # By noise alone a sum of n products differs from zero by about the square root of n.
    smallest = float(np.abs(values).max()) * _SEEN**2
    rates = (noise.level / max(float(np.linalg.norm(given)), 1e-300)) ** 2
    seen = values > max(smallest, _ABOVE_NOISE * rates * np.sqrt(count))
    vectors = free @ vectors[:, seen]
    best = given - vectors @ np.linalg.solve(vectors.T @ normal @ vectors, vectors.T @ pull)
    if not scaled and best[:3].sum() > 0.0:
        best *= given[:3].sum() / best[:3].sum()
    inertia: Array = np.tensordot(best, np.array(_UNITS), axes=1)
    best_left = centred(_differences(best, basis, turned), stretch)
    return _Fit(matrix, left, best_left, inertia, scaled, scale, noise, _unseen(matrix, vectors, values[seen], noise))


def _along(basis: Array, given: Array) -> Array:
    """Return the sum over all samples of the momentum times what each of the six numbers adds to it."""
    total = np.zeros(6)
    for rows in in_blocks(basis):
        total += np.einsum("nri,nr->i", rows.reshape(-1, 3, 6), _times(rows, given))
    return total


def _normal(basis: Array, left: Array, stretch: Labels) -> tuple[Array, Array, int]:
    """Return the equations of the fit, with the neighbours of each sample as instruments, and of how many samples."""
    normal, pull, count = np.zeros((6, 6)), np.zeros(6), 0
    for rows, rest, labels in zip(in_blocks(basis, 2), in_blocks(left, 2), in_blocks(stretch, 2), strict=True):
        between, moved = _between(labels), rows.reshape(-1, 3, 6)
        beside, here = 0.5 * (moved[:-2][between] + moved[2:][between]), moved[1:-1][between]
        normal += np.einsum("nri,nrj->ij", beside, here)
        pull += np.einsum("nri,nr->i", beside, rest[1:-1][between])
        count += len(here)
    return normal, pull, count


def _between(stretch: Labels) -> NDArray[np.bool_]:
    """Return for each row but the first and last whether both neighbours are in its stretch."""
    result: NDArray[np.bool_] = stretch[:-2] == stretch[2:]
    return result


def _unseen(matrix: Array, directions: Array, values: Array, noise: Noise) -> tuple[float, float, float]:
    """Return the relative error of each principal moment, ascending, that noise may hide."""
    moments, axes = np.linalg.eigh(matrix)
    found = []
    for moment, axis in zip(moments, axes.T, strict=True):
        change = directions.T @ np.array([(1.0 if i == j else 2.0) * axis[i] * axis[j] for i, j in _PLACES])
        effect = float(moment * np.sqrt(np.sum(values * change**2)))
        found.append(noise.seen() / effect if effect > 0.0 else np.inf)
    return found[0], found[1], found[2]


def _bias(body: RigidBody, attitude: Array, left: Array, stretch: Labels, steps: Array) -> Array | None:
    """Return the constant error of the rates (rad/s, body axes) that explains what is `left`; None if none does."""
    matrix = np.array(body.inertia)
    turned = (np.stack([rotate_all(part, row) for row in matrix.T], axis=2) for part in in_blocks(attitude))
    effect = centred(stored((part.reshape(-1, 9) for part in turned), 9), stretch)
    blocks = zip(in_blocks(effect), in_blocks(left), strict=True)
    both = _triangle((np.hstack([part.reshape(-1, 3), rest.reshape(-1, 1)]) for part, rest in blocks), 4)
    bias = np.linalg.lstsq(both[:, :3], both[:, 3], rcond=_SEEN)[0]
    blocks = zip(in_blocks(effect), in_blocks(left), strict=True)
    rest = stored((other - part.reshape(-1, 3, 3) @ bias for part, other in blocks), 3)
    result: Array = np.asarray(bias, dtype=np.float64)
    return result if _rms(rest) <= _FITS * _rms(left) or not judge(rest, stretch, steps).beyond else None


def _triangle(blocks: Iterable[Array], columns: int) -> Array:
    """Return R of the factors Q R of the rows of all blocks, which has their singular values and least squares."""
    result: Array = np.empty((0, columns))
    for block in blocks:
        result = np.asarray(np.linalg.qr(np.concatenate([result, block]), mode="r"))
    return result


def _across(direction: Array) -> Array:
    """Return an orthonormal basis (6, 5) of what is perpendicular to `direction` (6,)."""
    basis: Array = np.linalg.svd(direction[None])[2][1:].T
    return basis


def _one_axis(omega: Array, stretch: Labels) -> Array | None:
    """Return the axis (unit, body axes) about which the body turns; None if about more than one, or none."""
    _, sizes, axes = np.linalg.svd(_triangle(in_blocks(omega), 3))
    beside = float(np.hypot(sizes[1], sizes[2]))
    noise = _NOISE * typical(omega, stretch) * np.sqrt(len(omega))
    if sizes[0] == 0.0 or beside > max(_ONE_AXIS * float(sizes[0]), min(noise, 0.5 * float(sizes[0]))):
        return None
    axis: Array = axes[0] * np.sign(axes[0][np.abs(axes[0]).argmax()])
    return axis


def _of_mass(speed: Array, pushed: Array, stretch: Labels, steps: Array | None = None) -> tuple[float | None, float]:
    """Return the best-fitting mass, and its standard deviation; None if no force determines it.

    The impulses, which have little noise, are the instruments. A residual that is not noise may be parallel to them as
    well as perpendicular: another force, or one at another time, could change the mass by that much.
    """
    impulse = centred(pushed, stretch)
    felt, along = _product(impulse, impulse), _product(impulse, speed)
    if felt == 0.0 or along <= 0.0:
        return None, np.inf
    mass = felt / along
    left = centred(_differences(mass, speed, pushed), stretch)
    noise = judge(left, stretch, steps)
    error = (np.sqrt(_product(left, left)) if noise.beyond else noise.level) * np.sqrt(felt) / along
    return (mass, float(error)) if error <= _TOLD * mass else (None, float(error))


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


def _possible(inertia: Array) -> bool:
    least, middle, largest = np.linalg.eigvalsh(inertia)
    return bool(least > 0.0 and least + middle >= (1.0 - _FLAT) * largest)


def _rms(left: Array) -> float:
    return float(np.sqrt(np.mean(np.concatenate([np.sum(rows**2, axis=1) for rows in in_blocks(left)]))))
