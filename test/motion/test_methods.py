"""Every registered method: its declarations, and properties of any integrator of a rigid body."""

from __future__ import annotations

import itertools
import math
import re

import pytest
from motions import EPS, STEPPED, Case, attitude_error, errors, forced, move, slope

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, REMOVED, Increment, Inertia, Method, midpoint, rkmk
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector, add, cross, divide, dot, multiply, norm, scale, subtract
from rb_dynamics.scene.model import Solver

INERTIA = Inertia(3.7, (1.5, 2.1, 3.1))
HELD = HeldWrench((0.9, -0.4, 0.6), (0.3, -0.2, 0.25), (-0.5, 0.8, 0.3), (0.2, 0.35, -0.3))
VELOCITY: Vector = (0.3, -0.1, 0.2)
ORIENTATION: Quaternion = (0.5, -0.1, 0.7, 0.5)
OMEGA: Vector = (0.7, -1.1, 0.9)

each_method = pytest.mark.parametrize("method", METHODS.values(), ids=list(METHODS))
each_stepped = pytest.mark.parametrize("method", STEPPED.values(), ids=list(STEPPED))


def one_step(method: Method, h: float = 0.1, **changed: object) -> Increment:
    arguments = {
        "inertia": INERTIA,
        "held": HELD,
        "velocity": VELOCITY,
        "orientation": ORIENTATION,
        "angular_velocity": OMEGA,
        **changed,
    }
    return method.step(h=h, **arguments)  # type: ignore[arg-type]


def flat(step: Increment) -> tuple[float, ...]:
    return tuple(itertools.chain(*step[:5], step[5:]))


class TestRegistry:
    def test_names_are_unique_and_keys(self) -> None:
        names = [method.name for method in METHODS.values()]

        assert names == list(METHODS)
        assert len(set(names)) == len(names)
        assert all(re.fullmatch(r"[a-z][a-z0-9]*", name) for name in names)

    def test_cannot_be_changed(self) -> None:
        with pytest.raises(TypeError):
            METHODS["other"] = METHODS["rk4"]  # type: ignore[index]

    @each_method
    def test_docstring_says_order_and_source(self, method: Method) -> None:
        text = " ".join((method.step.__doc__ or "").split())

        assert (f"Order {method.order}" if method.order else "No order") in text
        assert re.search(r"HLW|IMNZ|HNW|Hairer|\d+ \(\d{4}\)", text), "no source"

    @each_method
    def test_invariants_are_of_the_known_ones(self, method: Method) -> None:
        assert method.invariants <= {"energy", "angular_momentum", "unit_quaternion"}
        assert "unit_quaternion" in method.invariants

    def test_what_was_removed_has_a_successor(self) -> None:
        for name, take in REMOVED.items():
            assert name not in METHODS
            assert set(re.findall(r"[a-z]+\d+", take)) <= set(METHODS)
            with pytest.raises(SceneError, match=f"; {name} was removed; take {take}"):
                Solver(name)

    def test_the_least_are_there(self) -> None:
        assert {"rkmk4": 4, "midpoint": 2, "rk4": 4}.items() <= {m.name: m.order for m in METHODS.values()}.items()


@each_stepped
class TestStep:
    def test_is_a_pure_function_of_plain_floats(self, method: Method) -> None:
        first, second = one_step(method), one_step(method)

        assert first == second
        assert all(type(value) is float for value in flat(first))

    def test_no_time_no_change(self, method: Method) -> None:
        step = one_step(method, h=0.0)

        assert math.dist(step.orientation, ORIENTATION) <= EPS
        assert math.dist(step.angular_velocity, OMEGA) <= 4.0 * EPS
        assert step.displacement == step.impulse == step.torque_impulse == ZERO
        assert step.work == 0.0

    def test_slope_at_zero_is_the_equation_of_motion(self, method: Method) -> None:
        """First order in h, by a central difference: the steps of +h and -h differ by 2 h times the right hand side."""
        h = 1e-5
        ahead, back = one_step(method, h), one_step(method, -h)

        def rate(name: str) -> Vector:
            return scale(0.5 / h, subtract(getattr(ahead, name), getattr(back, name)))

        spin = multiply(INERTIA.moments, OMEGA)
        torque = add(HELD.torque_body, rotation.rotate_inverse(ORIENTATION, HELD.torque_world))
        force = add(rotation.rotate(ORIENTATION, HELD.force_body), HELD.force_world)
        turn = rotation.log(rotation.multiply(rotation.conjugate(back.orientation), ahead.orientation))
        assert math.dist(rate("displacement"), VELOCITY) < 1e-9
        assert math.dist(scale(0.5 / h, turn), OMEGA) < 1e-9
        acceleration = divide(add(torque, cross(spin, OMEGA)), INERTIA.moments)
        assert math.dist(rate("angular_velocity"), acceleration) < 1e-9
        assert math.dist(rate("impulse"), force) < 1e-9
        assert math.dist(rate("torque_impulse"), rotation.rotate(ORIENTATION, torque)) < 1e-9
        assert (ahead.work - back.work) / (2.0 * h) == pytest.approx(
            dot(force, VELOCITY) + dot(torque, OMEGA), rel=1e-9
        )

    def test_world_axes_do_not_matter(self, method: Method) -> None:
        """If the world axes are rotated, world vectors rotate with them and body vectors stay."""
        turn = rotation.normalize((0.3, -0.6, 0.2, 0.7))

        def turned(v: Vector) -> Vector:
            return rotation.rotate(turn, v)

        held = HeldWrench(HELD.force_body, HELD.torque_body, turned(HELD.force_world), turned(HELD.torque_world))
        here = one_step(method)
        there = one_step(method, held=held, velocity=turned(VELOCITY), orientation=rotation.multiply(turn, ORIENTATION))

        assert math.dist(there.angular_velocity, here.angular_velocity) <= 16.0 * EPS * norm(OMEGA)
        assert math.dist(there.orientation, rotation.multiply(turn, here.orientation)) <= 8.0 * EPS
        for name in ("displacement", "impulse", "torque_impulse"):
            assert math.dist(getattr(there, name), turned(getattr(here, name))) <= 16.0 * EPS
        assert there.work == pytest.approx(here.work, abs=16.0 * EPS)

    def test_names_of_the_axes_do_not_matter(self, method: Method) -> None:
        """Renaming the principal axes cyclically reveals an error in one component of a formula."""

        def renamed(v: Vector) -> Vector:
            return (v[1], v[2], v[0])

        # The turn that takes the new axes to the old ones: new x is old y.
        cycle: Quaternion = (0.5, 0.5, 0.5, 0.5)
        assert rotation.rotate(cycle, (1.0, 0.0, 0.0)) == (0.0, 1.0, 0.0)
        held = HeldWrench(renamed(HELD.force_body), renamed(HELD.torque_body), HELD.force_world, HELD.torque_world)
        here = one_step(method)
        there = one_step(
            method,
            inertia=Inertia(INERTIA.mass, renamed(INERTIA.moments)),
            held=held,
            orientation=rotation.multiply(ORIENTATION, cycle),
            angular_velocity=renamed(OMEGA),
        )

        assert math.dist(there.angular_velocity, renamed(here.angular_velocity)) <= 16.0 * EPS * norm(OMEGA)
        assert math.dist(there.orientation, rotation.multiply(here.orientation, cycle)) <= 8.0 * EPS
        for name in ("displacement", "impulse", "torque_impulse"):
            assert math.dist(getattr(there, name), getattr(here, name)) <= 16.0 * EPS

    def test_velocity_of_the_observer_does_not_matter(self, method: Method) -> None:
        """Galilean invariance: a boost changes only displacement and work, by the right amounts."""
        boost: Vector = (4.0, -8.0, 16.0)
        here, there = one_step(method), one_step(method, velocity=add(VELOCITY, boost))

        assert there.orientation == here.orientation
        assert there.angular_velocity == here.angular_velocity
        assert math.dist(there.displacement, add(here.displacement, scale(0.1, boost))) <= 8.0 * EPS * norm(boost)
        assert there.work == pytest.approx(here.work + dot(here.impulse, boost), abs=64.0 * EPS * norm(boost))

    def test_force_does_not_turn_and_torque_does_not_push(self, method: Method) -> None:
        with_force = one_step(method)
        without = one_step(method, held=HeldWrench(torque_body=HELD.torque_body, torque_world=HELD.torque_world))

        assert without.orientation == with_force.orientation
        assert without.angular_velocity == with_force.angular_velocity
        assert without.impulse == ZERO
        assert math.dist(without.displacement, scale(0.1, VELOCITY)) <= 2.0 * EPS

    @pytest.mark.parametrize("h", [1e-9, 0.1, 7.0, 1e9])
    def test_a_body_at_rest_falls_exactly_like_a_particle(self, method: Method, h: float) -> None:
        held = HeldWrench(force_world=HELD.force_world, force_body=HELD.force_body)
        step = one_step(method, h, held=held, angular_velocity=ZERO)

        if method.order == 1:  # moves with the velocity at the end: the parabola needs order 2
            assert method.name == "euler"
            return
        force = add(HELD.force_world, rotation.rotate(ORIENTATION, HELD.force_body))
        fall = add(scale(h, VELOCITY), scale(0.5 * h * h / INERTIA.mass, force))
        assert step.angular_velocity == ZERO
        assert math.dist(step.orientation, ORIENTATION) <= EPS
        assert math.dist(step.displacement, fall) <= 16.0 * EPS * (h * norm(VELOCITY) + 0.5 * h * h * norm(force))
        assert math.dist(step.impulse, scale(h, force)) <= 8.0 * EPS * h * norm(force)


@each_method
class TestFreeStep:
    @pytest.mark.parametrize("axis", [0, 1, 2])
    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_spin_about_a_principal_axis_stays_there_to_the_bit(self, method: Method, axis: int, sign: float) -> None:
        spin = [0.0, 0.0, 0.0]
        spin[axis] = sign * 0.7
        omega, orientation = (spin[0], spin[1], spin[2]), ORIENTATION
        for _ in range(100):
            step = one_step(method, 0.05, held=HeldWrench(), angular_velocity=omega, orientation=orientation)
            omega, orientation = step.angular_velocity, step.orientation
            assert [w for i, w in enumerate(omega) if i != axis] == [0.0, 0.0]
        assert omega[axis] == pytest.approx(spin[axis], rel=100.0 * EPS)
        # The axis has not moved in the world either.
        unit = tuple(float(i == axis) for i in range(3))
        before, after = rotation.rotate(ORIENTATION, unit), rotation.rotate(orientation, unit)
        assert math.dist(before, after) <= 200.0 * EPS

    def test_a_sphere_turns_about_a_fixed_axis(self, method: Method) -> None:
        spin, omega, orientation = (0.15, -0.25, 0.2), (0.15, -0.25, 0.2), ORIENTATION
        sphere = Inertia(1.0, (2.0, 2.0, 2.0))
        for _ in range(50):
            step = one_step(
                method, 0.02, inertia=sphere, held=HeldWrench(), angular_velocity=omega, orientation=orientation
            )
            omega, orientation = step.angular_velocity, step.orientation

        assert math.dist(omega, spin) <= 100.0 * EPS
        turned = rotation.multiply(ORIENTATION, rotation.exp(spin))
        # The angle of a step is wrong by (h |w|)^3 / 12 at most, in 50 steps.
        assert rotation.angle_between(orientation, turned) <= 50.0 * (0.02 * norm(spin)) ** 3 / 12.0

    def test_steps_add_up(self, method: Method) -> None:
        """Two steps equal one: exactly for a closed form, to the error of its order for other methods."""
        whole = one_step(method, 0.2, held=HeldWrench())
        first = one_step(method, 0.05, held=HeldWrench())
        second = one_step(
            method, 0.15, held=HeldWrench(), orientation=first.orientation, angular_velocity=first.angular_velocity
        )

        tolerance = 16.0 * EPS if method.order is None else 0.5 ** (method.order + 1)
        assert math.dist(second.orientation, whole.orientation) <= tolerance
        assert math.dist(second.angular_velocity, whole.angular_velocity) <= tolerance

    def test_makes_no_work_and_no_impulse(self, method: Method) -> None:
        step = one_step(method, 0.2, held=HeldWrench())

        assert step.impulse == step.torque_impulse == ZERO
        assert step.work == 0.0
        assert math.dist(step.displacement, scale(0.2, VELOCITY)) <= 2.0 * EPS


class TestMidpoint:
    """Properties its docstring claims beyond order 2."""

    @pytest.mark.parametrize("h", [0.01, 0.2, 0.5])
    def test_is_symmetric(self, h: float) -> None:
        """The step back from the end leads to the start, to round-off."""
        method = METHODS["midpoint"]
        there = one_step(method, h)
        velocity = add(VELOCITY, scale(1.0 / INERTIA.mass, there.impulse))
        back = one_step(
            method, -h, velocity=velocity, orientation=there.orientation, angular_velocity=there.angular_velocity
        )

        assert math.dist(back.orientation, ORIENTATION) <= 16.0 * EPS
        assert math.dist(back.angular_velocity, OMEGA) <= 64.0 * EPS * norm(OMEGA)
        assert math.dist(back.displacement, scale(-1.0, there.displacement)) <= 32.0 * EPS
        assert math.dist(back.torque_impulse, scale(-1.0, there.torque_impulse)) <= 32.0 * EPS
        assert back.work == pytest.approx(-there.work, abs=32.0 * EPS)

    @pytest.mark.parametrize("h", [0.01, 0.2, 0.5])
    def test_energy_changes_by_the_booked_work_exactly(self, h: float) -> None:
        step = one_step(METHODS["midpoint"], h)
        velocity = add(VELOCITY, scale(1.0 / INERTIA.mass, step.impulse))

        def energy(v: Vector, w: Vector) -> float:
            return 0.5 * (INERTIA.mass * dot(v, v) + dot(w, multiply(INERTIA.moments, w)))

        gained = energy(velocity, step.angular_velocity) - energy(VELOCITY, OMEGA)
        assert gained == pytest.approx(step.work, abs=32.0 * EPS * energy(VELOCITY, OMEGA))

    @pytest.mark.parametrize("h", [0.01, 0.2, 0.5])
    def test_solves_its_own_equations(self, h: float) -> None:
        """R1 = R0 cay(h w) with w the angular velocity of the mean momentum, computed from the result alone."""
        held = HeldWrench(torque_body=HELD.torque_body)
        step = one_step(METHODS["midpoint"], h, held=held)
        w = scale(0.5, add(OMEGA, step.angular_velocity))

        turn = rotation.multiply(rotation.conjugate(ORIENTATION), step.orientation)
        assert math.dist(turn, rotation.cayley(scale(h, w))) <= 16.0 * EPS


def failing_part(case: Case, method: Method, time: float, steps: tuple[int, ...]) -> float:
    """Return the measured order of the attitude."""
    sizes = [time / n for n in steps]
    return slope(sizes, [errors(case, time, move(case, method, h, time))["attitude"] for h in sizes])


class TestMutations:
    """Parts of the methods that a careless change could drop are needed: without them these tests fail."""

    @pytest.fixture(autouse=True)
    def _plain(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Forbid compilation, since a compiled kernel would not see the changes."""
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")

    def test_rkmk4_without_dexpinv_is_of_order_2(self, monkeypatch: pytest.MonkeyPatch) -> None:
        method, steps = METHODS["rkmk4"], (32, 64, 128, 256)
        assert failing_part(forced(), method, 1, steps) == pytest.approx(4.0, abs=0.2)

        monkeypatch.setattr(rkmk, "dexpinv", lambda _, u: u)

        assert failing_part(forced(), method, 1, steps) == pytest.approx(2.0, abs=0.2)

    def test_rkmk4_with_dexpinv_of_the_other_side_loses_its_order(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(rkmk, "dexpinv", lambda v, u: rotation.dexpinv(scale(-1.0, v), u))

        assert failing_part(forced(), METHODS["rkmk4"], 1, (32, 64, 128, 256)) < 2.2

    def test_midpoint_with_exp_for_cayley_loses_the_energy(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """With the exponential it is still of order 2 and keeps the angular momentum, but not the energy."""
        body = RigidBody.from_diagonal(1.0, (1.0, 2.0, 3.0))
        case = Case(body, State(angular_velocity_body=(0.1, 2.0, 0.1)), HeldWrench(), {})

        def drift() -> float:
            phase = move(case, METHODS["midpoint"], 0.05, 20.0)
            w = phase.angular_velocity
            return abs(dot(w, multiply(body.principal_moments, w)) / (0.01 + 8.0 + 0.03) - 1.0)

        assert drift() < 1e-13
        monkeypatch.setattr(midpoint, "cayley", rotation.exp)
        assert drift() > 1e-6


def test_momentum_and_velocity_are_those_of_the_principal_axes() -> None:
    """`PhaseState.of`: L = I w, and the center of mass moves with v + w x c; against body axes."""
    case = forced()
    phase = PhaseState.of(case.body, case.initial)
    w, c = case.initial.angular_velocity_body, case.body.center_of_mass

    in_body = tuple(math.fsum(row[i] * w[i] for i in range(3)) for row in case.body.inertia)
    world = rotation.rotate(case.initial.orientation_xyzw, in_body)
    assert math.dist(phase.angular_momentum_world(case.body), world) <= 16.0 * EPS * norm(world)
    velocity = add(case.initial.linear_velocity_world, rotation.rotate(case.initial.orientation_xyzw, cross(w, c)))
    assert math.dist(phase.linear_momentum_world, scale(case.body.mass, velocity)) <= 16.0 * EPS
    assert (
        math.dist(
            phase.center_of_mass_world,
            add(case.initial.position_world, rotation.rotate(case.initial.orientation_xyzw, c)),
        )
        <= 4.0 * EPS
    )
    state = phase.state(case.body, 5)
    assert state.time_ns == 5
    assert attitude_error(state.orientation_xyzw, map(repr, case.initial.orientation_xyzw)) <= 4.0 * EPS
    for name in ("position_world", "linear_velocity_world", "angular_velocity_body"):
        assert math.dist(getattr(state, name), getattr(case.initial, name)) <= 8.0 * EPS
