"""What a recorded motion tells about its body: unexplained wrench, and best-fitting inertia and mass.

With J and P the impulses of the recorded torques and forces (`impulse.py`), R I w - J and m v - P for the centre of
mass are constant: exact, and linear in I and m. Nothing is differentiated. What changes by more than its own noise
(`noise.py`) has a cause: a different inertia, a constant error of the rates, or a torque that is not in the
recording, for which time, axis and size are given. Where impulses are not known, nothing is judged.

Noisy rates appear on both sides of the fit, which would bias plain least squares towards zero. The rates of
neighbouring samples, whose noise is independent, therefore serve as instruments (Fuller, Measurement Error Models,
1.4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.impulse import Impulse, impulses, wander
from rb_dynamics.analysis.noise import Labels, Noise, centred, judge, means, typical
from rb_dynamics.analysis.track import Array, Times, Track, motion_of
from rb_dynamics.body.rigid_body import RigidBody
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
"""A motion tells nothing about an inertia if each moment may have a larger undetected relative error."""


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
    motion = motion_of(pose, twist, track.twist_in_world)
    if np.isnan(motion.linear_velocity_body).any():
        return None
    time_ns, attitude, omega = motion.time_ns, motion.orientation_xyzw, motion.angular_velocity_body
    push, turn = (impulses(track, kind, time_ns) for kind in ("force", "torque"))
    scale = float(np.linalg.norm(omega @ np.array(body.inertia), axis=1).max(initial=0.0))
    # Over a gap the quadrature is meaningless, whatever its error estimate.
    known = (turn.error <= _ROUGH * scale) & np.isfinite(push.error)
    known[1:] &= np.diff(time_ns) > 0
    if int(known[1:].sum()) < _LEAST_INTERVALS:
        return None
    known[:1] = False
    stretch = np.cumsum(~known, dtype=np.int_)
    speed = rotate_all(attitude, motion.linear_velocity_body + np.cross(omega, np.array(body.center_of_mass)))
    pushed, turned = (np.cumsum(_impulse(each), axis=0) for each in (push, turn))
    of_force = body.mass * speed - pushed
    push_steps, turn_steps = (wander(track, each.turning, time_ns) for each in (push, turn))
    mass, mass_error = _of_mass(speed, pushed, stretch, push_steps)
    basis = np.stack([rotate_all(attitude, omega @ unit) for unit in _UNITS], axis=2)
    fit = _of_inertia(np.array(body.inertia), basis, turned, stretch, turn_steps)
    relative, best = (_rms(left) / fit.scale if fit.scale > 0.0 else 0.0 for left in (fit.left, fit.best_left))
    # An error of the quadrature is an explanation.
    accepted = bound + (float(turn.error[known].sum()) / scale if scale > 0.0 else 0.0)
    explained = relative <= accepted or not fit.noise.beyond
    fits = best <= max(_FITS * relative, accepted) or not judge(fit.best_left, stretch, turn_steps).beyond
    explainable = fits and _possible(fit.inertia)
    found = (
        None if explained or explainable else _of_another_size(fit, basis, turn, turned, time_ns, stretch, turn_steps)
    )
    if found is not None:
        explainable, best = True, _rms(found.best_left) / fit.scale
    bias = None if explained else _bias(body, attitude, fit.left, stretch, turn_steps)
    size = _block(fit.left, stretch, fit.noise)
    rows = np.arange(len(time_ns)).astype(np.float64)
    (at, of), seconds = means(rows, stretch, size), means((time_ns - time_ns[0]) * 1e-9, stretch, size)[0]
    follows = np.diff(of) == 0
    ends = np.rint(at).astype(np.intp)
    force, torque = (
        (np.diff(means(left, stretch, size)[0], axis=0) / np.diff(seconds)[:, None])[follows]
        for left in (of_force, fit.left)
    )
    noise = fit.noise.level / fit.scale if fit.scale > 0.0 else 0.0
    return Residual(
        start_ns=time_ns[ends[:-1][follows]],
        time_ns=time_ns[ends[1:][follows]],
        force_world=force,
        torque_world=torque,
        torque_body=rotate_all_inverse(attitude[ends[1:][follows]], torque),
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
        axis=_one_axis(omega, stretch),
        recorded=track.acted,
    )


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


def _of_another_size(
    fit: _Fit, basis: Array, turn: Impulse, turned: Array, time_ns: Times, stretch: Labels, steps: Array
) -> _Fit | None:
    """Return the fit from an inertia of the size that the torques show, if it explains the motion; else None.

    Where the torques or the inertia given are in other units, what is felt, known and seen is told by that size.
    """
    momentum = centred(basis @ np.array([fit.given[i, j] for i, j in _PLACES]), stretch)
    size = float(np.sum(momentum * centred(turned, stretch)) / max(np.sum(momentum**2), 1e-300))
    if not size > 0.0 or 1.0 / _OTHER_SIZE < size < _OTHER_SIZE:
        return None
    known = turn.error <= _ROUGH * size * fit.scale
    known[1:] &= np.diff(time_ns) > 0
    known[:1] = False
    if int(known[1:].sum()) < _LEAST_INTERVALS:
        return None
    stretch = np.cumsum(~known, dtype=np.int_)
    found = _of_inertia(size * fit.given, basis, turned, stretch, steps)
    fits = _rms(found.best_left) <= _FITS * _rms(found.left) or not judge(found.best_left, stretch, steps).beyond
    return found if fits and found.scaled and _possible(found.inertia) else None


def _of_inertia(matrix: Array, basis: Array, turned: Array, stretch: Labels, steps: Array) -> _Fit:
    """Return the residual of `basis` (n, 3, 6) times the inertia and the impulses so far (n, 3), as given and best."""
    given = np.array([matrix[i, j] for i, j in _PLACES])
    momentum = basis @ given
    scale = float(np.linalg.norm(momentum, axis=1).max())
    left = centred(momentum - turned, stretch)
    noise = judge(left, stretch, steps)
    felt = np.linalg.norm(centred(turned, stretch), axis=1).max()
    scaled = float(felt) > max(_FELT * scale, noise.level)
    # Without a torque every multiple of an inertia fits as well, so only changes that keep the size of the momentum
    # are fitted: of a body that turns about one axis, none is left.
    free = np.eye(6) if scaled else _across(np.einsum("nri,nr->i", basis, momentum))
    moved = centred(basis, stretch)
    between = _between(stretch)
    before, here, after = moved[:-2][between], moved[1:-1][between], moved[2:][between]
    beside = 0.5 * (before + after)
    normal = np.einsum("nri,nrj->ij", beside, here)
    pull = np.einsum("nri,nr->i", beside, left[1:-1][between])
    values, vectors = np.linalg.eigh(free.T @ (normal + normal.T) @ free / 2.0)
    # By noise alone a sum of n products differs from zero by about the square root of n.
    smallest = float(np.abs(values).max()) * _SEEN**2
    rates = (noise.level / max(float(np.linalg.norm(given)), 1e-300)) ** 2
    seen = values > max(smallest, _ABOVE_NOISE * rates * np.sqrt(len(here)))
    vectors = free @ vectors[:, seen]
    best = given - vectors @ np.linalg.solve(vectors.T @ normal @ vectors, vectors.T @ pull)
    if not scaled and best[:3].sum() > 0.0:
        best *= given[:3].sum() / best[:3].sum()
    inertia: Array = np.tensordot(best, np.array(_UNITS), axes=1)
    best_left = centred(basis @ best - turned, stretch)
    return _Fit(matrix, left, best_left, inertia, scaled, scale, noise, _unseen(matrix, vectors, values[seen], noise))


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
    effect = centred(np.stack([rotate_all(attitude, row) for row in matrix.T], axis=2), stretch)
    bias = np.linalg.lstsq(effect.reshape(-1, 3), left.ravel(), rcond=_SEEN)[0]
    rest = left - effect @ bias
    result: Array = np.asarray(bias, dtype=np.float64)
    return result if _rms(rest) <= _FITS * _rms(left) or not judge(rest, stretch, steps).beyond else None


def _across(direction: Array) -> Array:
    """Return an orthonormal basis (6, 5) of what is perpendicular to `direction` (6,)."""
    basis: Array = np.linalg.svd(direction[None])[2][1:].T
    return basis


def _one_axis(omega: Array, stretch: Labels) -> Array | None:
    """Return the axis (unit, body axes) about which the body turns; None if about more than one, or none."""
    _, sizes, axes = np.linalg.svd(omega, full_matrices=False)
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
    felt, along = float(np.sum(impulse**2)), float(np.sum(impulse * speed))
    if felt == 0.0 or along <= 0.0:
        return None, np.inf
    mass = felt / along
    left = centred(mass * speed - pushed, stretch)
    noise = judge(left, stretch, steps)
    error = (float(np.linalg.norm(left)) if noise.beyond else noise.level) * np.sqrt(felt) / along
    return (mass, error) if error <= _TOLD * mass else (None, error)


def _impulse(impulse: Impulse) -> Array:
    return impulse.exact + np.where(np.isfinite(impulse.error)[:, None], impulse.turning, 0.0)


def _block(left: Array, stretch: Labels, noise: Noise) -> int:
    """Return over how many samples to average so that the largest torque is significant."""
    size = 1
    while noise.sizes and size < noise.sizes[-1]:
        mean, of = means(left, stretch, size)
        steps = np.linalg.norm(np.diff(mean, axis=0), axis=1)[np.diff(of) == 0]
        if steps.max(initial=0.0) > _STANDS_OUT * typical(mean, of):
            break
        size *= 2
    return size


def _possible(inertia: Array) -> bool:
    least, middle, largest = np.linalg.eigvalsh(inertia)
    return bool(least > 0.0 and least + middle >= (1.0 - _FLAT) * largest)


def _rms(left: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
