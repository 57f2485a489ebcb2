"""Terms of the equations of motion in principal axes, shared by the Runge-Kutta methods, samples and sensors."""

from __future__ import annotations

from rb_dynamics.numerics.rotation import Quaternion, rotate, rotate_inverse
from rb_dynamics.numerics.vector import Vector, add, cross, divide, scale, subtract


def differences_of(moments: Vector) -> Vector:
    """Return I2 - I3, I3 - I1 and I1 - I2."""
    a, b, c = moments
    return (b - c, c - a, a - b)


def gyroscopic(differences: Vector, omega: Vector) -> Vector:
    """Return I w x w, which tilts the axis of a free body (lecture 24, eq. 18), from `differences_of` the moments.

    No difference is larger than the moment that divides it, so rounding errors are not amplified for a needle, as they
    would be in w x I w, the difference of two products.
    """
    (d1, d2, d3), (w1, w2, w3) = differences, omega
    return (d1 * w2 * w3, d2 * w3 * w1, d3 * w1 * w2)


def half_product(q: Quaternion, omega: Vector) -> Quaternion:
    """Return q omega / 2, the rate of q for an angular velocity in the rotating axes."""
    (x, y, z, w), (a, b, c) = q, scale(0.5, omega)
    return (w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a, -x * a - y * b - z * c)


def turned(q: Quaternion, twice: float, v: Vector) -> Vector:
    """Return R(q) v for a quaternion of any length, twice = 2 / |q|^2; see `rotation.rotate`."""
    x, y, z, w = q
    tx = twice * (y * v[2] - z * v[1])
    ty = twice * (z * v[0] - x * v[2])
    tz = twice * (x * v[1] - y * v[0])
    return (
        v[0] + w * tx + (y * tz - z * ty),
        v[1] + w * ty + (z * tx - x * tz),
        v[2] + w * tz + (x * ty - y * tx),
    )


def accelerations(
    mass: float,
    moments: Vector,
    center: Vector,
    axes: Quaternion,
    orientation: Quaternion,
    omega: Vector,
    forces: tuple[Vector, Vector],
    torque: Vector,
) -> tuple[Vector, Vector]:
    """Return the acceleration of the body origin (m/s^2) and the angular one (rad/s^2), both in body axes.

    Euler's equations (lecture 24, eqs. 18 and 19) and F = m dv/dt.

    Args:
        mass: kg.
        moments: principal moments, kg m^2.
        center: of mass from the body origin, body axes, m.
        axes: principal to body axes.
        orientation: principal to world axes.
        omega: angular velocity, principal axes, rad/s.
        forces: in principal and in world axes, N.
        torque: about the centre of mass, principal axes, N m.
    """
    omega_dot = rotate(axes, divide(add(torque, gyroscopic(differences_of(moments), omega)), moments))
    force = rotate(axes, add(forces[0], rotate_inverse(orientation, forces[1])))
    omega_body = rotate(axes, omega)
    turning = add(cross(omega_dot, center), cross(omega_body, cross(omega_body, center)))
    return subtract(scale(1.0 / mass, force), turning), omega_dot
