"""Runge-Kutta methods under a load that depends on everything: order, books, pairs, stiffness and refusals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from motions import EPS, slope
from scipy.integrate import DOP853, solve_ivp

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Increment, Inertia, Method, dop853, radau, rkmk
from rb_dynamics.motion.method import Load, LoadDependence
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, cross, dot, multiply, norm, scale, subtract

NAMES = ["rk4", "rkmk4", "cf4", "rkmk54", "dverk", "dop853", "radau", "euler"]
each_method = pytest.mark.parametrize("method", [METHODS[name] for name in NAMES], ids=NAMES)

INERTIA = Inertia(1.7, (1.1, 2.3, 2.9))
HELD = HeldWrench((0.9, -0.4, 0.6), (0.3, -0.2, 0.25), (-0.5, 0.8, 0.3), (0.2, 0.35, -0.3))
# For each method the time, and numbers of steps whose errors the leading term rules, far above round-off.
SCALES = {
    "rk4": (1.0, (24, 32, 48, 64)),
    "rkmk4": (1.0, (24, 32, 48, 64)),
    "cf4": (1.0, (24, 32, 48, 64)),
    "rkmk54": (4.0, (128, 192, 256, 384)),
    "dverk": (2.8, (64, 80, 96, 128)),
    "dop853": (1.5, (6, 8, 10, 12)),
    "radau": (2.0, (16, 24, 32, 48)),
    "euler": (1.0, (64, 96, 128, 192)),
}

# The load: a spring, drag, a magnetic force, a thrust that turns with the body, and what these do to its attitude.
SPRING, DRAG, FIELD, THRUST = 0.5, 0.3, (0.2, -0.1, 0.4), (0.5, 0.2, -0.7)
SPIN_DRAG, ROTOR, UP, ARM = 0.4, (0.3, 0.5, -0.2), (0.3, -0.4, 0.6), (0.2, 0.1, -0.3)


class Motion(NamedTuple):
    """State of a body with its books, in world axes except the angular velocity."""

    position: Vector = (0.4, -0.3, 0.2)
    velocity: Vector = (0.7, 0.5, -0.6)
    orientation: Quaternion = (0.5, -0.1, 0.7, 0.5)
    angular_velocity: Vector = (0.7, -1.1, 0.9)
    impulse: Vector = ZERO
    torque_impulse: Vector = ZERO
    work: float = 0.0
    time: float = 0.0

    def after(self, step: Increment, h: float) -> Motion:
        return Motion(
            add(self.position, step.displacement),
            add_scaled(self.velocity, 1.0 / INERTIA.mass, step.impulse),
            step.orientation,
            step.angular_velocity,
            add(self.impulse, step.impulse),
            add(self.torque_impulse, step.torque_impulse),
            self.work + step.work,
            self.time + h,
        )

    @property
    def load(self) -> Load:
        """The load for a step from here."""

        def at(t: float, displacement: Vector, v: Vector, q: Quaternion, w: Vector) -> tuple[Vector, Vector]:
            time, x = self.time + t, add(self.position, displacement)
            force = add(scale(-SPRING, x), add_scaled(cross(v, FIELD), -DRAG, v))
            force = add_scaled(force, math.cos(1.3 * time), rotation.rotate(q, THRUST))
            torque = add_scaled(cross(ROTOR, w), -SPIN_DRAG, w)
            torque = add_scaled(torque, math.sin(1.7 * time), rotation.rotate_inverse(q, UP))
            return force, add(torque, cross(ARM, rotation.rotate_inverse(q, add(x, v))))

        return at

    def quantities(self) -> dict[str, np.ndarray]:
        parts = zip(self._fields[:-1], self[:-1], strict=True)
        found = {name: np.atleast_1d(value) for name, value in parts if name != "orientation"}
        return {**found, "orientation": np.array(rotation.matrix(self.orientation)).ravel()}


def run(step: Callable[..., Increment], time: float, count: int) -> Motion:
    motion, h = Motion(), time / count
    for _ in range(count):
        motion = motion.after(
            step(INERTIA, HELD, h, motion.velocity, motion.orientation, motion.angular_velocity, motion.load), h
        )
    return motion


def differences(found: Motion, expected: dict[str, np.ndarray]) -> dict[str, float]:
    return {name: float(np.linalg.norm(value - expected[name])) for name, value in found.quantities().items()}


@cache
def reference(time: float) -> dict[str, np.ndarray]:
    return run(METHODS["dop853"].step, time, round(64 * time)).quantities()


@cache
def other_reference() -> dict[float, dict[str, np.ndarray]]:
    """Newton's and Euler's equations by scipy, the attitude a matrix: nothing of the package but the numbers."""
    moments = np.array(INERTIA.moments)
    start, times = Motion(), sorted({time for time, _ in SCALES.values()})

    def slopes(t: float, y: np.ndarray) -> np.ndarray:
        x, v, w, R = y[0:3], y[3:6], y[6:9], y[9:18].reshape(3, 3)
        force = R @ HELD.force_body + HELD.force_world + R @ THRUST * np.cos(1.3 * t)
        force = force - SPRING * x - DRAG * v + np.cross(v, FIELD)
        torque = HELD.torque_body + R.T @ HELD.torque_world + R.T @ UP * np.sin(1.7 * t)
        torque = torque - SPIN_DRAG * w + np.cross(ROTOR, w) + np.cross(ARM, R.T @ (x + v))
        turning = R @ np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
        spin = (torque - np.cross(w, moments * w)) / moments
        power = force @ v + torque @ w
        return np.concatenate([v, force / INERTIA.mass, spin, turning.ravel(), force, R @ torque, [power]])

    x, y, z, w = start.orientation
    u = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R = np.eye(3) + 2.0 * w * u + 2.0 * u @ u
    y0 = np.concatenate([start.position, start.velocity, start.angular_velocity, R.ravel(), np.zeros(7)])
    solution = solve_ivp(slopes, (0.0, times[-1]), y0, method="DOP853", t_eval=times, rtol=1e-13, atol=1e-14)
    names = ("position", "velocity", "angular_velocity", "orientation", "impulse", "torque_impulse", "work")
    ends = (np.split(column, [3, 6, 9, 18, 21, 24]) for column in solution.y.T)
    return {time: dict(zip(names, end, strict=True)) for time, end in zip(times, ends, strict=True)}


def orders(step: Callable[..., Increment], time: float, counts: tuple[int, ...]) -> dict[str, float]:
    """Return the measured order of each quantity."""
    found = [differences(run(step, time, count), reference(time)) for count in counts]
    sizes = [time / count for count in counts]
    return {name: slope(sizes, [values[name] for values in found]) for name in found[0]}


class TestUnderALoad:
    """The load depends on time, position, attitude and both velocities; held wrenches of all four kinds act too."""

    @pytest.mark.parametrize("time", sorted({time for time, _ in SCALES.values()}))
    def test_reference_is_that_of_scipy(self, time: float) -> None:
        """Its dense output at the times between is good to less than its steps."""
        last = max(time for time, _ in SCALES.values())
        for name, value in reference(time).items():
            error = np.abs(value - other_reference()[time][name]).max()
            assert error <= (1e-12 if time == last else 1e-11), name

    @each_method
    def test_order_is_the_declared_one(self, method: Method) -> None:
        for quantity, order in orders(method.step, *SCALES[method.name]).items():
            assert order >= method.order - 0.2, quantity
            # The leading term of a number alone may be small by chance, so that its error falls faster for a while.
            assert quantity == "work" or order <= method.order + 0.2, quantity

    @each_method
    def test_work_is_of_the_declared_order_over_several_ends(self, method: Method) -> None:
        """One of the values may be near a sign change of the error."""
        time, counts = SCALES[method.name]
        errors = []
        for count in counts:
            ends = [(0.5 * time, count), (0.75 * time, 3 * count // 2), (time, 2 * count)]
            errors.append(math.hypot(*(differences(run(method.step, t, n), reference(t))["work"] for t, n in ends)))

        assert slope([1.0 / count for count in counts], errors) == pytest.approx(method.order, abs=0.5)

    @each_method
    def test_books_close_as_they_do_without(self, method: Method) -> None:
        """The momentum gained is the impulse booked; where angular momentum is kept, so is the torque impulse."""
        start, end = Motion(), run(method.step, 1.0, 4)

        def momentum(motion: Motion) -> Vector:
            return rotation.rotate(motion.orientation, multiply(INERTIA.moments, motion.angular_velocity))

        defect = norm(subtract(subtract(momentum(end), momentum(start)), end.torque_impulse))
        if "angular_momentum" in method.invariants:
            assert defect <= 100.0 * EPS
        else:
            assert defect > 1e-13
        assert norm(subtract(scale(INERTIA.mass, subtract(end.velocity, start.velocity)), end.impulse)) <= 100.0 * EPS

    @each_method
    def test_a_constant_load_is_a_held_wrench(self, method: Method) -> None:
        """In world axes the force, in body axes the torque, at every stage."""
        push, twist = (0.3, -0.8, 0.5), (0.2, 0.4, -0.1)
        start = ((0.3, -0.1, 0.2), (0.5, -0.1, 0.7, 0.5), (0.7, -1.1, 0.9))

        loaded = method.step(INERTIA, HELD, 0.1, *start, lambda *_: (push, twist))

        held = method.step(INERTIA, HELD + HeldWrench(force_world=push, torque_body=twist), 0.1, *start)
        for found, expected in zip(loaded[:5], held[:5], strict=True):
            assert math.dist(found, expected) <= 16.0 * EPS
        # A held wrench works by its impulse and the mean velocity, a load by the quadrature.
        by_mean_velocity = method.name in ("dverk", "dop853")
        assert loaded.work == pytest.approx(held.work, abs=1e-9 if by_mean_velocity else 16.0 * EPS)

    @each_method
    def test_no_load_is_no_load(self, method: Method) -> None:
        start = ((0.3, -0.1, 0.2), (0.5, -0.1, 0.7, 0.5), (0.7, -1.1, 0.9))

        loaded = method.step(INERTIA, HELD, 0.1, *start, lambda *_: (ZERO, ZERO))

        for found, expected in zip(loaded[:5], method.step(INERTIA, HELD, 0.1, *start)[:5], strict=True):
            assert math.dist(found, expected) <= 8.0 * EPS

    @each_method
    def test_is_declared(self, method: Method) -> None:
        expected = LoadDependence.STATES if method.name in ("dverk", "dop853") else LoadDependence.ANY
        assert method.takes is expected
        assert (method.pair is None) == (method.name not in ("rkmk54", "dverk", "dop853"))


class TestTableaus:
    @pytest.mark.parametrize("tableau", [rkmk.CLASSICAL, rkmk.DORMAND_PRINCE], ids=["classical", "dormand_prince"])
    def test_rows_sum_to_the_nodes(self, tableau: rkmk.Tableau) -> None:
        for row, node in zip(tableau.stages, tableau.nodes, strict=True):
            assert math.fsum(row) == pytest.approx(node, abs=8.0 * EPS)

    @pytest.mark.parametrize(
        ("weights", "tableau", "order"),
        [
            (rkmk.CLASSICAL.weights, rkmk.CLASSICAL, 4),
            (rkmk.DORMAND_PRINCE.weights, rkmk.DORMAND_PRINCE, 5),
            (rkmk.DORMAND_PRINCE.comparison, rkmk.DORMAND_PRINCE, 4),
        ],
        ids=["classical", "dormand_prince", "comparison"],
    )
    def test_integrate_powers_once_and_twice(
        self, weights: tuple[float, ...], tableau: rkmk.Tableau, order: int
    ) -> None:
        for k in range(order):
            once = math.fsum(weight * tableau.nodes[j] ** k for j, weight in enumerate(weights))
            assert once == pytest.approx(1.0 / (k + 1.0), abs=8.0 * EPS)
            if k < order - 1:
                twice = math.fsum(weight * tableau.nodes[j] ** k for j, weight in enumerate(tableau.second(weights)))
                assert twice == pytest.approx(1.0 / ((k + 1.0) * (k + 2.0)), abs=8.0 * EPS)

    def test_last_stage_of_dormand_prince_is_its_end(self) -> None:
        assert rkmk.DORMAND_PRINCE.stages[-1] == rkmk.DORMAND_PRINCE.weights

    def test_dop853_has_the_coefficients_of_scipy(self) -> None:
        """Each row without zeros; the measured order shows that they belong to the right slopes."""
        rows = [getattr(dop853, f"_ROW_{stage}") for stage in range(2, 13)]
        found = [dop853.NODES[1:], *rows, dop853._WEIGHTS, dop853._FIFTH, dop853._THIRD]
        expected = [DOP853.C, *DOP853.A[1:], DOP853.B, DOP853.E5, DOP853.E3]

        assert [list(row) for row in found] == [[a for a in row.tolist() if a] for row in expected]

    def test_a_held_force_moves_a_body_by_the_rows_of_dverk_and_dop853(self) -> None:
        """Without a load the displacement is by D(1), with one by the rows: the same but for rounding."""
        start, h = Motion(), 0.3
        at = (start.velocity, start.orientation, start.angular_velocity)
        for name in ("dverk", "dop853"):
            step = METHODS[name].step
            found, expected = step(INERTIA, HELD, h, *at), step(INERTIA, HELD, h, *at, lambda *_: (ZERO, ZERO))
            assert math.dist(found.displacement, expected.displacement) <= 4.0 * EPS
            # The work by the mean velocity, and by the quadrature of the method.
            assert found.work == pytest.approx(expected.work, rel=1e-6)

    def test_radau_is_collocation_at_its_nodes(self) -> None:
        for row, node in zip(radau._A, radau._NODES, strict=True):
            for k in range(3):
                integral = math.fsum(a * c**k for a, c in zip(row, radau._NODES, strict=True))
                assert integral == pytest.approx(node ** (k + 1) / (k + 1), abs=2.0 * EPS)


class TestPair:
    @pytest.mark.parametrize("name", [name for name, method in METHODS.items() if method.pair is not None])
    def test_first_is_the_step(self, name: str) -> None:
        method, start = METHODS[name], Motion()
        arguments = (INERTIA, HELD, 0.2, start.velocity, start.orientation, start.angular_velocity, start.load)
        assert method.pair is not None

        assert method.pair(*arguments)[0] == method.step(*arguments)

    @pytest.mark.parametrize(("name", "order", "time"), [("rkmk54", 4, 1.0), ("dverk", 5, 2.0)])
    def test_second_is_of_one_order_less(self, name: str, order: int, time: float) -> None:
        pair = METHODS[name].pair
        assert pair is not None

        found = orders(lambda *arguments: pair(*arguments)[1], time, (32, 48, 64, 96))

        expected = {quantity: pytest.approx(order, abs=0.2) for quantity in found}
        if name == "dverk":
            # The books are those of the step; only the work contains an impulse of the second result.
            assert found.pop("torque_impulse") >= 5.8
            del expected["torque_impulse"]
        assert found == expected

    def test_both_of_dverk_are_of_their_order_under_a_held_wrench_alone(self) -> None:
        """With displacement from forces, and work from the mean velocity."""
        pair, time, counts = METHODS["dverk"].pair, 2.0, (32, 48, 64, 96)
        assert pair is not None
        expected = run(lambda *arguments: METHODS["taylor"].step(*arguments[:-1]), time, 64).quantities()
        for k, order in enumerate((6, 5)):
            errors = [differences(run(lambda *a, k=k: pair(*a[:-1])[k], time, n), expected) for n in counts]
            for quantity in errors[0]:
                found = slope([time / n for n in counts], [error[quantity] for error in errors])
                assert found >= order - 0.35, quantity

    @pytest.mark.parametrize("loaded", [True, False])
    @pytest.mark.parametrize("h", [0.4, 0.2, 0.1])
    def test_the_estimate_of_dop853_is_no_smaller_than_the_error(self, h: float, loaded: bool) -> None:
        """For each quantity used by step control, with a zero load and without load."""
        method, start = METHODS["dop853"], Motion()
        assert method.pair is not None
        at = (start.velocity, start.orientation, start.angular_velocity)

        step, other = method.pair(INERTIA, HELD, h, *at, (lambda *_: (ZERO, ZERO)) if loaded else None)

        right = METHODS["taylor"].step(INERTIA, HELD, h, *at)
        for name in ("displacement", "orientation", "angular_velocity", "impulse"):
            error = math.dist(getattr(step, name), getattr(right, name))
            assert math.dist(getattr(step, name), getattr(other, name)) >= error - 4.0 * EPS, name

    def test_the_estimate_of_dop853_falls_as_an_error_of_order_seven(self) -> None:
        """It is also at least the error of the step, compared with steps of half the length."""
        method, start = METHODS["dop853"], Motion()
        assert method.pair is not None
        estimates = []
        for h in (0.4, 0.2, 0.1):
            step, other = method.pair(
                INERTIA, HELD, h, start.velocity, start.orientation, start.angular_velocity, start.load
            )
            estimates.append(math.dist(step.angular_velocity, other.angular_velocity))
            half = start.after(
                method.step(
                    INERTIA, HELD, 0.5 * h, start.velocity, start.orientation, start.angular_velocity, start.load
                ),
                0.5 * h,
            )
            end = method.step(INERTIA, HELD, 0.5 * h, half.velocity, half.orientation, half.angular_velocity, half.load)
            assert math.dist(step.angular_velocity, end.angular_velocity) <= estimates[-1] + 4.0 * EPS
        assert [math.log2(a / b) for a, b in itertools.pairwise(estimates)] == pytest.approx([8.0, 8.0], abs=0.7)


class TestStiffDrag:
    """Drag of 1e4/s in steps of 0.05 s: hundreds of times what an explicit method can take."""

    RATE, STEP, COUNT = 1e4, 0.05, 40
    HELD = HeldWrench(force_world=(0.5, -0.3, 0.2), torque_body=(0.4, 0.0, 0.0))

    def end(self, name: str) -> tuple[Motion, Increment]:
        coefficient, spin_coefficient = self.RATE * INERTIA.mass, self.RATE * INERTIA.moments[0]

        def drag(t: float, x: Vector, v: Vector, q: Quaternion, w: Vector) -> tuple[Vector, Vector]:
            return scale(-coefficient, v), scale(-spin_coefficient, w)

        motion = Motion()
        for _ in range(self.COUNT):
            step = METHODS[name].step(
                INERTIA, self.HELD, self.STEP, motion.velocity, motion.orientation, motion.angular_velocity, drag
            )
            motion = motion.after(step, self.STEP)
        return motion, step

    @pytest.mark.parametrize("name", ["rk4", "rkmk4", "cf4", "rkmk54", "dverk", "dop853", "euler"])
    def test_explicit_methods_say_that_they_diverge(self, name: str) -> None:
        with pytest.raises(ConvergenceError, match=name):
            self.end(name)

    def test_radau_reaches_the_terminal_velocities(self) -> None:
        motion, step = self.end("radau")

        velocity = scale(1.0 / (self.RATE * INERTIA.mass), self.HELD.force_world)
        spin = scale(1.0 / (self.RATE * INERTIA.moments[0]), self.HELD.torque_body)
        assert math.dist(motion.velocity, velocity) <= 16.0 * EPS
        assert math.dist(motion.angular_velocity, spin) <= 16.0 * EPS
        assert math.dist(step.displacement, scale(self.STEP, velocity)) <= 16.0 * EPS
        # At rest force and drag cancel.
        assert norm(step.impulse) <= 16.0 * EPS
        # It stops within v / rate; then it creeps at the terminal velocity.
        start, time = Motion(), self.STEP * self.COUNT
        path = add_scaled(scale(time, velocity), 1.0 / self.RATE, subtract(start.velocity, velocity))
        assert math.dist(motion.position, add(start.position, path)) <= 1e-12

    def test_quadratic_drag_too(self) -> None:
        """v' = -k |v| v from v0 = 1 m/s: v = 1 / (1 + k t)."""
        k, h, v = 1e3, 0.05, (1.0, 0.0, 0.0)
        for _ in range(20):
            step = METHODS["radau"].step(
                Inertia(1.0, (1.0, 1.0, 1.0)),
                HeldWrench(),
                h,
                v,
                rotation.IDENTITY,
                ZERO,
                lambda t, x, v, q, w: (scale(-k * norm(v), v), ZERO),
            )
            v = add(v, step.impulse)

        assert v[0] == pytest.approx(1.0 / (1.0 + k * 20 * h), rel=0.05)
        assert v[1:] == (0.0, 0.0)


class TestRefusals:
    @each_method
    @pytest.mark.parametrize("bad", [math.nan, math.inf, 1e308])
    @pytest.mark.parametrize("part", [0, 1])
    def test_a_load_without_numbers_is_an_error(self, method: Method, part: int, bad: float) -> None:
        load = [ZERO, ZERO]
        load[part] = (bad, bad, 0.0)

        with pytest.raises(ConvergenceError, match=rf"{method.name}: .* step"):
            method.step(INERTIA, HELD, 10.0, ZERO, rotation.IDENTITY, ZERO, lambda *_: (load[0], load[1]))

    @each_method
    def test_a_step_of_several_turns_is_an_error(self, method: Method) -> None:
        with pytest.raises(ConvergenceError, match=rf"{method.name}: .*(expected|norm)"):
            method.step(INERTIA, HELD, 20.0, ZERO, rotation.IDENTITY, (1.0, 2.0, 1.0))

    @each_method
    def test_large_numbers_are_no_error(self, method: Method) -> None:
        """The sum of the numbers in a step may overflow although each is finite."""
        velocity = (7e307, 7e307, 7e307)

        step = method.step(INERTIA, HeldWrench(), 1.0, velocity, rotation.IDENTITY, ZERO)

        assert math.isinf(sum(step.displacement))
        assert step.displacement == pytest.approx(velocity)

    def test_newton_says_what_it_left(self) -> None:
        """A force that jumps with the velocity has no solution."""
        with pytest.raises(ConvergenceError, match=r"radau: Newton's method did not converge .* use a step below"):
            METHODS["radau"].step(
                INERTIA,
                HeldWrench(),
                1.0,
                (1e-3, 0.0, 0.0),
                rotation.IDENTITY,
                ZERO,
                lambda t, x, v, q, w: ((-math.copysign(10.0, v[0]), 0.0, 0.0), ZERO),
            )


class TestEuler:
    def test_is_what_it_says(self) -> None:
        """One step by hand."""
        v, q, w, h = (0.3, -0.1, 0.2), (0.5, -0.1, 0.7, 0.5), (0.7, -1.1, 0.9), 0.1
        held = HeldWrench(torque_body=(0.3, -0.2, 0.25), force_world=(-0.5, 0.8, 0.3))

        step = METHODS["euler"].step(INERTIA, held, h, v, q, w)

        after = add_scaled(v, h / INERTIA.mass, held.force_world)
        spin = subtract(held.torque_body, cross(w, multiply(INERTIA.moments, w)))
        omega = tuple(c + h * t / i for c, t, i in zip(w, spin, INERTIA.moments, strict=True))
        assert step.displacement == scale(h, after)
        assert step.angular_velocity == pytest.approx(omega, rel=4.0 * EPS)
        assert math.dist(step.orientation, rotation.multiply(q, rotation.exp(scale(h, omega)))) <= 4.0 * EPS
        gained = 0.5 * INERTIA.mass * (dot(after, after) - dot(v, v))
        turned = 0.5 * h * dot(held.torque_body, add(w, omega))
        assert step.work == pytest.approx(gained + turned, abs=8.0 * EPS)


def test_radau_differences_are_not_rounded_away() -> None:
    """A lagged wrench that begins at nearly nothing made an unknown so large that its Jacobian divided by zero."""
    found = radau._jacobian(lambda _, y: [2.0 * y[0], y[1]], 0.0, [1e12, 0.0], [1e-8, 1e-8])

    assert found == [[pytest.approx(2.0), 0.0], [0.0, pytest.approx(1.0)]]


def test_radau_pushes_a_body_that_nothing_turns() -> None:
    """Its rotation is exactly zero; rounding errors of a large push in it were taken for corrections that never end."""
    force, decaying, lag, h = (-1000.0, -400.0, 700.0), (500.0, 800.0, 100.0), 0.35, 0.2

    step = METHODS["radau"].step(
        Inertia(7.5, (1.0, 2.0, 3.0)),
        HeldWrench(force_body=force),
        h,
        ZERO,
        rotation.IDENTITY,
        ZERO,
        lambda t, x, v, q, w: (scale(math.exp(-t / lag), decaying), ZERO),
    )

    impulse = add(scale(h, force), scale(lag * (1.0 - math.exp(-h / lag)), decaying))
    assert step.impulse == pytest.approx(impulse, rel=1e-5)
    assert norm(step.angular_velocity) <= 1e-30
