"""Euler's equations and their closed special cases, against the lecture's formulas and the exact motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rb_dynamics import RigidBody, State, free_motion, scalar_inertia
from rb_dynamics.body.plausibility import SAME_MOMENT
from rb_dynamics.errors import BodyError, ConvergenceError
from rb_dynamics.numerics.rotation import matrix
from rb_dynamics.numerics.vector import Vector
from rb_dynamics.theory.euler_equations import (
    angular_momentum,
    euler_equations,
    euler_torque,
    inertia_rate,
    planar_acceleration,
    planar_torque,
    rate_in_fixed_axes,
    rotational_energy,
    steady_rotation,
    symmetric_rotation,
    symmetric_top,
)

EPS = 2.0**-52
TILT = (0.3, -0.1, 0.5, math.sqrt(0.65))
BODY = RigidBody.from_diagonal(1.0, (1.0, 2.0, 3.0))
SKEW = RigidBody.from_matrix(1.5, ((2.0, 0.3, -0.1), (0.3, 2.5, 0.2), (-0.1, 0.2, 3.0)), (0.1, 0.2, 0.0))

numbers = st.floats(-10.0, 10.0).map(lambda x: x if abs(x) > 1e-6 else 0.0)
vectors = st.tuples(numbers, numbers, numbers)


def state(spin: Vector) -> State:
    return State(orientation_xyzw=TILT, angular_velocity_body=spin)


def test_the_lecture_by_hand() -> None:
    """I = (1, 2, 3), w = (1, 2, 3): eqs. 20 to 22 give (-6, 3, -2/3)."""
    assert euler_equations(BODY, (1.0, 2.0, 3.0)) == pytest.approx([-6.0, 3.0, -2.0 / 3.0], rel=1e-15)
    assert euler_equations(BODY, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)) == pytest.approx([1.0, 0.5, 1.0 / 3.0], rel=1e-15)
    assert angular_momentum(BODY, (1.0, 2.0, 3.0)).tolist() == [1.0, 4.0, 9.0]
    assert rotational_energy(BODY, (1.0, 2.0, 3.0)) == 18.0


@given(vectors, vectors)
def test_torque_and_acceleration_are_inverse_and_are_newtons(omega: Vector, torque: Vector) -> None:
    inertia = np.array(SKEW.inertia)
    rate = euler_equations(SKEW, omega, torque)

    newton = inertia @ rate + np.cross(omega, inertia @ omega)

    assert newton == pytest.approx(np.array(torque), abs=1e-11)
    assert euler_torque(SKEW, omega, rate) == pytest.approx(np.array(torque), abs=1e-11)


def test_arrays_broadcast() -> None:
    omega = np.arange(12.0).reshape(4, 1, 3)
    torque = np.ones((5, 3))

    rates = euler_equations(SKEW, omega, torque)

    assert rates.shape == (4, 5, 3)
    assert rates[2, 3] == pytest.approx(euler_equations(SKEW, omega[2, 0], torque[3]), rel=1e-14)
    assert euler_torque(SKEW, omega, rates) == pytest.approx(np.broadcast_to(torque, (4, 5, 3)), abs=1e-11)
    assert rotational_energy(SKEW, omega).shape == (4, 1)


def test_euler_is_the_derivative_of_the_motion() -> None:
    h = 1e-3
    omega = free_motion(SKEW, state((0.4, -0.8, 0.6)), [-2 * h, -h, 0.0, h, 2 * h]).angular_velocity_body

    difference = (omega[0] - 8.0 * omega[1] + 8.0 * omega[3] - omega[4]) / (12.0 * h)

    assert euler_equations(SKEW, omega[2]) == pytest.approx(difference, abs=1e-11)


@given(vectors)
def test_fixed_axes(omega: Vector) -> None:
    """Eqs. 1 to 3: dI/dt w is w x I w, and the rate of L in fixed axes vanishes without torque."""
    inertia = np.array(SKEW.inertia)
    momentum, rate = angular_momentum(SKEW, omega), euler_equations(SKEW, omega)

    assert inertia_rate(inertia, omega) @ omega == pytest.approx(np.cross(omega, momentum), abs=1e-11)
    assert rate_in_fixed_axes(momentum, inertia @ rate, omega) == pytest.approx(np.zeros(3), abs=1e-11)
    assert rate_in_fixed_axes(omega, rate, omega).tolist() == rate.tolist()


def test_inertia_rate_is_the_derivative_of_the_turned_matrix() -> None:
    h = 1e-4
    motion = free_motion(SKEW, state((0.4, -0.8, 0.6)), [-h, 0.0, h])
    turns = np.array([matrix(tuple(q)) for q in motion.orientation_xyzw])
    turned = turns @ np.array(SKEW.inertia) @ np.swapaxes(turns, 1, 2)
    omega = np.einsum("nij,nj->ni", turns, motion.angular_velocity_body)

    assert inertia_rate(turned, omega)[1] == pytest.approx((turned[2] - turned[0]) / (2.0 * h), abs=1e-7)


def test_the_plane() -> None:
    """About a principal axis Euler's equations leave N = I dw/dt; about another the component along it."""
    assert planar_torque(BODY, (0.0, 2.0, 0.0), [1.0, -2.0]).tolist() == [2.0, -4.0]
    assert planar_acceleration(BODY, (0.0, 2.0, 0.0), 4.0) == 2.0
    assert euler_equations(BODY, (0.0, 5.0, 0.0), (0.0, 4.0, 0.0)).tolist() == [0.0, 2.0, 0.0]

    n = np.array([0.6, 0.0, 0.8])
    needed = euler_torque(SKEW, 3.0 * n, 1.5 * n)
    assert needed @ n == pytest.approx(planar_torque(SKEW, tuple(n.tolist()), 1.5), rel=1e-14)
    assert planar_torque(SKEW, tuple(n.tolist()), 1.0) == scalar_inertia(SKEW, tuple(n.tolist()))
    with pytest.raises(BodyError, match="expected a direction"):
        planar_torque(BODY, (0.0, 0.0, 0.0), 1.0)


@pytest.mark.parametrize(
    ("body", "spin"),
    [
        (BODY, (0.0, 0.0, 2.0)),
        (BODY, (0.0, -2.0, 0.0)),
        (BODY, (0.0, 0.0, 0.0)),
        (RigidBody.from_diagonal(1.0, (2.0, 2.0, 2.0)), (0.3, -0.7, 1.1)),
        (RigidBody.from_diagonal(1.0, (2.0, 2.0, 1.0)), (0.3, -0.7, 0.0)),
    ],
)
def test_a_steady_spin(body: RigidBody, spin: Vector) -> None:
    times = np.array([[-4.0, 0.0], [1.0, 1e3]])
    exact, closed = free_motion(body, state(spin), times), steady_rotation(body, state(spin), times)

    assert closed.angular_velocity_body.shape == (2, 2, 3)
    assert closed.angular_velocity_body == pytest.approx(exact.angular_velocity_body, abs=1e-15)
    assert np.abs(closed.orientation_xyzw - exact.orientation_xyzw).max() <= 100 * EPS * (1 + 2e3)


def test_a_spin_that_changes_is_not_steady() -> None:
    with pytest.raises(BodyError, match=r"changes by .* use free_motion"):
        steady_rotation(BODY, state((0.0, 2.0, 1e-6)), 1.0)
    with pytest.raises(ConvergenceError, match="not finite"):
        steady_rotation(BODY, state((0.0, 2.0, 0.0)), math.inf)
    with pytest.raises(ConvergenceError, match="not finite"):
        steady_rotation(BODY, state((0.0, 1e10, 0.0)), [0.0, 1e300])


SYMMETRIC = {
    "disc": RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.9)),
    "rod": RigidBody.from_diagonal(1.0, (0.1, 1.0, 1.0)),
    "needle": RigidBody.from_diagonal(1.0, (1.0, 1e-9, 1.0)),
    "tilted": RigidBody.from_principal(1.0, (2.0, 1.2, 2.0), (0.5, 0.5, -0.1, 0.7)),
    "a rounding from it": RigidBody.from_diagonal(1.0, (1.0, 1.0 + 4 * EPS, 1.9)),
}


@pytest.mark.parametrize("spin", [(0.3, -0.7, 1.1), (-0.3, 0.2, -1.1), (0.0, 0.0, 1.0), (0.5, 0.0, 0.0)])
@pytest.mark.parametrize("body", SYMMETRIC.values(), ids=SYMMETRIC)
def test_the_symmetric_top_moves_as_it_does(body: RigidBody, spin: Vector) -> None:
    times = np.array([-7.0, 0.0, 0.3, 50.0, 1000.0])
    exact, closed = free_motion(body, state(spin), times), symmetric_rotation(body, state(spin), times)

    signs = np.sign(np.sum(exact.orientation_xyzw * closed.orientation_xyzw, axis=-1, keepdims=True))
    bound = 100 * EPS * (1 + 1500 * 2)
    assert np.abs(closed.orientation_xyzw * signs - exact.orientation_xyzw).max() <= bound
    assert np.abs(closed.angular_velocity_body - exact.angular_velocity_body).max() <= bound


@given(st.floats(0.01, 1.99), vectors.filter(lambda v: math.hypot(*v) > 0.1))
def test_cones_and_rates(along: float, spin: Vector) -> None:
    """The angles add up, and the cones roll on each other without slipping."""
    if abs(along - 1.0) < 1e-3:
        return
    body = RigidBody.from_diagonal(1.0, (1.0, 1.0, along))
    top = symmetric_top(body, spin)
    momentum = angular_momentum(body, spin)
    unit = np.array(spin) / math.hypot(*spin)

    assert top.space_rate == pytest.approx(float(np.linalg.norm(momentum)), rel=1e-12)
    assert top.spin == abs(spin[2])
    assert float(np.dot(unit, top.axis_body)) == pytest.approx(math.cos(top.body_cone), abs=1e-12)
    between = math.atan2(float(np.linalg.norm(np.cross(unit, momentum))), float(unit @ momentum))
    assert top.space_cone == pytest.approx(between, abs=1e-12)
    side = 1.0 if along < 1.0 else -1.0
    assert top.nutation == pytest.approx(top.body_cone + side * top.space_cone, abs=1e-12)
    assert abs(top.body_rate) * math.sin(top.body_cone) == pytest.approx(
        top.space_rate * math.sin(top.space_cone), abs=1e-11
    )
    # w goes round an oblate body the way it spins, round a prolate one the other way.
    assert top.body_rate * (along - 1.0) >= 0.0


def test_the_rate_of_the_earths_wobble() -> None:
    """With (I3 - I1) / I1 = 1/305 the pole goes round once in 305 days (Landau & Lifshitz, section 36)."""
    top = symmetric_top(RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0 + 1.0 / 305.0)), (1e-6, 0.0, 1.0))

    assert top.body_rate == pytest.approx(1.0 / 305.0, rel=1e-12)


def test_what_is_no_symmetric_top_is_refused() -> None:
    with pytest.raises(BodyError, match="use free_motion"):
        symmetric_top(BODY, (1.0, 0.0, 0.0))
    with pytest.raises(BodyError, match="use steady_rotation"):
        symmetric_rotation(RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0)), state((1.0, 0.0, 0.0)), 1.0)


def test_nearly_symmetric_is_within_its_bound() -> None:
    apart = 0.5 * SAME_MOMENT
    body = RigidBody.from_diagonal(1.0, (1.0, 1.0 + apart, 1.9))
    times = np.linspace(0.0, 100.0, 11)

    exact, closed = (
        free_motion(body, state((0.6, 0.0, 0.8)), times),
        symmetric_rotation(body, state((0.6, 0.0, 0.8)), times),
    )

    assert np.abs(closed.orientation_xyzw - exact.orientation_xyzw).max() <= SAME_MOMENT * (1.0 + 100.0)


def test_at_rest() -> None:
    top = symmetric_top(SYMMETRIC["disc"], (0.0, 0.0, 0.0))

    assert (top.spin, top.body_rate, top.space_rate, top.body_cone, top.nutation) == (0.0, 0.0, 0.0, 0.0, 0.0)


def test_a_particle_does_not_turn() -> None:
    particle = RigidBody(1.0, ((0.0,) * 3,) * 3, (0.0,) * 3, (0.0,) * 3, (0.0, 0.0, 0.0, 1.0))

    for refused in (
        lambda: euler_equations(particle, (1.0, 0.0, 0.0)),
        lambda: symmetric_top(particle, (1.0, 0.0, 0.0)),
    ):
        with pytest.raises(BodyError, match="is a particle"):
            refused()
    with pytest.raises(BodyError, match="is a particle"):
        planar_acceleration(particle, (1.0, 0.0, 0.0), 1.0)


ODD = [
    "abc",
    None,
    (1.0, 2.0),
    3.0,
    (1j, 0.0, 0.0),
    ((1.0, 2.0, 3.0), (1.0,)),
    np.ma.array([1.0, 2.0, 3.0], mask=[0, 1, 0]),
]
FUNCTIONS = {
    "angular_momentum": lambda v: angular_momentum(BODY, v),
    "rotational_energy": lambda v: rotational_energy(BODY, v),
    "euler_equations": lambda v: euler_equations(BODY, v),
    "its torque": lambda v: euler_equations(BODY, (0.0, 0.0, 1.0), v),
    "euler_torque": lambda v: euler_torque(BODY, (0.0, 0.0, 1.0), v),
    "rate_in_fixed_axes": lambda v: rate_in_fixed_axes(v, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "inertia_rate": lambda v: inertia_rate(v, (0.0, 0.0, 1.0)),
    "symmetric_top": lambda v: symmetric_top(RigidBody.from_diagonal(1.0, (1.0, 1.0, 2.0)), v),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_no_vector_is_refused_by_name(name: str) -> None:
    """A complex or masked number lost a part without a word; a shape was an error of numpy."""
    for odd in ODD:
        with pytest.raises((TypeError, ValueError, BodyError), match=r"^\w+ (is|has the shape) .*, expected "):
            FUNCTIONS[name](odd)


def test_what_is_no_body_no_state_or_no_time_is_refused_by_name() -> None:
    spin = state((0.0, 0.0, 1.0))
    for call in (
        lambda: angular_momentum("body", (0.0, 0.0, 1.0)),  # type: ignore[arg-type]
        lambda: steady_rotation(BODY, None, 1.0),  # type: ignore[arg-type]
        lambda: steady_rotation(BODY, spin, "abc"),
        lambda: steady_rotation(BODY, spin, 1j),  # type: ignore[arg-type]
        lambda: planar_torque(BODY, (0.0, 0.0, 1.0), "abc"),
        lambda: planar_acceleration(BODY, (0.0, 0.0, 1.0), np.ma.masked),
    ):
        with pytest.raises(TypeError, match=r"^\w+ is .*, expected "):
            call()
    assert np.isnan(angular_momentum(BODY, [[np.nan, 0.0, 0.0], [0.0, 0.0, 1.0]])).any(axis=1).tolist() == [True, False]
