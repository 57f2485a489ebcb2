"""Euler's equations as functions of arrays, and the motions that have a closed form without elliptic functions.

Torque from angular acceleration and vice versa, in space and in the plane; steady rotation; the symmetric top.
Everything is about the centre of mass and in body axes. NaN and infinity in an array appear in the result; anything
that is not an array of real numbers of the right shape is refused. Equation numbers are those of lecture 24. These
functions never integrate: `rb_dynamics.simulate` and `rb_dynamics.free_motion` do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rb_dynamics.body.inertia_quantities import scalar_inertia
from rb_dynamics.body.plausibility import Symmetry, symmetry
from rb_dynamics.body.rigid_body import RigidBody, require_body
from rb_dynamics.body.state import State
from rb_dynamics.errors import BodyError, ConvergenceError
from rb_dynamics.numerics.argument_checks import as_array, instance, vector, vectors
from rb_dynamics.numerics.rotation import Quaternion, exp, matrix, multiply, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, norm, scale

Array = npt.NDArray[np.float64]

STEADY = 1e-12
"""A rotation is steady if its angular acceleration is at most this times |w|^2 (rad/s^2)."""


def angular_momentum(body: RigidBody, angular_velocity_body: npt.ArrayLike) -> Array:
    """Return L = I w, kg m^2/s, body axes, of angular velocities (..., 3) in rad/s (page 22; eq. 28 as a gradient)."""
    omega = _in_principal_axes(require_body(body), angular_velocity_body, "angular_velocity_body")
    return _in_body_axes(body, np.asarray(body.principal_moments) * omega)


def rotational_energy(body: RigidBody, angular_velocity_body: npt.ArrayLike) -> Array:
    """Return T = w . I w / 2, J, shape (...), of angular velocities (..., 3) in rad/s (eqs. 26 and 27)."""
    omega = _in_principal_axes(require_body(body), angular_velocity_body, "angular_velocity_body")
    energy: Array = 0.5 * np.sum(np.asarray(body.principal_moments) * omega**2, axis=-1)
    return energy


def euler_equations(body: RigidBody, angular_velocity_body: npt.ArrayLike, torque_body: npt.ArrayLike = ZERO) -> Array:
    """Return dw/dt = I^-1 (N - w x I w), rad/s^2, body axes (eqs. 18 and 19; eqs. 20 to 25 without torque).

    Angular velocities (rad/s) and torques about the centre of mass (N m) are (..., 3) in body axes and broadcast.

    Raises:
        BodyError: the body is a particle.
    """
    moments, omega = moments_of(body), _in_principal_axes(body, angular_velocity_body, "angular_velocity_body")
    rate = (_in_principal_axes(body, torque_body, "torque_body") - _transport(moments, omega)) / moments
    return _in_body_axes(body, rate)


def moments_of(body: RigidBody) -> Vector:
    """Return the principal moments, kg m^2.

    Raises:
        BodyError: the body is a particle, which has none.
    """
    if require_body(body).principal_moments == ZERO:
        raise BodyError("the body is a particle, without inertia, expected one that can turn; give it a body.inertia")
    return body.principal_moments


def euler_torque(
    body: RigidBody, angular_velocity_body: npt.ArrayLike, angular_acceleration_body: npt.ArrayLike
) -> Array:
    """Return N = I dw/dt + w x I w, N m, body axes: the torque that a motion needs (eqs. 3, 18 and 19).

    Angular velocities (rad/s) and accelerations (rad/s^2) are (..., 3) in body axes and broadcast.
    """
    moments, omega = (
        require_body(body).principal_moments,
        _in_principal_axes(body, angular_velocity_body, "angular_velocity_body"),
    )
    return _in_body_axes(
        body,
        moments * _in_principal_axes(body, angular_acceleration_body, "angular_acceleration_body")
        + _transport(moments, omega),
    )


def require_state(state: State) -> State:
    """Return `state`, with its angular velocity and attitude finite.

    Raises:
        TypeError: it is not a `State`, or has parts that are not numbers.
        BodyError: a number is not finite, or the norm of the quaternion is not 1.
    """
    try:
        return instance(state, State, "state", "write State(...)").checked("state")
    except ValueError as error:
        raise BodyError(str(error)) from None


def planar_torque(body: RigidBody, axis: Vector, angular_acceleration: npt.ArrayLike) -> Array:
    """Return N = I_n dw/dt, N m: the torque about a fixed `axis` (body axes) for accelerations (...) in rad/s^2.

    Newton's law in the plane (page 3), with I_n of eq. 12. About a principal axis this is the whole torque; to hold any
    other axis fixed, the bearings have to add a torque perpendicular to it.

    Raises:
        BodyError: the axis has no direction.
    """
    return scalar_inertia(body, axis) * as_array(angular_acceleration, "angular_acceleration", "numbers (rad/s^2)")


def planar_acceleration(body: RigidBody, axis: Vector, torque: npt.ArrayLike) -> Array:
    """Return dw/dt = N / I_n, rad/s^2, of torques (...) in N m about a fixed `axis`; see `planar_torque`.

    Raises:
        BodyError: the axis is zero, or the body is a particle.
    """
    moments_of(body)
    return as_array(torque, "torque", "numbers (N m)") / scalar_inertia(body, axis)


def rate_in_fixed_axes(vector: npt.ArrayLike, rate: npt.ArrayLike, angular_velocity: npt.ArrayLike) -> Array:
    """Return dv/dt + w x v: the rate of vectors (..., 3) in fixed axes that coincide with the turning ones.

    `rate` is dv/dt as seen in the turning axes. For v = L this is eq. 3; for v = w nothing is added (page 32).
    """
    turning: Array = np.cross(vectors(angular_velocity, "angular_velocity"), vectors(vector, "vector"))
    return vectors(rate, "rate") + turning


def inertia_rate(inertia: npt.ArrayLike, angular_velocity: npt.ArrayLike) -> Array:
    """Return dI/dt = [w]x I - I [w]x, kg m^2/s, in fixed axes, of a matrix (..., 3, 3) that turns with the body.

    This is the second term of eq. 2; times w it is that of eq. 3, because [w]x w = 0. `inertia` and `angular_velocity`
    (..., 3), rad/s, are in the same axes.
    """
    # Row j is w x I_j, column j of [w]x I; as I is symmetric, -I [w]x is the transpose.
    matrices = vectors(inertia, "inertia")
    if matrices.shape[-2:] != (3, 3):
        raise ValueError(f"inertia has the shape {matrices.shape}, expected (..., 3, 3); give three rows of three")
    half = np.cross(vectors(angular_velocity, "angular_velocity")[..., None, :], matrices)
    rate: Array = half + np.swapaxes(half, -1, -2)
    return rate


@dataclass(frozen=True)
class RotationHistory:
    """A rotation at the requested times; the leading dimensions of the arrays are those of the times.

    Attributes:
        orientation_xyzw: (..., 4), body to world.
        angular_velocity_body: (..., 3), rad/s.
    """

    orientation_xyzw: Array
    angular_velocity_body: Array


def steady_rotation(body: RigidBody, state: State, t: npt.ArrayLike) -> RotationHistory:
    """Return the free rotation from `state` with constant w: R(t) = R(0) exp(t w), at times `t` (s).

    Page 33: w along a principal axis, or I1 = I2 = I3. `t` is a number or an array of any shape and sign. A deviation
    from a steady rotation within `STEADY` is ignored; about the middle axis it would grow.

    Raises:
        BodyError: the rotation is not steady.
        ConvergenceError: a time, or the angle turned until then, is not finite.
    """
    omega = require_state(state).angular_velocity_body
    change = float(np.linalg.norm(euler_equations(body, omega)))
    if not change <= STEADY * norm(omega) ** 2:
        raise BodyError(
            f"angular_velocity_body is {list(omega)} and changes by {change:.3g} rad/s^2, expected a spin about a "
            "principal axis or a body with three equal moments; use free_motion for any other"
        )
    return _history(t, norm(omega), lambda time: (multiply(state.orientation_xyzw, exp(scale(time, omega))), omega))


@dataclass(frozen=True)
class SymmetricTop:
    """Torque-free motion of a body with I1 = I2 != I3: its axis precesses about L, and w circles both.

    Attributes:
        axis_body: unit vector along the axis of symmetry, on the side of w, body axes.
        spin: w3, component of w along it, at least 0, rad/s.
        body_rate: (I3 - I1) / I1 w3, rad/s, of w about the axis in body axes; right-handed if positive.
        space_rate: |L| / I1, rad/s, of axis and w about L in world axes.
        body_cone: half angle between w and the axis, rad.
        space_cone: half angle between w and L, rad.
        nutation: angle between the axis and L, rad.
    """

    axis_body: Vector
    spin: float
    body_rate: float
    space_rate: float
    body_cone: float
    space_cone: float
    nutation: float


def symmetric_top(body: RigidBody, angular_velocity_body: Vector) -> SymmetricTop:
    """Return the precession of a symmetric `body` that turns with this angular velocity (rad/s, body axes).

    Page 33, I1 = I2 != I3; Landau & Lifshitz, Mechanics, sections 33 and 36. The cone of w in the body, with half angle
    `body_cone`, rolls on the one in space, with `space_cone`. Moments within `plausibility.SAME_MOMENT` count as equal
    and are replaced by their mean.

    Raises:
        BodyError: the body has three different moments, or three equal ones and therefore no axis.
    """
    axis, across, along = _axis_of_symmetry(body)
    spinning = vector(angular_velocity_body, "angular_velocity_body", "an angular velocity (rad/s)", BodyError)
    omega = rotate_inverse(body.principal_orientation_xyzw, spinning)
    rate = norm(omega)
    x, y, z = (math.copysign(float(k == axis), omega[axis]) for k in range(3))
    spin, swing = abs(omega[axis]), math.hypot(*(omega[k] for k in range(3) if k != axis))
    sine, cosine = (swing / rate, spin / rate) if rate > 0.0 else (0.0, 1.0)
    return SymmetricTop(
        axis_body=rotate(body.principal_orientation_xyzw, (x, y, z)),
        spin=spin,
        body_rate=(along - across) / across * spin,
        space_rate=math.hypot(swing, along / across * spin),
        body_cone=math.atan2(sine, cosine),
        space_cone=math.atan2(abs(along - across) * sine * cosine, across * sine * sine + along * cosine * cosine),
        nutation=math.atan2(across * sine, along * cosine),
    )


def symmetric_rotation(body: RigidBody, state: State, t: npt.ArrayLike) -> RotationHistory:
    """Return the free rotation of a symmetric `body` from `state`: R(t) = R(0) exp(t L / I1) exp(-t body_rate axis).

    `t` (s) is a number or an array of any shape and sign. See `symmetric_top`; if two moments are equal only within
    `plausibility.SAME_MOMENT`, the attitude is off by up to that times |w| t.

    Raises:
        BodyError: the body has three different moments, or three equal ones.
        ConvergenceError: a time, or the angle turned until then, is not finite.
    """
    top = symmetric_top(body, require_state(state).angular_velocity_body)
    omega = state.angular_velocity_body
    # L / I1 = w + body_rate axis: the part of w across the axis, and I3/I1 of the part along it.
    precession = np.add(omega, scale(top.body_rate, top.axis_body)).tolist()

    def at(time: float) -> tuple[Quaternion, Vector]:
        round_axis = exp(scale(time * top.body_rate, top.axis_body))
        turn = multiply(exp(scale(time, precession)), (-round_axis[0], -round_axis[1], -round_axis[2], round_axis[3]))
        return multiply(state.orientation_xyzw, turn), rotate(round_axis, omega)

    return _history(t, norm(omega) + top.space_rate, at)


def _axis_of_symmetry(body: RigidBody) -> tuple[int, float, float]:
    """Return the index of the principal axis of symmetry, the moment across it and the one about it."""
    kind, moments = symmetry(require_body(body)), moments_of(body)
    if kind not in (Symmetry.OBLATE, Symmetry.PROLATE):
        raise BodyError(
            f"principal moments are {list(moments)}, expected two equal ones and a different one; use "
            f"{'steady_rotation' if kind is Symmetry.SPHERE else 'free_motion'} for this body"
        )
    along = max(moments) if kind is Symmetry.OBLATE else min(moments)
    axis = moments.index(along)
    return axis, 0.5 * (moments[axis - 1] + moments[axis - 2]), along


def _history(t: npt.ArrayLike, rate: float, at: Callable[[float], tuple[Quaternion, Vector]]) -> RotationHistory:
    instants = as_array(t, "t", "a time or times (s)")
    if not all(math.isfinite(time * rate) for time in instants.ravel().tolist()):
        raise ConvergenceError(
            f"a time is not finite, or the angle turned until then at {rate:g} rad/s, expected times in s within range"
        )
    rows = [(*orientation, *omega) for orientation, omega in map(at, instants.ravel().tolist())]
    table = np.array(rows, dtype=np.float64).reshape(*instants.shape, 7)
    return RotationHistory(table[..., :4], table[..., 4:])


def _transport(moments: Vector, omega: Array) -> Array:
    """Return w x I w in principal axes, from differences of moments, which vanish exactly if moments are equal.

    This is what the turning of the axes adds to the rate of I w (eq. 3), the negative of the gyroscopic torque of
    `motion/rk4.py`.
    """
    (i1, i2, i3), (w1, w2, w3) = moments, np.moveaxis(omega, -1, 0)
    return np.stack([(i3 - i2) * w2 * w3, (i1 - i3) * w3 * w1, (i2 - i1) * w1 * w2], axis=-1)


def _in_principal_axes(body: RigidBody, vector_body: npt.ArrayLike, name: str) -> Array:
    rotated: Array = vectors(vector_body, name) @ np.array(matrix(body.principal_orientation_xyzw))
    return rotated


def _in_body_axes(body: RigidBody, vector_principal: Array) -> Array:
    rotated: Array = vector_principal @ np.array(matrix(body.principal_orientation_xyzw)).T
    return rotated
