"""Poinsot's construction: a free body turns as if its energy ellipsoid rolled on the invariable plane without slipping.

The plane, the ellipsoid, the two curves of the point of contact (polhode on the ellipsoid, herpolhode in the plane) and
the stability of a spin about each axis, in the space of angular velocities (rad/s). Equation numbers are those of
lecture 24, pages 34 to 37. Curves consist of points of the exact motion; the kind of motion is decided in rational
arithmetic, where nothing cancels.

Sources: Poinsot, Theorie nouvelle de la rotation des corps (1834); Goldstein, Classical Mechanics, section 5.6; Landau
& Lifshitz, Mechanics, section 37.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from rb_dynamics.body.inertia_quantities import middle_axis_growth_time
from rb_dynamics.body.moments_of_force_and_momentum import unit
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import BodyError
from rb_dynamics.motion.free_motion import free_motion
from rb_dynamics.motion.free_rotation import free_rotation
from rb_dynamics.numerics.argument_checks import as_array, number, whole_number
from rb_dynamics.numerics.elliptic import complete_k, rj
from rb_dynamics.numerics.rotation import Quaternion, matrix, rotate, rotate_inverse
from rb_dynamics.numerics.rotation_arrays import rotate_all
from rb_dynamics.numerics.vector import Vector, cross, norm, scale
from rb_dynamics.theory.euler_equations import angular_momentum, euler_equations, moments_of, require_state

Array = npt.NDArray[np.float64]

# On the separatrix the curve never ends: it is computed to within e^-20 of the middle axis.
_SEPARATRIX_SPAN = 20.0

# Central differences of order 8 (Fornberg, Math. Comp. 51 (1988) 699, table 1). Free motion has no rate far above |w|,
# so that a step of 0.02 / |w| leaves 1e-13 |w|^2 of truncation and of rounding.
_STENCIL = ((1, 4.0 / 5.0), (2, -1.0 / 5.0), (3, 4.0 / 105.0), (4, -1.0 / 280.0))
_STENCIL_STEP = 0.02


class PolhodeKind(str, Enum):
    """Kind of polhode: about the axis of the smallest or of the largest moment, on the separatrix, or a point."""

    ABOUT_LEAST = "about the axis of the least moment"
    ABOUT_GREATEST = "about the axis of the greatest moment"
    SEPARATRIX = "separatrix, from the middle axis to the middle axis"
    FIXED_AXIS = "a point, on a principal axis"
    SPHERE = "a point, as everywhere on a sphere"


@dataclass(frozen=True)
class InvariablePlane:
    """The plane on which the ellipsoid rolls: n . w = rho in world axes.

    Attributes:
        normal_world: n = L / |L|, (3,), world axes.
        distance: rho = 2 T / |L| (eq. 29), rad/s: from the centre of the ellipsoid w . I w = 2 T.
        axes_world: (2, 3), unit vectors in the plane, right-handed with n.
    """

    normal_world: Array
    distance: float
    axes_world: Array


def invariable_plane(body: RigidBody, state: State) -> InvariablePlane:
    """Return the invariable plane of the free motion from `state` (eqs. 28 and 29).

    Raises:
        BodyError: the body is at rest or a particle, or its angular velocity is not finite.
    """
    invariants = _Invariants(body, state)
    attitude = state.orientation_xyzw
    momentum = angular_momentum(body, scale(1.0 / invariants.rate, state.angular_velocity_body))
    x, y, z = unit(rotate(attitude, (float(momentum[0]), float(momentum[1]), float(momentum[2]))))
    normal: Vector = (x, y, z)
    # The world axis farthest from the normal, so that the axes of the plane do not depend on the phase of the motion.
    far = min(range(3), key=lambda k: abs(normal[k]))
    first = unit(cross(cross(normal, (float(far == 0), float(far == 1), float(far == 2))), normal))
    return InvariablePlane(
        np.array(normal), _sqrt(invariants.squared_distance), np.array([first, cross(normal, first)])
    )


def energy_ellipsoid(body: RigidBody, state: State) -> Array:
    """Return the semi-axes sqrt(2 T / I_k) of w . I w = 2 T along the principal axes, (3,), rad/s (eqs. 14, 15 and 26).

    T is the energy of rotation alone.

    Raises:
        BodyError: the body is at rest or a particle, or its angular velocity is not finite.
    """
    invariants = _Invariants(body, state)
    return np.array([_sqrt(invariants.twice_energy / moment) for moment in invariants.moments])


@dataclass(frozen=True)
class Polhode:
    """The curve of the angular velocity on the ellipsoid.

    Attributes:
        kind: see `PolhodeKind`.
        period: of the angular velocity in the body, s; infinite on the separatrix, 0 for a point.
        time_s: (n,), from the state on; over one period by default, so that the last point is the first.
        angular_velocity_principal: (n, 3), principal axes, rad/s.
        angular_velocity_body: (n, 3), body axes, rad/s.
    """

    kind: PolhodeKind
    period: float
    time_s: Array
    angular_velocity_principal: Array
    angular_velocity_body: Array


def polhode(body: RigidBody, state: State, n: int = 361, times: npt.ArrayLike | None = None) -> Polhode:
    """Return the polhode through `state` at `n` points, or at `times` (s, from there, of any sign, one axis).

    Without `times` it covers one period; on the separatrix, 20 growth times of the middle axis in both directions.

    Raises:
        BodyError: the body is at rest or a particle, or its angular velocity is not finite.
        ConvergenceError: a time is not finite.
    """
    invariants = _Invariants(body, state)
    instants = invariants.times(n) if times is None else _times(times)
    spins = [free_rotation(body.principal_moments, invariants.spin, t)[1] for t in instants.tolist()]
    principal = np.array(spins, dtype=np.float64).reshape(-1, 3)
    in_body = principal @ np.array(matrix(body.principal_orientation_xyzw)).T
    return Polhode(invariants.kind, invariants.period, instants, principal, in_body)


@dataclass(frozen=True)
class Herpolhode:
    """The curve of the angular velocity in the invariable plane.

    Attributes:
        kind: of its polhode.
        period: of the polhode, s; the distance from L repeats in half of it. Infinite on the separatrix, 0 for a point.
        inner_radius: least distance from L, rad/s; 0 on the separatrix.
        outer_radius: largest distance from L, rad/s.
        advance: angle about L in one period, rad; may be more than 2 pi. Infinite on the separatrix, 0 for a point.
        time_s: (n,), from the state on.
        angular_velocity_world: (n, 3), world axes, rad/s.
        points: (n, 2), the same along `InvariablePlane.axes_world`, rad/s.
    """

    kind: PolhodeKind
    period: float
    inner_radius: float
    outer_radius: float
    advance: float
    time_s: Array
    angular_velocity_world: Array
    points: Array


def herpolhode(body: RigidBody, state: State, n: int = 361, times: npt.ArrayLike | None = None) -> Herpolhode:
    """Return the herpolhode from `state` at the times of `polhode`.

    Radii and advance are closed forms and do not depend on the times. The advance is that of the axis which the polhode
    encircles; seen along L, w never encircles that axis, so the advance is the same for both.

    Raises:
        BodyError: the body is at rest or a particle, or its angular velocity is not finite.
        ConvergenceError: a time is not finite, or so long that the turn has no correct digit left.
    """
    invariants, plane = _Invariants(body, state), invariable_plane(body, state)
    instants = invariants.times(n) if times is None else _times(times)
    motion = free_motion(body, state, instants)
    omega = rotate_all(motion.orientation_xyzw, motion.angular_velocity_body)
    inner, outer = invariants.radii
    return Herpolhode(
        invariants.kind,
        invariants.period,
        inner,
        outer,
        invariants.advance,
        instants,
        omega,
        omega @ plane.axes_world.T,
    )


@dataclass(frozen=True)
class Rolling:
    """Deviation of the motion from rolling without slipping, at each time; all 0 except for rounding errors.

    Attributes:
        plane_distance: |n . w - rho| / rho (eq. 29): the plane does not move.
        normal: |N / |N| - n| with N the gradient of w . I w / 2 at w, in world axes (eqs. 27 and 28): the ellipsoid
            touches the plane at w.
        slip: |(dw/dt)_world - (dw/dt)_body| / |w|^2: the point of contact moves equally along both curves. In world
            axes by finite differences of the motion, in body axes by Euler's equations.
    """

    plane_distance: Array
    normal: Array
    slip: Array


def rolling(body: RigidBody, state: State, times: npt.ArrayLike) -> Rolling:
    """Return the residuals of Poinsot's theorem in the computed motion at `times` (s, of any shape).

    The point of the ellipsoid at w is on the axis of rotation, hence at rest. What has to be checked is that the point
    of contact moves equally on both surfaces.

    Raises:
        BodyError: the body is at rest or a particle, or its angular velocity is not finite.
        ConvergenceError: a time is not finite, or so long that the turn has no correct digit left.
    """
    plane, motion = invariable_plane(body, state), free_motion(body, state, times)
    attitude, omega = motion.orientation_xyzw, motion.angular_velocity_body
    gradient = rotate_all(attitude, angular_momentum(body, omega / np.linalg.norm(omega, axis=-1, keepdims=True)))
    gradient /= np.linalg.norm(gradient, axis=-1, keepdims=True)
    height = rotate_all(attitude, omega) @ plane.normal_world
    slip = [
        _slip(body, (qx, qy, qz, qw), (wx, wy, wz))
        for (qx, qy, qz, qw), (wx, wy, wz) in zip(
            attitude.reshape(-1, 4).tolist(), omega.reshape(-1, 3).tolist(), strict=True
        )
    ]
    return Rolling(
        np.abs(height - plane.distance) / plane.distance,
        np.linalg.norm(gradient - plane.normal_world, axis=-1),
        np.array(slip, dtype=np.float64).reshape(omega.shape[:-1]),
    )


class Stability(str, Enum):
    """Behaviour of a small deviation from a spin about an axis: it oscillates, drifts or grows."""

    STABLE = "stable"
    NEUTRAL = "neutral"
    UNSTABLE = "unstable"


@dataclass(frozen=True, slots=True)
class AxisStability:
    """A spin about one principal axis.

    Attributes:
        axis_body: unit vector, body axes.
        moment: kg m^2.
        stability: neutral if the moment equals another one, except for the axis of a symmetric body.
        growth_rate: 1/s, of a deviation as e^(rate t); 0 if it does not grow.
        oscillation_rate: rad/s, of a deviation in body axes; 0 if it does not oscillate.
    """

    axis_body: Vector
    moment: float
    stability: Stability
    growth_rate: float
    oscillation_rate: float


def axis_stability(body: RigidBody, rate: float = 1.0) -> tuple[AxisStability, AxisStability, AxisStability]:
    """Return how stable a spin of `rate` (rad/s) about each principal axis is, in the order of `principal_moments`.

    Eqs. 20 to 22 linearised about axis k: d^2/dt^2 = -w^2 (I_k - I_i)(I_k - I_j) / (I_i I_j). Both rates are
    proportional to `rate`.

    Raises:
        BodyError: the body is a particle.
    """
    spin = number(rate, "rate", "an angular velocity (rad/s)")
    first, second, third = (_axis_stability(body, k, spin) for k in range(3))
    return first, second, third


def _axis_stability(body: RigidBody, k: int, rate: float) -> AxisStability:
    moments = moments_of(body)
    own, i, j = moments[k], moments[k - 1], moments[k - 2]
    axis = rotate(body.principal_orientation_xyzw, (float(k == 0), float(k == 1), float(k == 2)))
    growth_time = middle_axis_growth_time(body, scale(rate, axis))
    stiffness = (own - i) / i * ((own - j) / j)
    if growth_time is not None:
        return AxisStability(axis, own, Stability.UNSTABLE, 1.0 / growth_time, 0.0)
    stability = Stability.STABLE if stiffness > 0.0 else Stability.NEUTRAL
    return AxisStability(axis, own, stability, 0.0, abs(rate) * math.sqrt(max(0.0, stiffness)))


def _times(times: npt.ArrayLike) -> Array:
    instants: Array = as_array(times, "times", "times (s) along one axis")
    if instants.ndim != 1:
        raise ValueError(f"times has the shape {instants.shape}, expected one axis; write a list of times (s)")
    return instants


class _Invariants:
    """Energy and momentum of the rotation as rational numbers, computed from the given floats without rounding.

    Attributes:
        spin: angular velocity in principal axes, rad/s.
        rate: |w|, rad/s.
        moments: of the principal axes.
        twice_energy: 2 T = w . I w.
        squared_momentum: L^2.
        squared_distance: of the invariable plane, (2 T)^2 / L^2.
        tumble: the elliptic motion; None if w is constant.
    """

    def __init__(self, body: RigidBody, state: State) -> None:
        moments, state = moments_of(body), require_state(state)
        self.spin = rotate_inverse(body.principal_orientation_xyzw, state.angular_velocity_body)
        self.rate = norm(self.spin)
        if not (math.isfinite(self.rate) and self.rate > 0.0):
            raise BodyError(
                f"angular_velocity_body is {list(state.angular_velocity_body)}, expected a rate within range, not "
                "zero: without angular momentum there is no invariable plane"
            )
        self.moments = i = [Fraction(moment) for moment in moments]
        w = [Fraction(component) for component in self.spin]
        self.twice_energy = i[0] * w[0] ** 2 + i[1] * w[1] ** 2 + i[2] * w[2] ** 2
        self.squared_momentum = (i[0] * w[0]) ** 2 + (i[1] * w[1]) ** 2 + (i[2] * w[2]) ** 2
        self.squared_distance = self.twice_energy**2 / self.squared_momentum
        # For a point of contact that does not move.
        self._squared_radius = w[0] ** 2 + w[1] ** 2 + w[2] ** 2 - self.squared_distance
        steady = all((i[k - 1] - i[k - 2]) * w[k - 1] * w[k - 2] == 0 for k in range(3))
        self.tumble = None if steady else _tumble(i, self.twice_energy, self.squared_momentum)

    @property
    def kind(self) -> PolhodeKind:
        if self.tumble is None:
            return PolhodeKind.SPHERE if len(set(self.moments)) == 1 else PolhodeKind.FIXED_AXIS
        if self.tumble.m1 == 0.0:
            return PolhodeKind.SEPARATRIX
        return PolhodeKind.ABOUT_GREATEST if self.tumble.c > self.tumble.a else PolhodeKind.ABOUT_LEAST

    @property
    def period(self) -> float:
        return 0.0 if self.tumble is None else 4.0 * complete_k(self.tumble.m1) / self.tumble.rate

    @property
    def radii(self) -> tuple[float, float]:
        """Least and largest distance of the point of contact from L: where u is 0 and K, or the other way round."""
        if self.tumble is None:
            radius = _sqrt(self._squared_radius)
            return radius, radius
        a, b, c = self.tumble[:3]
        short, long = self.twice_energy * c - self.squared_momentum, self.squared_momentum - self.twice_energy * a
        start = short / (a * (c - a)) + long / (c * (c - a))
        quarter = short / (b * (c - b)) + (self.squared_momentum - self.twice_energy * b) / (c * (c - b))
        return (
            _sqrt(min(start, quarter) - self.squared_distance),
            _sqrt(max(start, quarter) - self.squared_distance),
        )

    @property
    def advance(self) -> float:
        """Precession of axis c in one period: L t / I_b and a complete integral of the third kind, as in `free`."""
        if self.tumble is None or self.tumble.m1 == 0.0:
            return 0.0 if self.tumble is None else math.inf
        a, b, c, m1, rate = self.tumble
        precession, beta = _sqrt(self.squared_momentum / (b * b)), float(b * (c - a) / (a * (c - b)))
        third_kind = m1 / (3.0 * beta) * rj(0.0, m1, 1.0, m1 / beta)
        return precession * (self.period + 4.0 * float((b - a) / a) / rate * third_kind)

    def times(self, n: int) -> Array:
        """Return the default times (s) of the curves."""
        times: Array
        n = whole_number(n, "n", "write how many points to return")
        if n < 0:
            raise ValueError(f"n is {n}, expected a number of points, 0 or more")
        if self.tumble is not None and self.tumble.m1 == 0.0:
            times = np.linspace(-_SEPARATRIX_SPAN, _SEPARATRIX_SPAN, n, dtype=np.float64) / self.tumble.rate
        else:
            times = np.linspace(0.0, self.period, n, dtype=np.float64)
        return times


class _Tumble(NamedTuple):
    """A motion w = (A cn u, B sn u, C dn u) in principal axes a, b, c: b the middle one, c the one it encircles.

    Attributes:
        a, b, c: moments.
        m1: complementary parameter; 0 on the separatrix, or too near for double precision to distinguish.
        rate: |du/dt|, rad/s.
    """

    a: Fraction
    b: Fraction
    c: Fraction
    m1: float
    rate: float


def _tumble(moments: list[Fraction], twice_energy: Fraction, squared_momentum: Fraction) -> _Tumble:
    """Return the motion with these moments, 2 T and L^2 (Landau & Lifshitz, section 37).

    With e = (I_c - I_b)(L^2 - 2 T I_a): (du/dt)^2 = e / (I_a I_b I_c) and m1 = (I_c - I_a)(L^2 - 2 T I_b) / e.
    """
    low, b, high = sorted(moments)
    beyond = squared_momentum - twice_energy * b
    a, c = (low, high) if beyond > 0 or (beyond == 0 and high > b) else (high, low)
    excess = (c - b) * (squared_momentum - twice_energy * a)
    return _Tumble(a, b, c, float((c - a) * beyond / excess), _sqrt(excess / (a * b * c)))


def _sqrt(x: Fraction) -> float:
    """Return the square root of x >= 0 to the last digit, even if x itself is beyond the range of double precision."""
    half = (x.numerator.bit_length() - x.denominator.bit_length()) // 2
    return math.ldexp(math.sqrt(x / Fraction(4) ** half), half)


def _slip(body: RigidBody, orientation: Quaternion, omega: Vector) -> float:
    """Return |(dw/dt)_world - (dw/dt)_body| / |w|^2 at this attitude and angular velocity (body axes)."""
    rate = norm(omega)
    steps = np.array([k for k, _ in _STENCIL])
    motion = free_motion(
        body,
        State(orientation_xyzw=orientation, angular_velocity_body=omega),
        np.multiply.outer((1.0, -1.0), steps * _STENCIL_STEP / rate),
    )
    after, before = rotate_all(motion.orientation_xyzw, motion.angular_velocity_body / rate)
    in_world = np.array([weight for _, weight in _STENCIL]) @ (after - before) / _STENCIL_STEP
    in_body = euler_equations(body, np.array(omega) / rate)
    return float(np.linalg.norm(in_world - rotate_all(np.array(orientation), in_body)))
