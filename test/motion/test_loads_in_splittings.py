"""Loads that change inside a step, in splittings and midpoint methods: order, balances, symmetry, long orbits.

The body moves in the field of a point mass with gravity gradient, has a magnet in a rotating field, and a force
that oscillates in time; the right-hand side of the reference is written separately, in world axes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from motions import EPS, forced, slope
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Increment, Inertia
from rb_dynamics.motion.arc import Arc, LoadFrom
from rb_dynamics.motion.method import Load, LoadDependence
from rb_dynamics.motion.phase_state import PhaseState, in_principal_axes, inertia_of
from rb_dynamics.motion.step_control import FixedStep
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import Quaternion, angle_between, conjugate, multiply, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, cross, dot, norm, scale, subtract
from rb_dynamics.numerics.vector import multiply as times

FIELD = ["strang2", "strang6", "dmv82", "dmv864", "dmv104", "dlm2", "dlm4", "dlm6"]
ANY = ["midpoint", "midpoint4", "midpoint6"]
each_of_field = pytest.mark.parametrize("name", FIELD)
each_of_any = pytest.mark.parametrize("name", ANY)
each = pytest.mark.parametrize("name", FIELD + ANY)

TIME = 2.0
ATTRACTION = 6.0
CENTER: Vector = (-1.9, 0.8, 0.9)
DIPOLE: Vector = (0.4, -0.7, 0.5)
DRAG = 0.3
ROTARY_DRAG = 0.15


def swing(t: float) -> Vector:
    return (0.8 * math.sin(2.3 * t), 0.5 * math.cos(1.7 * t), -0.6 * math.sin(3.1 * t + 0.4))


def magnetic(t: float) -> Vector:
    return (math.cos(2.0 * t), 0.7, math.sin(2.0 * t))


def attraction(moments: Vector, mass: float, place: Vector, orientation: Quaternion) -> tuple[Vector, Vector, float]:
    """Return the force (world), torque (principal axes) and potential of a point mass at the origin.

    U = -mu m / r - mu (tr I - 3 n.I n) / (2 r^3): the first two terms of the field of an extended body.
    """
    r, trace = norm(place), sum(moments)
    x = rotate_inverse(orientation, place)
    inertia_x = times(moments, x)
    moment = dot(x, inertia_x)
    radial = -mass / r**3 - 1.5 * trace / r**5 + 7.5 * moment / r**7
    force = scale(ATTRACTION, add_scaled(scale(radial, place), -3.0 / r**5, rotate(orientation, inertia_x)))
    torque = scale(3.0 * ATTRACTION / r**5, cross(x, inertia_x))
    return force, torque, -ATTRACTION * (mass / r + 0.5 * trace / r**3 - 1.5 * moment / r**5)


def field(body: RigidBody, drag: float = 0.0) -> LoadFrom:
    """Return a load that depends on place, time and attitude and, with `drag`, on the velocities too."""
    mass, moments = inertia_of(body)

    def load_from(phase: PhaseState) -> Load:
        start, begin = subtract(phase.center_of_mass_world, CENTER), phase.time

        def load(
            t: float, displacement: Vector, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
        ) -> tuple[Vector, Vector]:
            force, torque, _ = attraction(moments, mass, add(start, displacement), orientation)
            force = add(force, swing(begin + t))
            torque = add(torque, cross(DIPOLE, rotate_inverse(orientation, magnetic(begin + t))))
            # Drag along the body's z axis counts twice: it depends on velocity and attitude together.
            along = rotate(orientation, (0.0, 0.0, 1.0))
            force = add_scaled(force, -drag * DRAG, add_scaled(velocity, dot(along, velocity), along))
            return force, add_scaled(torque, -drag * ROTARY_DRAG * norm(angular_velocity), angular_velocity)

        return load

    return load_from


def move(name: str, load_from: LoadFrom, steps: int, held: HeldWrench | None = None) -> PhaseState:
    case = forced()
    held = in_principal_axes(case.body, case.held if held is None else held)
    start = PhaseState.of(case.body, case.initial)
    arc = Arc(METHODS[name], inertia_of(case.body), held, FixedStep(TIME / steps), 0, start, load_from)
    return arc.at(round(TIME * NANOSECONDS))


def flat(phase: PhaseState) -> dict[str, NDArray[np.float64]]:
    return {
        "place": np.array(phase.center_of_mass_world),
        "momentum": np.array(phase.linear_momentum_world),
        "rate": np.array(phase.angular_velocity),
        "work": np.array([phase.work]),
        "impulse": np.array(phase.impulse_world),
        "torque_impulse": np.array(phase.torque_impulse_world),
        "attitude": np.array(phase.orientation),
    }


def errors(phase: PhaseState, reference: dict[str, NDArray[np.float64]]) -> dict[str, float]:
    found = flat(phase)
    if found["attitude"] @ reference["attitude"] < 0.0:
        found["attitude"] = -found["attitude"]
    return {name: float(np.linalg.norm(found[name] - reference[name])) for name in found}


@cache
def by_scipy(drag: float) -> dict[str, NDArray[np.float64]]:
    """Return the end by DOP853 on (x, p, L, R as a matrix, W, J, K): everything in world axes, about the center."""
    case = forced()
    held = in_principal_axes(case.body, case.held)
    start = PhaseState.of(case.body, case.initial)
    mass, diagonal = case.body.mass, np.diag(case.body.principal_moments)
    frame = Rotation.from_quat(start.orientation).as_matrix()
    z = np.array([0.0, 0.0, 1.0])

    def slopes(t: float, y: NDArray[np.float64]) -> NDArray[np.float64]:
        x, p, spin, turn = y[:3] - CENTER, y[3:6], y[6:9], y[9:18].reshape(3, 3)
        v, inertia = p / mass, turn @ diagonal @ turn.T
        omega = np.linalg.solve(inertia, spin)
        r = math.sqrt(x @ x)
        n, axis = x / r, turn @ z
        force = turn @ held.force_body + held.force_world + swing(t)
        force = force - ATTRACTION * mass / r**2 * n
        quadrupole = (np.trace(inertia) - 5.0 * n @ inertia @ n) * n + 2.0 * inertia @ n
        force = force - 1.5 * ATTRACTION / r**4 * quadrupole
        force = force - drag * DRAG * (v + axis * (axis @ v))
        torque = turn @ held.torque_body + held.torque_world + 3.0 * ATTRACTION / r**3 * np.cross(n, inertia @ n)
        torque = torque + np.cross(turn @ DIPOLE, magnetic(t)) - drag * ROTARY_DRAG * np.linalg.norm(omega) * omega
        turning = np.cross(omega, turn, axisb=0, axisc=0)
        return np.concatenate([v, force, torque, turning.ravel(), [force @ v + torque @ omega], force, torque])

    spin = frame @ diagonal @ start.angular_velocity
    y0 = np.concatenate([start.center_of_mass_world, start.linear_momentum_world, spin, frame.ravel(), np.zeros(7)])
    y = solve_ivp(slopes, (0.0, TIME), y0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    turn = y[9:18].reshape(3, 3)
    return {
        "place": y[:3],
        "momentum": y[3:6],
        "rate": np.linalg.solve(diagonal, turn.T @ y[6:9]),
        "work": y[18:19],
        "impulse": y[19:22],
        "torque_impulse": y[22:25],
        "attitude": Rotation.from_matrix(turn).as_quat(),
    }


def orders(name: str, drag: float, counts: tuple[int, ...]) -> dict[str, float]:
    load_from, reference = field(forced().body, drag), by_scipy(drag)
    runs = [errors(move(name, load_from, n), reference) for n in counts]
    found = {}
    for quantity in runs[0]:
        values = [run[quantity] for run in runs]
        assert min(values) > 1e-12, f"{quantity}: at the floor of the reference: {values}"
        found[quantity] = slope([TIME / n for n in counts], values)
    return found


COUNTS = {2: (64, 96, 128, 192), 4: (24, 32, 48, 64), 6: (16, 20, 24, 32, 40)}


class TestOrder:
    @each
    def test_under_a_load_of_place_time_and_attitude_is_the_declared_one(self, name: str) -> None:
        declared = METHODS[name].order
        assert declared is not None

        for quantity, order in orders(name, 0.0, COUNTS[declared]).items():
            assert order == pytest.approx(declared, abs=0.2), quantity

    @each_of_any
    def test_under_drag_is_the_declared_one(self, name: str) -> None:
        declared = METHODS[name].order
        assert declared is not None

        # The work of midpoint4 changes the sign of its error between steps of 1/4 s and 1/12 s.
        counts = COUNTS[declared] if name != "midpoint4" else (64, 80, 96, 128)
        for quantity, order in orders(name, 1.0, counts).items():
            assert order == pytest.approx(declared, abs=0.2), quantity

    @pytest.mark.parametrize(
        ("name", "drag"), [("strang6", 0.0), ("dlm6", 0.0), ("midpoint6", 0.0), ("midpoint6", 1.0)]
    )
    def test_fine_runs_of_every_family_agree_with_the_reference(self, name: str, drag: float) -> None:
        found = errors(move(name, field(forced().body, drag), 200), by_scipy(drag))

        assert max(found.values()) <= 1e-12, found

    @pytest.mark.parametrize("name", ["strang6", "dlm4", "midpoint4"])
    def test_is_lost_where_the_load_forgets_the_time_inside_the_step(self, name: str) -> None:
        true = field(forced().body)

        def frozen_from(phase: PhaseState) -> Load:
            load = true(phase)
            return lambda t, displacement, v, q, omega: load(0.0, displacement, v, q, omega)

        coarse, fine = (max(errors(move(name, frozen_from, n), by_scipy(0.0)).values()) for n in (32, 64))
        assert math.log2(coarse / fine) == pytest.approx(1.0, abs=0.2)


LoadLike = Callable[..., tuple[Vector, Vector]]

INERTIA = Inertia(3.7, (1.5, 2.1, 3.1))
HELD = HeldWrench((0.9, -0.4, 0.6), (0.3, -0.2, 0.25), (-0.5, 0.8, 0.3), (0.2, 0.35, -0.3))
VELOCITY: Vector = (0.3, -0.1, 0.2)
ORIENTATION: Quaternion = (0.5, -0.1, 0.7, 0.5)
OMEGA: Vector = (0.7, -1.1, 0.9)


def phase_at(place: Vector) -> PhaseState:
    return PhaseState(ORIENTATION, OMEGA, (*place, *scale(INERTIA.mass, VELOCITY), *(0.0,) * 8), (0.0,) * 14)


def one_step(name: str, load: LoadLike | None, h: float = 0.1, held: HeldWrench = HELD) -> Increment:
    return METHODS[name].step(INERTIA, held, h, VELOCITY, ORIENTATION, OMEGA, load)


def triaxial_field(drag: float) -> Load:
    return field(RigidBody.from_diagonal(INERTIA.mass, INERTIA.moments), drag)(phase_at(ZERO))


def kinetic(velocity: Vector, omega: Vector) -> float:
    return 0.5 * (INERTIA.mass * dot(velocity, velocity) + dot(omega, times(INERTIA.moments, omega)))


@each
@pytest.mark.parametrize("h", [0.02, 0.2, -0.1])
class TestBooks:
    """Momenta and energy change by the booked amounts, for any step."""

    def test_close_to_round_off(self, name: str, h: float) -> None:
        step = one_step(name, triaxial_field(float(name in ANY)), h)
        velocity = add_scaled(VELOCITY, 1.0 / INERTIA.mass, step.impulse)

        gained = kinetic(velocity, step.angular_velocity) - kinetic(VELOCITY, OMEGA)
        before, after = (
            rotate(q, times(INERTIA.moments, w))
            for q, w in ((ORIENTATION, OMEGA), (step.orientation, step.angular_velocity))
        )
        assert norm(subtract(subtract(after, before), step.torque_impulse)) <= 100.0 * EPS
        if not name.startswith("dlm"):
            assert gained == pytest.approx(step.work, abs=100.0 * EPS)

    def test_a_step_back_leads_to_the_start(self, name: str, h: float) -> None:
        load = triaxial_field(float(name in ANY))
        there = one_step(name, load, h)

        def from_there(t: float, displacement: Vector, *state: Any) -> tuple[Vector, Vector]:
            return load(h + t, add(there.displacement, displacement), *state)

        velocity = add_scaled(VELOCITY, 1.0 / INERTIA.mass, there.impulse)
        back = METHODS[name].step(INERTIA, HELD, -h, velocity, there.orientation, there.angular_velocity, from_there)

        assert angle_between(back.orientation, ORIENTATION) <= 100.0 * EPS
        assert math.dist(back.angular_velocity, OMEGA) <= 200.0 * EPS
        assert math.dist(back.displacement, scale(-1.0, there.displacement)) <= 100.0 * EPS
        assert math.dist(back.impulse, scale(-1.0, there.impulse)) <= 100.0 * EPS
        assert back.work == pytest.approx(-there.work, abs=200.0 * EPS)


def flat_step(step: Increment) -> list[float]:
    return [
        *step.displacement,
        *step.orientation,
        *step.angular_velocity,
        *step.impulse,
        *step.torque_impulse,
        step.work,
    ]


class TestAgainstTheHeldWrench:
    @each
    def test_a_load_that_never_changes_in_the_world_is_one(self, name: str) -> None:
        def load(t: float, displacement: Vector, v: Vector, q: Quaternion, omega: Vector) -> tuple[Vector, Vector]:
            return HELD.force_world, rotate_inverse(q, HELD.torque_world)

        body_parts = HeldWrench(HELD.force_body, HELD.torque_body)
        with_load, without = one_step(name, load, 0.2, body_parts), one_step(name, None, 0.2)
        assert flat_step(with_load) == pytest.approx(flat_step(without), abs=32.0 * EPS)

    @each_of_field
    def test_a_load_that_turns_with_the_body_is_one(self, name: str) -> None:
        def load(t: float, displacement: Vector, v: Vector, q: Quaternion, omega: Vector) -> tuple[Vector, Vector]:
            return rotate(q, HELD.force_body), HELD.torque_body

        world_parts = HeldWrench(force_world=HELD.force_world, torque_world=HELD.torque_world)
        with_load, without = one_step(name, load, 0.2, world_parts), one_step(name, None, 0.2)
        assert flat_step(with_load) == pytest.approx(flat_step(without), abs=32.0 * EPS)

    @each
    def test_a_load_of_nothing_leaves_free_motion(self, name: str) -> None:
        held = HeldWrench(force_world=HELD.force_world)
        step = one_step(name, lambda *state: (ZERO, ZERO), 0.2, held)

        assert flat_step(step) == pytest.approx(flat_step(one_step(name, None, 0.2, held)), abs=32.0 * EPS)

    @each
    def test_a_load_far_below_the_momenta_is_not_lost(self, name: str) -> None:
        """Books use compensated sums, so increments below one unit in the last place of a momentum add up."""

        def load(t: float, displacement: Vector, v: Vector, q: Quaternion, omega: Vector) -> tuple[Vector, Vector]:
            return (0.0, 0.0, 1e-18), rotate_inverse(q, (0.0, 2e-18, 0.0))

        step = one_step(name, load, 0.1, HeldWrench())
        assert step.impulse == pytest.approx((0.0, 0.0, 1e-19), rel=1e-9, abs=1e-33)
        assert step.torque_impulse == pytest.approx((0.0, 2e-19, 0.0), rel=1e-9, abs=1e-33)


GRAVITY: Vector = (0.3, -0.2, -0.9)
ACCELERATION = scale(1.0 / INERTIA.mass, add(GRAVITY, HELD.force_world))


class TestStateInsideTheStep:
    """Under uniform forces, of the load and held, Strang's splitting is exact at every kick, forward and back."""

    @pytest.mark.parametrize("name", ["strang2", "strang6", "dlm2", "dlm4", "dlm6"])
    def test_of_a_kick_lies_on_the_parabola(self, name: str) -> None:
        asked: list[tuple[float, Vector, Quaternion]] = []

        def load(t: float, displacement: Vector, v: Vector, q: Quaternion, omega: Vector) -> tuple[Vector, Vector]:
            asked.append((t, displacement, q))
            return GRAVITY, ZERO

        held = HeldWrench(force_world=HELD.force_world)
        one_step(name, load, 0.4, held)

        largest = 64.0 * EPS if name.startswith("strang") else 0.02
        assert asked[-1][0] == pytest.approx(0.4, abs=2.0 * EPS)
        for t, displacement, q in asked:
            parabola = add_scaled(scale(t, VELOCITY), 0.5 * t * t, ACCELERATION)
            assert math.dist(displacement, parabola) <= 2.0 * EPS
            assert angle_between(q, one_step("exact", None, t, held).orientation) <= largest

    def test_of_the_midpoint_rule_is_the_middle_of_the_step(self) -> None:
        asked: list[tuple[float, Vector, Vector, Quaternion, Vector]] = []

        def load(t: float, displacement: Vector, v: Vector, q: Quaternion, omega: Vector) -> tuple[Vector, Vector]:
            asked.append((t, displacement, v, q, omega))
            return GRAVITY, scale(-0.3, omega)

        h = 0.4
        step = one_step("midpoint", load, h, HeldWrench(force_world=HELD.force_world))

        t, displacement, v, q, omega = asked[-1]
        turn = multiply(conjugate(ORIENTATION), step.orientation)
        half = multiply(conjugate(ORIENTATION), q)
        assert t == 0.5 * h
        assert math.dist(displacement, scale(0.5, step.displacement)) <= EPS
        assert math.dist(v, add_scaled(VELOCITY, 0.5 * h, ACCELERATION)) <= 2.0 * EPS
        assert angle_between(multiply(half, half), turn) <= 8.0 * EPS
        assert math.dist(omega, scale(0.5, add(OMEGA, step.angular_velocity))) <= 4.0 * EPS


ORBITER = RigidBody.from_diagonal(1.0, (0.002, 0.003, 0.004))


@cache
def orbit(name: str, h: float, steps: int) -> list[float]:
    """Return T + U at each tenth step of a triaxial body that tumbles along an orbit of eccentricity 0.3."""
    inertia, held = inertia_of(ORBITER), HeldWrench()
    place, velocity, q, omega = (1.0, 0.0, 0.0), (0.0, 1.14 * math.sqrt(ATTRACTION), 0.2), ORIENTATION, OMEGA
    found = []
    for k in range(steps):

        def load(
            t: float, displacement: Vector, v: Vector, orientation: Quaternion, w: Vector, start: Vector = place
        ) -> tuple[Vector, Vector]:
            return attraction(inertia.moments, inertia.mass, add(start, displacement), orientation)[:2]

        if k % 10 == 0:
            kinetic_energy = 0.5 * (dot(velocity, velocity) + dot(omega, times(inertia.moments, omega)))
            found.append(kinetic_energy + attraction(inertia.moments, inertia.mass, place, q)[2])
        step = METHODS[name].step(inertia, held, h, velocity, q, omega, load)
        place, velocity = add(place, step.displacement), add(velocity, step.impulse)
        q, omega = step.orientation, step.angular_velocity
    return found


def drift(name: str) -> tuple[float, float]:
    """Return how far the mean energy of the last of 10 parts of 1e4 steps is from the first, and the spread in one."""
    found = orbit(name, 0.05, 10_000)
    part = len(found) // 10
    first, last = found[:part], found[-part:]
    return abs(math.fsum(last) - math.fsum(first)) / part, max(last) - min(last)


class TestEnergyOfALongOrbit:
    """100 revolutions in 1e4 steps: the error of a symplectic method swings with each, that of another one grows."""

    @pytest.mark.parametrize(
        "name",
        [
            "strang2",
            "dlm2",
            pytest.param("dlm4", marks=pytest.mark.slow),
            pytest.param("strang6", marks=pytest.mark.slow),
            pytest.param("dmv82", marks=pytest.mark.slow),
            pytest.param("midpoint", marks=pytest.mark.slow),
        ],
    )
    def test_swings_and_does_not_drift(self, name: str) -> None:
        moved, spread = drift(name)

        assert moved <= 0.1 * spread

    def test_drifts_with_a_method_that_is_not_symplectic(self) -> None:
        moved, spread = drift("rk4")

        assert moved >= 5.0 * spread


class TestWhatIsTaken:
    @pytest.mark.parametrize(
        ("names", "kind"),
        [(FIELD, LoadDependence.FIELD), (ANY, LoadDependence.ANY), (["exact", "taylor"], LoadDependence.HELD)],
    )
    def test_is_declared(self, names: list[str], kind: LoadDependence) -> None:
        assert {METHODS[name].takes for name in names} == {kind}

    @pytest.mark.parametrize("name", ["exact", "taylor"])
    def test_by_a_method_for_held_wrenches_is_no_load(self, name: str) -> None:
        with pytest.raises(ConvergenceError, match=rf"{name}: a load that changes .* use "):
            one_step(name, lambda *state: (ZERO, ZERO), held=HeldWrench())


def stiff(t: float, displacement: Vector, v: Vector, q: Quaternion, omega: Vector) -> tuple[Vector, Vector]:
    return scale(-300.0, v), scale(-200.0 * norm(omega), omega)


class TestLimits:
    """If the iteration for load and motion does not converge, the error of the midpoint rule names a smaller step."""

    @pytest.mark.parametrize("h", [1.0, -0.4])
    def test_a_step_that_is_too_long_leads_to_one_that_is_not(self, h: float) -> None:
        with pytest.raises(ConvergenceError):
            one_step("midpoint", stiff, h)
        for _ in range(6):
            try:
                one_step("midpoint", stiff, h)
                return
            except ConvergenceError as error:
                message = str(error)
            told = re.fullmatch(
                r"midpoint: the iteration .* does not converge .* expected less than .*; use a step below (\S+) s",
                message,
            )
            assert told, message
            h = math.copysign(float(told[1]), h)
        pytest.fail(f"still too long: {h} s")

    def test_a_stage_that_fails_names_the_method(self) -> None:
        with pytest.raises(ConvergenceError, match=r"midpoint4: a stage of .* s failed: midpoint: "):
            one_step("midpoint4", stiff, 1.0)

    @each
    @pytest.mark.parametrize("value", [math.nan, math.inf])
    def test_a_load_that_is_no_number_is_an_error(self, name: str, value: float) -> None:
        """Also at the end of the step, where it does not affect the rotation."""

        def load(t: float, *state: Any) -> tuple[Vector, Vector]:
            return (value if t > 0.05 or name in ANY else 0.0, 0.0, 0.0), ZERO

        with pytest.raises(ConvergenceError, match=rf"{name}: .* expected"):
            one_step(name, load)

    @each_of_field
    def test_turns_that_the_kicks_would_miss_are_an_error_without_torque_too(self, name: str) -> None:
        with pytest.raises(ConvergenceError, match=rf"{name}: a step of .* rad between two kicks.*use a step below"):
            one_step(name, lambda *state: (GRAVITY, ZERO), 50.0, HeldWrench())
