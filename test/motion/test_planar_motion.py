"""Planar motion: the closed form with one angle agrees with the full equations to round-off."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from motions import EPS

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.arc import Arc
from rb_dynamics.motion.closed_form import EXACT, has_closed_form
from rb_dynamics.motion.phase_state import PhaseState, inertia_of
from rb_dynamics.motion.planar_motion import fixed_axis
from rb_dynamics.motion.step_control import OwnControl, WholeArc
from rb_dynamics.numerics.rotation import IDENTITY, angle_between, exp
from rb_dynamics.numerics.vector import ZERO, Vector, norm, subtract
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene.read import parse_scene

BODY = RigidBody.from_diagonal(1.7, (1.0, 2.0, 2.5))
TILTED = exp((0.3, -1.0, 0.4))


def along(axis: int, value: float) -> Vector:
    vector = [0.0, 0.0, 0.0]
    vector[axis] = value
    return (vector[0], vector[1], vector[2])


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("rate", [0.0, 0.8, -3.0])
@pytest.mark.parametrize("torque", [0.0, 0.4, -0.9])
def test_the_closed_form_is_what_the_full_equations_give(axis: int, rate: float, torque: float) -> None:
    held = HeldWrench(along(axis, 0.6), along(axis, torque), (0.1, -0.2, 0.3), ZERO)
    initial = State(
        orientation_xyzw=TILTED, linear_velocity_world=(1.0, 0.0, -1.0), angular_velocity_body=along(axis, rate)
    )
    start = PhaseState.of(BODY, initial)
    reduced = Arc(EXACT, inertia_of(BODY), held, WholeArc(), 0, start).at(5_000_000_000)
    full = Arc(METHODS["taylor"], inertia_of(BODY), held, OwnControl(1e-13, 5.0), 0, start).at(5_000_000_000)

    turned = 5.0 * abs(rate) + 12.5 * abs(torque)
    assert angle_between(reduced.orientation, full.orientation) <= 40 * EPS * (1.0 + turned)
    assert norm(subtract(reduced.angular_velocity, full.angular_velocity)) <= 10 * EPS * (1.0 + turned)
    for name in ("center_of_mass_world", "linear_momentum_world", "impulse_world", "torque_impulse_world"):
        found, expected = getattr(reduced, name), getattr(full, name)
        assert norm(subtract(found, expected)) <= 40 * EPS * (1.0 + norm(expected)), name
    assert reduced.work == pytest.approx(full.work, rel=100 * EPS, abs=100 * EPS)


def test_a_torque_in_world_axes_along_the_axis_is_planar_too() -> None:
    text = (
        "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0, 0, 0.5]}\n"
        "wrenches: []\nduration: 4\neffects: [{type: scheduled_wrench, frame_id: world, "
        "schedule: [{time: 0, torque: [0, 0, 0.6], force: [0, 0, 1]}]}]"
    )
    run = simulate(parse_scene(text))

    assert run.method == "exact"
    assert run.sample.angular_velocity_body == pytest.approx((0.0, 0.0, 0.5 + 0.2 * 4.0), abs=4 * EPS)
    angle = 0.5 * 4.0 + 0.5 * 0.2 * 16.0
    assert angle_between(run.sample.orientation_xyzw, exp((0.0, 0.0, angle))) < 8 * EPS
    assert run.sample.work == pytest.approx(0.6 * angle + 1.0 * 8.0, rel=8 * EPS)


@pytest.mark.parametrize(
    ("held", "omega"),
    [
        (HeldWrench(torque_body=(0.0, 1e-300, 0.0)), (0.0, 0.0, 1.0)),
        (HeldWrench(torque_body=(0.0, 0.0, 1.0)), (0.0, 5e-324, 1.0)),
        (HeldWrench(torque_world=(0.0, 0.0, 1.0)), (0.0, 0.0, 1.0)),  # the body is tilted
        (HeldWrench(force_body=(1e-200, 0.0, 0.0)), (0.0, 0.0, 1.0)),
        (HeldWrench(force_body=(1.0, 0.0, 0.0), torque_body=(0.0, 0.0, 1.0)), ZERO),
    ],
)
def test_the_slightest_tilt_is_not_planar(held: HeldWrench, omega: Vector) -> None:
    assert fixed_axis(held, TILTED, omega) == -1
    assert not has_closed_form(held, TILTED, omega)
    with pytest.raises(ConvergenceError, match="tilts the axis of rotation"):
        EXACT.step(inertia_of(BODY), held, 1.0, ZERO, TILTED, omega)


def test_a_body_that_does_not_turn_may_be_pushed_in_its_own_axes() -> None:
    text = (
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: []\nduration: 3\n"
        "initial: {orientation: {x: 0, y: 0, z: 1, w: 0}}\n"
        "effects: [{type: scheduled_wrench, schedule: [{time: 0, force: [4, 0, 0]}]}]"
    )
    run = simulate(parse_scene(text))
    assert run.method == "exact"
    assert run.sample.position_world == pytest.approx((-9.0, 0.0, 0.0), abs=1e-14)


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(0.0, 100.0))
def test_in_one_step_or_in_two(rate: float, torque: float, time: float) -> None:
    inertia, held = inertia_of(BODY), HeldWrench(torque_body=(0.0, torque, 0.0))
    whole = EXACT.step(inertia, held, time, ZERO, IDENTITY, (0.0, rate, 0.0))
    half = EXACT.step(inertia, held, 0.5 * time, ZERO, IDENTITY, (0.0, rate, 0.0))
    rest = EXACT.step(inertia, held, 0.5 * time, ZERO, half.orientation, half.angular_velocity)
    size = 1.0 + time * (abs(rate) + abs(torque) * time)
    assert angle_between(whole.orientation, rest.orientation) <= 8 * EPS * size
    assert math.isclose(whole.work, half.work + rest.work, rel_tol=0.0, abs_tol=8 * EPS * size * (1.0 + abs(torque)))
