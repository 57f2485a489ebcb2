"""What a recorded motion says of its body: the wrench that nothing recorded explains, the inertia that fits best.

Where no inertia fits, a torque acted that is not in the recording: then it says when, about which axis and how large.

From sample to sample, with J and P the impulses of the recorded torques and forces (`impulse.py`),
R2 I w2 - R1 I w1 = J and m (v2 - v1) = P for the centre of mass: exact, and linear in I and m. What is left over with
the body given, divided by the time between the samples, is the mean residual wrench. Never judges where impulses are
not known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rb_dynamics.analysis.impulse import Impulse, impulses
from rb_dynamics.analysis.track import Array, Times, Track, motion_of
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.numerics.rotation_arrays import rotate_all, rotate_all_inverse

# A fit of six numbers improves on the body given by chance: its F statistic exceeds 3.75 once in 1000 times.
_CHANCE = 3.75
# Directions of the inertia that the motion moves less than this, relative to the best seen, are left as given.
_SEEN = 1e-6
# A torque whose impulse is smaller than this part of the momentum does not tell the scale of the inertia.
_FELT = 1e-3
_LEAST_INTERVALS = 10
# An inertia explains what is left over where it leaves no more than this part of it.
_FITS = 0.1
# A body keeps I1 + I2 >= I3; a fit to numbers with noise may miss that by this part of I3.
_FLAT = 0.01
# What is left over lasts where neighbours agree at least this much; noise of the rates makes them opposite.
_LASTS = 0.5


@dataclass(frozen=True)
class Stretch:
    """Where a torque that nothing recorded explains is largest: above half its peak all the time.

    Attributes:
        start_ns: begin of its first interval.
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
    """How well the body given explains the motion.

    Attributes:
        start_ns: begin of each interval.
        time_ns: end of each interval.
        force_world: mean residual force in each interval, N, world axes.
        torque_world: mean residual torque about the centre of mass, N m, world axes.
        torque_body: the same in body axes at the end of the interval.
        relative: left over momentum over the largest angular momentum seen, root mean square of an interval.
        best: the same with the inertia that fits best.
        inertia: which that is, kg m^2, body axes; its scale is that of the body given where no torque tells it.
        scaled: whether a torque told the scale.
        mass: which fits best, kg; None where no force tells it.
        explained: whether the inertia given leaves no more than `bound`, or no more than chance.
        explainable: whether an inertia that a body can have explains it.
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
    explained: bool
    explainable: bool

    @property
    def strongest(self) -> Stretch:
        """Where the residual torque does most."""
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
    """Return what is left over; None for a log of this package, a particle, or too few samples with known impulses."""
    pose, twist, body = track.pose, track.twist, track.body
    if track.own or pose is None or twist is None or body is None or body.is_particle:
        return None
    motion = motion_of(pose, twist, track.twist_in_world)
    time_ns, attitude, omega = motion.time_ns, motion.orientation_xyzw, motion.angular_velocity_body
    push, turn = (impulses(track, kind, time_ns) for kind in ("force", "torque"))
    known = np.isfinite(push.error) & np.isfinite(turn.error) & (np.diff(time_ns, prepend=time_ns[:1]) > 0)
    if int(known.sum()) < _LEAST_INTERVALS:
        return None
    speed = rotate_all(attitude, motion.linear_velocity_body + np.cross(omega, np.array(body.center_of_mass)))
    seconds = np.diff(time_ns, prepend=time_ns[:1])[known, None] * 1e-9
    force, mass = _of_mass(body, np.diff(speed, axis=0, prepend=speed[:1])[known], _impulse(push)[known])
    basis = np.stack([rotate_all(attitude, omega @ unit) for unit in _UNITS], axis=2)
    fit = _of_inertia(body, np.diff(basis, axis=0, prepend=basis[:1])[known], _impulse(turn)[known], basis)
    count = fit.left.size
    improved = max(0.0, float(np.sum(fit.left**2) - np.sum(fit.best_left**2))) / 6.0
    noise = float(np.sum(fit.best_left**2)) / max(count - 6, 1)
    relative, best = (_rms(left) / fit.scale if fit.scale > 0.0 else 0.0 for left in (fit.left, fit.best_left))
    torque = fit.left / seconds
    lasts = _agreement(fit.best_left) > _LASTS
    return Residual(
        start_ns=time_ns[:-1][known[1:]],
        time_ns=time_ns[known],
        force_world=force / seconds,
        torque_world=torque,
        torque_body=rotate_all_inverse(attitude[known], torque),
        relative=relative,
        best=best,
        inertia=fit.inertia,
        scaled=fit.scaled,
        mass=mass,
        explained=relative <= bound or (improved <= _CHANCE * noise and not lasts),
        explainable=(best <= _FITS * relative or not lasts) and _possible(fit.inertia),
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
    left: Array
    best_left: Array
    inertia: Array
    scaled: bool
    scale: float


def _of_inertia(body: RigidBody, change: Array, impulse: Array, basis: Array) -> _Fit:
    """Return what `change` (n, 3, 6) times the inertia leaves of the impulses (n, 3), as given and at best."""
    given = np.array([body.inertia[i][j] for i, j in _PLACES])
    scale = float(np.linalg.norm(basis @ given, axis=1).max())
    left = change @ given - impulse
    rows = change.reshape(-1, 6)
    scaled = float(np.linalg.norm(impulse.cumsum(axis=0), axis=1).max()) > _FELT * scale
    # Without a torque every multiple of an inertia fits as well: changes that keep the trace are looked for.
    free = np.eye(6) if scaled else _keeping_trace()
    step = np.linalg.lstsq(rows @ free, -left.ravel(), rcond=_SEEN)[0]
    best = given + free @ step
    inertia: Array = np.tensordot(best, np.array(_UNITS), axes=1)
    return _Fit(left, change @ best - impulse, inertia, scaled, scale)


def _keeping_trace() -> Array:
    """Return a basis (6, 5) of the changes of the inertia that keep its trace."""
    basis = np.zeros((6, 5))
    basis[:3, 0], basis[:3, 1] = np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0), np.array([1.0, 1.0, -2.0]) / np.sqrt(6.0)
    basis[3:, 2:] = np.eye(3)
    return basis


def _of_mass(body: RigidBody, change: Array, impulse: Array) -> tuple[Array, float | None]:
    """Return what the mass given leaves of the impulses, and the mass that fits best; None where no force tells."""
    moved = float(np.sum(change**2))
    mass = float(np.sum(change * impulse)) / moved if moved > 0.0 and impulse.any() else None
    return body.mass * change - impulse, mass


def _impulse(impulse: Impulse) -> Array:
    return impulse.exact + np.where(np.isfinite(impulse.error)[:, None], impulse.turning, 0.0)


def _agreement(left: Array) -> float:
    """Return the correlation of neighbours: near 1 for what acts for a while, -1/2 for noise of the rates."""
    whole = float(np.sum(left**2))
    return float(np.sum(left[1:] * left[:-1])) / whole if whole > 0.0 else 0.0


def _possible(inertia: Array) -> bool:
    least, middle, largest = np.linalg.eigvalsh(inertia)
    return bool(least > 0.0 and least + middle >= (1.0 - _FLAT) * largest)


def _rms(left: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
