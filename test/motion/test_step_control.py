"""Step control reaches the accuracy asked for, or says that it cannot."""

from __future__ import annotations

import math
import random
import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import cache

import numpy as np
import pytest
from motions import STEPPED, Case, errors, forced, free
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.effect import Effect, Point
from rb_dynamics.loads.varying_load import Load, LoadDependence
from rb_dynamics.loads.wrench import HeldWrench, Wrench
from rb_dynamics.motion import Increment, Inertia
from rb_dynamics.motion.arc import Arc, Stepper
from rb_dynamics.motion.fixed_step_kernel import Tally, counted_by
from rb_dynamics.motion.phase_state import PhaseState, in_principal_axes, inertia_of
from rb_dynamics.motion.step_control import AccuracyControl, FixedStep, Goal, estimate
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.vector import ZERO, Vector, cross, norm, scale, subtract
from rb_dynamics.run.ensemble import Ensemble, driven_motion
from rb_dynamics.run.plan import Plan
from rb_dynamics.run.simulate import Run, simulate
from rb_dynamics.scene.model import Solver
from rb_dynamics.scene.read import parse_scene
from rb_dynamics.study.explain import explain


def driven(case: Case, method: str, accuracy: float, horizon: float) -> Arc:
    held = in_principal_axes(case.body, case.held)
    plan = Plan(case.scene(Solver(method, accuracy=accuracy), horizon))
    return plan.arc(held, 0, PhaseState.of(case.body, case.initial), None)


def achieved(case: Case, method: str, accuracy: float, time: float) -> tuple[float, int]:
    """Return the larger of the errors that `accuracy` bounds, and the number of steps."""
    arc = driven(case, method, accuracy, time)
    # Only many steps are worth a kernel: all methods have theirs, which take longer to compile than these runs.
    with counted_by(Tally()):
        phase = arc.at(round(time * NANOSECONDS))
        steps = arc.steps_to(round(time * NANOSECONDS))
    found = errors(case, time, phase)
    path = norm(subtract(phase.state(case.body, 0).position_world, case.initial.position_world))
    return max(found["attitude"], found["position_world"] / path), steps


# The lower the order, the more steps: order 2 needs 1e5 of them for 1e-8, order 1 for 1e-4.
FINEST = {1: 1e-3, 2: 1e-6, 3: 1e-7}
ACCURACIES = [
    pytest.param(method, accuracy, id=f"{method}-{accuracy:g}")
    for method in STEPPED
    for accuracy in (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
    if accuracy >= FINEST.get(STEPPED[method].order, 0.0)
]


class TestAccuracy:
    @pytest.mark.parametrize(("method", "accuracy"), ACCURACIES)
    @pytest.mark.parametrize("time", [1, 2])
    def test_is_reached_under_a_wrench(self, method: str, accuracy: float, time: float) -> None:
        error, steps = achieved(forced(), method, accuracy, time)

        assert error <= accuracy
        # Nor is it overdone: it is of the size that was asked for, or a few steps give it for nothing.
        assert error >= 1e-3 * accuracy or steps <= 20

    @pytest.mark.parametrize(
        ("method", "accuracy"),
        [p for p in ACCURACIES if p.values[1] >= max(1e-8, 10.0 * FINEST.get(STEPPED[p.values[0]].order, 0.0))],
    )
    def test_is_reached_near_the_middle_axis(self, method: str, accuracy: float) -> None:
        error, _ = achieved(free("dzhanibekov"), method, accuracy, 10.0)

        assert error <= accuracy

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("case", "method", "accuracy", "time"),
        [
            ("dzhanibekov", "rk4", 1e-9, 100.0),
            ("dzhanibekov", "rkmk4", 1e-9, 100.0),
            ("dzhanibekov", "midpoint", 1e-6, 10.0),
            ("boxes_rotation", "rkmk4", 1e-10, 5.0),
            ("forced", "rkmk4", 1e-10, 10),
            ("forced", "rk4", 1e-10, 10),
            ("forced", "midpoint", 1e-6, 5),
        ],
    )
    def test_is_reached_in_long_runs(self, case: str, method: str, accuracy: float, time: float) -> None:
        error, _ = achieved(forced() if case == "forced" else free(case), method, accuracy, time)

        assert error <= accuracy

    @pytest.mark.parametrize("method", STEPPED)
    def test_cost_grows_no_faster_than_the_order_says(self, method: str) -> None:
        loose = FINEST.get(STEPPED[method].order, 1e-8) * 100.0
        _, few = achieved(forced(), method, loose, 2)
        _, many = achieved(forced(), method, 0.01 * loose, 2)

        assert many / few <= 1.3 * 100.0 ** (1.0 / STEPPED[method].order)

    def test_is_a_promise_for_the_whole_run(self) -> None:
        """Ten times the run, the same accuracy at its end: each second is ten times as accurate, or better."""
        short, long = (driven(forced(), "rkmk4", 1e-7, horizon) for horizon in (1.0, 10.0))

        assert errors(forced(), 1, long.at(NANOSECONDS))["attitude"] <= 1e-7 / 10.0
        short.at(NANOSECONDS)
        assert long.steps_to(NANOSECONDS) > short.steps_to(NANOSECONDS)


class TestPair:
    """An embedded pair takes each stride once."""

    @staticmethod
    def counted(method: str, accuracy: float, time: float, *, embedded: bool) -> tuple[float, int]:
        """Return the larger of the errors that `accuracy` bounds, and the number of force evaluations."""
        evaluations = 0

        def nothing(*_: object) -> tuple[Vector, Vector]:
            nonlocal evaluations
            evaluations += 1
            return ZERO, ZERO

        case, chosen = forced(), STEPPED[method]
        inertia, held = inertia_of(case.body), in_principal_axes(case.body, case.held)
        start = PhaseState.of(case.body, case.initial)
        control = AccuracyControl(
            accuracy, time, chosen.order, inertia, start=start.center_of_mass_world, embedded=embedded
        )
        phase = Arc(chosen, inertia, held, control, 0, start, lambda _: nothing).at(round(time * NANOSECONDS))
        found = errors(case, time, phase)
        path = norm(subtract(phase.state(case.body, 0).position_world, case.initial.position_world))
        return max(found["attitude"], found["position_world"] / path), evaluations

    @pytest.mark.parametrize("accuracy", [1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10])
    @pytest.mark.parametrize("time", [1, 2, 5])
    def test_keeps_the_accuracy(self, accuracy: float, time: float) -> None:
        error, _ = self.counted("rkmk54", accuracy, time, embedded=True)

        assert error <= accuracy

    @pytest.mark.parametrize("accuracy", [1e-5, 1e-7, 1e-9])
    def test_takes_fewer_evaluations_than_doubling_of_the_order_it_estimates(self, accuracy: float) -> None:
        _, by_pair = self.counted("rkmk54", accuracy, 2, embedded=True)
        _, by_doubling = self.counted("rkmk4", accuracy, 2, embedded=False)

        assert by_pair < 0.7 * by_doubling

    @pytest.mark.parametrize("accuracy", [1e-5, 1e-6, 1e-7])
    def test_takes_fewer_evaluations_than_its_own_doubling_where_steps_are_long(self, accuracy: float) -> None:
        """At higher accuracy the order gained by step doubling outweighs its stages."""
        _, by_pair = self.counted("rkmk54", accuracy, 2, embedded=True)
        _, by_doubling = self.counted("rkmk54", accuracy, 2, embedded=False)

        assert by_pair < by_doubling

    def test_what_it_looks_at_leaves_no_trace(self) -> None:
        """With outputs between strides, and with refused strides, grid and bits stay the same."""
        ends = []
        for looks in ([], [1_234_567, 300_000_001, 300_000_002, 999_999_999]):
            case = forced()
            inertia, held = inertia_of(case.body), in_principal_axes(case.body, case.held)
            control = AccuracyControl(1e-8, 1.0, 5, inertia, start=ZERO, embedded=True)
            arc = Arc(STEPPED["rkmk54"], inertia, held, control, 0, PhaseState.of(case.body, case.initial))
            for look in looks:
                arc.at(look)
            ends.append(arc.at(NANOSECONDS))

        assert ends[0] == ends[1]

    def test_a_step_that_the_method_refuses_is_made_shorter(self) -> None:
        case = Case(forced().body, State(), HeldWrench(torque_body=(1e6, 2e6, -1e6)), {})
        inertia, held = inertia_of(case.body), in_principal_axes(case.body, case.held)
        control = AccuracyControl(1e-5, 0.001, 5, inertia, start=ZERO, embedded=True)

        phase = Arc(STEPPED["rkmk54"], inertia, held, control, 0, PhaseState.of(case.body, case.initial)).at(1_000_000)

        assert 100.0 < norm(phase.angular_velocity) < 1e4

    def test_looks_with_one_step_as_the_stride_is_taken(self) -> None:
        inertia = inertia_of(forced().body)

        assert AccuracyControl(1e-5, 1.0, 5, inertia, start=ZERO, embedded=True).parts == 1
        assert AccuracyControl(1e-5, 1.0, 5, inertia, start=ZERO).parts == 2


class TestStride:
    def test_a_body_at_rest_takes_ever_longer_steps(self) -> None:
        case = Case(forced().body, State(), HeldWrench(), {})
        arc = driven(case, "rkmk4", 1e-9, 1000.0)

        phase = arc.at(1000 * NANOSECONDS)

        assert arc.steps_to(1000 * NANOSECONDS) <= 5
        assert phase.state(case.body, 0) == PhaseState.of(case.body, case.initial).state(case.body, 0)

    def test_what_costs_no_error_costs_no_steps(self) -> None:
        """A force alone: every method gives the parabola exactly, however slow, fast or far away the body is."""
        body = RigidBody.from_diagonal(2.0, (1.0, 2.0, 2.5))
        for start in (State(), State(position_world=(1e12, 0.0, 0.0)), State(linear_velocity_world=(0.37, 0.0, 0.0))):
            case = Case(body, start, HeldWrench(force_world=(-0.074, 0.0, 0.0)), {})
            arc = driven(case, "rk4", 1e-9, 20.0)
            arc.at(20 * NANOSECONDS)
            assert arc.steps_to(20 * NANOSECONDS) <= 6

    def test_distance_from_the_origin_does_not_shorten_it(self) -> None:
        """Rounding of a far position is not an error of the method."""
        counts = []
        for x in (0.0, 1e3, 1e9, 1e12):
            start = State(
                position_world=(x, 0.0, 0.0),
                linear_velocity_world=(1e-3, 0.0, 0.0),
                angular_velocity_body=(0.7, 0.1, 0.9),
            )
            case = Case(forced().body, start, HeldWrench(force_body=(1e-5, 0.0, 0.0)), {})
            arc = driven(case, "rk4", 1e-7, 5.0)
            arc.at(5 * NANOSECONDS)
            counts.append(arc.steps_to(5 * NANOSECONDS))

        assert max(counts) <= 1.05 * min(counts)

    def test_a_step_that_the_method_refuses_is_made_shorter(self) -> None:
        """The first trial is 0.1 rad, far too much for a spin-up by 1e6 rad/s^2."""
        case = Case(forced().body, State(), HeldWrench(torque_body=(1e6, 2e6, -1e6)), {})

        phase = driven(case, "rkmk4", 1e-5, 0.001).at(NANOSECONDS // 1000)

        assert 100.0 < norm(phase.angular_velocity) < 1e4

    def test_what_not_even_a_nanosecond_reaches_is_said(self) -> None:
        case = Case(forced().body, State(angular_velocity_body=(7e9, -1e10, 9e9)), HeldWrench(), {})

        with pytest.raises(ConvergenceError, match="not even a step of 1 ns can be taken: rkmk4"):
            driven(case, "rkmk4", 1e-6, 1.0).at(NANOSECONDS)

    def test_strides_are_whole_nanoseconds(self) -> None:
        case = forced()
        control = AccuracyControl(1e-9, 1.0, 4, inertia_of(case.body), start=ZERO)
        arc = driven(case, "rkmk4", 1e-9, 1.0)

        assert control.denominator == 1
        assert arc.next_grid_ns() > 0
        before = arc.next_grid_ns()
        arc.at(before)
        assert arc.next_grid_ns() > before


class Noisy:
    """An `Advance` of order 2 with an error of `error` h^3 in the rate of 1 rad/s, and rounding."""

    def __init__(self, error: float) -> None:
        self.error, self._random = error, random.Random(1)

    def __call__(self, phase: PhaseState, h: float) -> PhaseState:
        rate = 1.0 + self.error * h**3 + self._random.gauss(0.0, 1.0) * 2.0**-52
        still = phase.angular_velocity[0] - 1.0
        return phase.after(Increment(ZERO, phase.orientation, (rate + still, 0.0, 0.0), ZERO, ZERO, 0.0), h)

    def pair(self, phase: PhaseState, h: float) -> tuple[PhaseState, PhaseState]:
        raise NotImplementedError

    def longest_step(self, phase: PhaseState, accuracy: float, horizon: float) -> float:
        raise NotImplementedError

    def slowing(self, phase: PhaseState) -> float:
        return 0.0

    def steady(self, phase: PhaseState, longest: float) -> float:
        return longest

    def sight(self, phase: PhaseState) -> float:
        return math.inf

    settled = math.inf


class Layer(Effect):
    """Drag of 10/s at x = `center` that falls by e in 10 m; `seen`: whether it defines a sight."""

    kind, takes = "layer", LoadDependence.ANY

    def __init__(self, center: float = 0.0, *, seen: bool = False) -> None:
        self.center, self.seen = center, seen

    def wrenching(self, body: RigidBody, start: float) -> Callable[[Point], tuple[Vector, Vector]]:
        def at(point: Point) -> tuple[Vector, Vector]:
            rate = 10.0 * math.exp(-0.1 * abs(point.position[0] - self.center))
            return scale(-rate * body.mass, point.velocity), ZERO

        return at

    def sight(self, body: RigidBody) -> Callable[[Point], float] | None:
        def ahead(point: Point) -> float:
            return max(0.5 * abs(point.position[0] - self.center), 5.0) / norm(point.velocity)

        return ahead if self.seen else None


class TestNoStepPassesOverAPlace:
    """A step with all stages beyond a localised load would find no error and be accepted."""

    @staticmethod
    def through(layer: Layer, speed: float, method: str, accuracy: float) -> Run:
        scene = parse_scene(
            f"body: {{mass: 2, inertia: {{diagonal: [1, 2, 2.5]}}}}\nduration: 3600\n"
            f"initial: {{linear_velocity_world: [{speed}, 0, 0]}}\nsolver: {{method: {method}, accuracy: {accuracy}}}"
        )
        return simulate(replace(scene, effects=(layer,)))

    @pytest.mark.parametrize("accuracy", [1e-3, 1e-6])
    @pytest.mark.parametrize("method", ["auto", "radau", "midpoint6", "dop853"])
    def test_where_it_starts(self, method: str, accuracy: float) -> None:
        sample = self.through(Layer(), 150.0, method, accuracy).sample

        # dv/dx is -10/s exp(-x / 10 m), so that 50 m/s are left, and x = 50 t + 10 ln 3.
        assert sample.position_world[0] == pytest.approx(180_000.0 + 10.0 * math.log(3.0), rel=accuracy)

    @pytest.mark.parametrize("method", ["auto", "radau", "rk4"])
    def test_that_an_effect_tells_it_of(self, method: str) -> None:
        sample = self.through(Layer(1e5, seen=True), 250.0, method, 1e-4).sample

        assert sample.linear_velocity_world[0] == pytest.approx(50.0, rel=1e-3)

    @pytest.mark.parametrize("method", ["auto", "radau", "rk4", "dlm6", "dmv864"])
    def test_where_a_small_mass_attracts_in_passing(self, method: str) -> None:
        mu, speed, aside = 1e6, 1e4, 10.0
        scene = parse_scene(
            f"body: {{mass: 1}}\ninitial: {{position_world: [-1e8, {aside}, 0], "
            f"linear_velocity_world: [{speed}, 0, 0]}}\nduration: 2e4\n"
            f"effects: [{{type: central_gravity, gravitational_parameter: {mu}}}]\n"
            f"solver: {{method: {method}, accuracy: 1e-3}}"
        )
        x, y, _ = simulate(scene).sample.linear_velocity_world

        # Rutherford's angle.
        assert math.atan2(-y, x) == pytest.approx(2.0 * math.atan(mu / (aside * speed**2)), rel=0.01)

    @pytest.mark.parametrize(
        ("load", "steady"),
        [
            (lambda t, *_: ((0.0, 0.0, -9.8), (1.0, 0.0, 0.0)), 36.0),
            (lambda t, x, v, *_: (scale(-2.0, v), ZERO), 36.0),
            # It comes to half of what it reaches at half of the time.
            (lambda t, x, *_: (scale(-2.0, x), ZERO), 36.0),
            # Noise far below the rounding of the rate.
            (lambda t, *_: (ZERO, (1e-25 * (t > 0.0), 0.0, 0.0)), 36.0),
            (lambda t, x, *_: (ZERO, (math.exp(-x[0]), 0.0, 0.0)), 36.0 * 2.0**-7),
        ],
    )
    def test_what_is_alike_for_long_costs_no_short_steps(self, load: Load, steady: float) -> None:
        stepper = Stepper(STEPPED["rk4"], Inertia(1.0, (1.0, 1.0, 1.0)), HeldWrench(), lambda phase: load)
        moving = PhaseState((0.0, 0.0, 0.0, 1.0), (0.1, 0.0, 0.0), (*ZERO, 3.0, *(0.0,) * 10), (0.0,) * 14)

        assert stepper.steady(moving, 36.0) == steady

    @pytest.mark.parametrize(
        ("load", "rate"),
        [
            (lambda t, *_: ((0.0, 0.0, -9.8), (1.0, 0.0, 0.0)), 0.0),
            (lambda t, x, v, *_: (scale(-8.0, v), ZERO), 4.0),
            # A rotor of 6 kg m^2/s across moments of 2 and 3 kg m^2.
            (lambda t, x, v, q, w: (ZERO, cross((6.0, 0.0, 0.0), w)), 6.0 / math.sqrt(6.0)),
            (lambda t, x, v, q, w: (ZERO, scale(-norm(w), w)), 0.2),
        ],
    )
    def test_the_fastest_rate_is_that_of_the_velocities(self, load: Load, rate: float) -> None:
        stepper = Stepper(STEPPED["rk4"], Inertia(2.0, (1.0, 2.0, 3.0)), HeldWrench(), lambda phase: load)
        moving = PhaseState((0.0, 0.0, 0.0, 1.0), (0.1, 0.0, 0.0), (*ZERO, 3.0, *(0.0,) * 10), (0.0,) * 14)

        assert stepper.fastest_rate(moving) == pytest.approx(rate, rel=1e-6, abs=1e-12)


class Failing(Effect):
    """A force that is undefined where `load` is."""

    kind, takes = "failing", LoadDependence.FIELD

    def __init__(self, load: Callable[[Point], float]) -> None:
        self.load = load

    def wrenching(self, body: RigidBody, start: float) -> Callable[[Point], tuple[Vector, Vector]]:
        return lambda point: ((self.load(point), 0.0, 0.0), ZERO)


class TestAnEffectThatFails:
    TEXT = (
        "body: {mass: 1}\ninitial: {linear_velocity_world: [1, 0, 0]}\nduration: 2.5\n"
        "solver: {method: %s, accuracy: 1e-4}"
    )

    def flown(self, method: str, load: Callable[[Point], float]) -> Run:
        return simulate(replace(parse_scene(self.TEXT % method), effects=(Failing(load),)))

    def test_on_trial_costs_that_step_alone(self) -> None:
        """x stays below 1/300 m, but a first trial of 0.025 s leads beyond 1/200 m, where the force has no value."""
        sample = self.flown("auto", lambda point: -450.0 * math.asin(200.0 * point.position[0])).sample

        assert abs(sample.position_world[0]) <= 1.0 / 300.0

    @pytest.mark.parametrize("method", ["auto", "rk4"])
    def test_on_the_way_is_said_with_time_and_state(self, method: str) -> None:
        failed = (
            "failing: its load fails with ValueError: .* at simulation time 0.7613.* s, position .* velocity .* rate "
        )
        with pytest.raises(ConvergenceError, match=failed):
            self.flown(method, lambda point: math.sqrt(1.0 - point.position[0]))

    @pytest.mark.parametrize("method", ["dop853", "rk4", "radau"])
    def test_at_a_pole_ends(self, method: str) -> None:
        """Before, steps of 2 ns were tried forever, since nine tenths of them round to 2 ns again."""
        with pytest.raises(ConvergenceError, match="at simulation time "):
            self.flown(method, lambda point: 1.0 / (2.0 - point.time) if point.time < 2.0 else 1.0 / 0.0)


class TestAFixedStep:
    SCENE = "body: {mass: 1}\nduration: 1e6\nsolver: {method: rk4, step: 1e-9}"

    def test_that_would_run_for_ages_is_refused(self) -> None:
        scene, most = parse_scene(self.SCENE), r"makes 1e\+15 steps in 1e\+06 s, .*; take a step of 1e-06 s or more"
        for run in (simulate, explain):
            with pytest.raises(SceneError, match=f"solver.step is 1e-09 s, which {most}"):
                run(scene)
        with pytest.raises(ValueError, match=most):
            driven_motion(scene.body, scene.initial, [10**15], method="rk4", step=1e-9)
        with pytest.raises(ValueError, match=most):
            Ensemble([scene.body], [scene.initial], "rk4", 1e-9).advance(1e6)


class TestWhereRoundingHidesTheError:
    """Differences between two results by rounding alone are not taken for errors, and hide none."""

    INERTIA = Inertia(1.0, (1.0, 1.0, 1.0))
    START = PhaseState((0.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0,) * 14, (0.0,) * 14)
    HORIZON, ACCURACY = 1e4, 1e-6

    def density(self, error: float, h: float) -> float:
        """Return the error at the end that strides of h s add per second, relative to the permitted one."""
        return 0.25 * error * h**3 * self.HORIZON / (0.2 * self.ACCURACY * h / self.HORIZON)

    @pytest.mark.parametrize("error", [8e-11, 8e-13, 8e-10])
    def test_strides_are_as_long_as_they_may_be(self, error: float) -> None:
        control = AccuracyControl(self.ACCURACY, self.HORIZON, 2, self.INERTIA, start=ZERO)
        noisy, phase, strides = Noisy(error), self.START, []

        for _ in range(400):
            length, after = control.stride(phase, noisy)
            control.begin()
            assert after is not None
            phase = after
            strides.append(length / NANOSECONDS)

        assert all(self.density(error, h) <= 1.0 for h in strides)
        assert all(self.density(error, h) >= 0.04 for h in strides[5:])

    def test_another_arc_may_have_more_of_it(self) -> None:
        control = AccuracyControl(self.ACCURACY, self.HORIZON, 2, self.INERTIA, start=ZERO)
        control.stride(self.START, Noisy(8e-13))
        control.begin()

        Arc(STEPPED["rk4"], self.INERTIA, HeldWrench(), control, 0, self.START)
        length, _ = control.stride(self.START, Noisy(8e-11))

        assert self.density(8e-11, length / NANOSECONDS) <= 1.0

    @pytest.mark.parametrize(
        ("method", "accuracy"),
        [("dmv104", 1e-8), ("dlm6", 1e-8), pytest.param("strang6", 1e-8, marks=pytest.mark.slow)],
    )
    def test_a_small_torque_for_a_long_time(self, method: str, accuracy: float) -> None:
        """No step is shorter than necessary; steps of a few nanoseconds would be refused."""
        arc = self.small_torque(method, accuracy)
        arc.at(NANOSECONDS)

        assert arc.steps_to(NANOSECONDS) <= 150

    def test_what_is_said_to_be_reachable_is_accepted(self) -> None:
        with pytest.raises(ConvergenceError) as refused:
            self.small_torque("dmv104", 5e-10).at(NANOSECONDS)
        found = re.search(r"rounding alone adds about (\S+) rad", str(refused.value))

        assert found is not None
        self.small_torque("dmv104", float(found[1])).at(NANOSECONDS)

    @pytest.mark.parametrize("method", ["auto", "dop853", "dverk"])
    @pytest.mark.parametrize("stamps", [(0, 1, 2), (500_000_000, 500_000_001, 500_000_002)])
    def test_commands_in_quick_succession_say_nothing_about_the_steps_after_them(
        self, method: str, stamps: tuple[int, ...]
    ) -> None:
        """The first stride of an arc is as short as the one before, and the next ones grow from it."""
        scene = parse_scene(
            "body: {mass: 1, inertia: {diagonal: [1, 1.2, 1.5]}}\n"
            "initial: {angular_velocity_body: [5, 0.1, 0.2]}\n"
            "effects: [{type: linear_drag, rotation: 0.001}]\n"
            f"solver: {{method: {method}, accuracy: 1.0e-10}}\n"
            "duration: 5.5\n"
        )
        commands = [("wrench", Wrench(torque=(0.1, 0.0, 0.01 * k), stamp_ns=ns)) for k, ns in enumerate(stamps)]
        late = [("wrench", replace(command, stamp_ns=stamps[-1])) for _, command in commands[-1:]]

        end, nearly = (simulate(scene, these).sample for these in (commands, late))

        assert np.abs(np.subtract(end.orientation_xyzw, nearly.orientation_xyzw)).max() < 1e-8

    @pytest.mark.parametrize("method", ["auto", "dop853", "rk4", pytest.param("radau", marks=pytest.mark.slow)])
    @pytest.mark.parametrize("apart", [1, 3])
    def test_commands_nanoseconds_apart_leave_a_step(self, method: str, apart: int) -> None:
        """What was learnt from a stride as long as the run was tried with one twice as long, and so not at all."""
        count = 60
        scene = parse_scene(
            "body: {mass: 2, inertia: {diagonal: [1, 1.2, 1.5]}}\nduration: 1\n"
            "wrenches: [{topic: held}, {topic: lagged, lag: 1e-4}]\n"
            f"solver: {{method: {method}, accuracy: 1e-10}}\n"
        )
        commands = [
            ("lagged" if k % 2 else "held", Wrench((1.0 + 0.1 * k, 0.0, 0.0), stamp_ns=apart * k)) for k in range(count)
        ]
        sample = simulate(scene, commands).sample

        # As if the last two had come at the start.
        reached = 6.8 / 2.0 * 0.5 + 6.9 / 2.0 * (0.5 - 1e-4 + 1e-8)
        assert sample.position_world[0] == pytest.approx(reached, rel=1e-9 * apart * count)

    def small_torque(self, method: str, accuracy: float) -> Arc:
        body = RigidBody.from_diagonal(2.0, (1.0, 1.5, 2.0))
        start, held = State(angular_velocity_body=(1.0, 0.3, 2.0)), HeldWrench(torque_body=(0.0, 1e-5, 2e-5))
        return driven(Case(body, start, held, {}), method, accuracy, self.HORIZON)


class TestFixedStep:
    @pytest.mark.parametrize("step", [0.001, 1.0 / 3e3, 0.1, 1e-12, 123456.789, 5e-324, 3])
    def test_is_the_decimal_number_that_was_written(self, step: float) -> None:
        control = FixedStep(step)
        phase = PhaseState.of(forced().body, forced().initial)

        stride, after = control.stride(phase, lambda p, _: p)

        assert Fraction(stride, control.denominator) == Fraction(repr(float(step))) * NANOSECONDS
        assert after is None


def particle_under(effects: str, velocity: float, duration: float, method: str, accuracy: float) -> Run:
    return simulate(
        parse_scene(
            f"body: {{mass: 1}}\ninitial: {{linear_velocity_world: [{velocity!r}, 0, 0]}}\nwrenches: []\n"
            f"effects: [{effects}]\nduration: {duration!r}\nsolver: {{method: {method}, accuracy: {accuracy!r}}}\n"
        )
    )


CONTROLLED = [("auto", 1e-9), ("auto", 1e-5), ("rk4", 1e-6), ("rkmk54", 1e-7), ("dop853", 1e-9)]


@cache
def braked_near_a_centre() -> list[float]:
    """Return where the particle of `test_after_a_fast_beginning` ends, its velocity and its path, by SciPy."""

    def slope(_: float, y: NDArray[np.float64]) -> NDArray[np.float64]:
        to, speed = np.array([-y[0], 30.0 - y[1]]), np.hypot(y[2], y[3])
        return np.array([*y[2:4], *(1e-3 * to / np.hypot(*to) ** 3 - speed * y[2:4]), speed])

    found = solve_ivp(slope, (0, 3000), [0, 0, 1e6, 0, 0], method="DOP853", rtol=3e-14, atol=1e-15)
    return [float(value) for value in found.y[:, -1]]


class TestDistanceTravelled:
    """The position error is relative to the path travelled, not to the initial speed times the duration."""

    @pytest.mark.parametrize("accuracy", [1e-6, 1e-9])
    @pytest.mark.parametrize("method", ["auto", "rk4", "dop853", "dverk"])
    def test_the_end_of_a_stride_that_a_command_cuts_short_is_not_on_it(self, method: str, accuracy: float) -> None:
        """Strong forces to and fro for microseconds, tried for milliseconds, and later a weak one, which lags."""
        mass, lag, end = 2.0, 1e-4, 1.0
        scene = parse_scene(
            f"body: {{mass: {mass}, inertia: {{diagonal: [1, 1.2, 1.5]}}}}\nduration: {end}\n"
            f"wrenches: [{{topic: held}}, {{topic: lagged, lag: {lag}}}]\n"
            f"solver: {{method: {method}, accuracy: {accuracy!r}}}\n"
        )
        strong = [(7_000 * k, 100.0 * (-1.0) ** k) for k in range(12)] + [(84_000, 0.0)]
        weak = [(650_000_000, 0.01), (650_400_000, 0.0)]
        commands = [
            (topic, Wrench((force, 0.0, 0.0), stamp_ns=ns))
            for topic, forces in (("held", strong), ("lagged", weak))
            for ns, force in forces
        ]
        path = 0.0
        for (ns, force), (_, before) in zip(strong, [(0, 0.0), *strong], strict=False):
            path += (force - before) / mass * 0.5 * (end - 1e-9 * ns) ** 2
        for sign, (ns, _) in zip((1.0, -1.0), weak, strict=True):
            late = end - 1e-9 * ns
            path += sign * 0.01 / mass * (0.5 * late**2 - lag * late + lag**2 * -math.expm1(-late / lag))

        assert simulate(scene, commands).sample.position_world[0] == pytest.approx(path, rel=accuracy)

    @pytest.mark.parametrize(("method", "accuracy"), CONTROLLED)
    def test_after_a_fast_beginning(self, method: str, accuracy: float) -> None:
        """From 1e6 m/s to rest within some metres, near a centre that then pulls it on for an hour."""
        effects = (
            "{type: quadratic_drag, translation: 1}, "
            "{type: central_gravity, gravitational_parameter: 1.0e-3, center_world: [0, 30, 0]}"
        )
        end = braked_near_a_centre()

        x, y, _ = particle_under(effects, 1e6, 3000.0, method, accuracy).sample.position_world

        assert np.hypot(x - end[0], y - end[1]) <= accuracy * end[4]

    @pytest.mark.parametrize(("method", "accuracy"), CONTROLLED)
    @pytest.mark.parametrize("velocity", [1e-3, 1.0, 1e4])
    def test_under_drag_that_has_a_closed_form(self, velocity: float, method: str, accuracy: float) -> None:
        for effects, time, path in (
            ("{type: linear_drag, translation: 0.7}", 300.0, velocity / 0.7 * -math.expm1(-210.0)),
            ("{type: quadratic_drag, translation: 0.7}", 300.0, math.log1p(210.0 * velocity) / 0.7),
        ):
            run = particle_under(effects, velocity, time, method, accuracy)
            assert abs(run.sample.position_world[0] - path) <= accuracy * path
            assert run.steps <= 2000

    @pytest.mark.parametrize(("method", "accuracy"), CONTROLLED)
    def test_after_a_return_to_the_start(self, method: str, accuracy: float) -> None:
        """Thrown up, with the drag of the air: where it comes down again it has travelled all the way."""
        effects = "{type: quadratic_drag, translation: 0.01}, {type: uniform_gravity, acceleration_world: [-10, 0, 0]}"
        limit = math.sqrt(10.0 / 0.01)
        rise, top = limit / 10.0 * math.atan(50.0 / limit), limit**2 / 20.0 * math.log1p((50.0 / limit) ** 2)
        fall = limit / 10.0 * math.acosh(math.exp(top * 10.0 / limit**2))
        run = particle_under(effects, 50.0, round(rise + fall, 9), method, accuracy)

        assert abs(run.sample.position_world[0]) <= accuracy * 2.0 * top + 1e-9 * limit

    @pytest.mark.parametrize(("method", "accuracy"), CONTROLLED[2:])
    def test_where_the_medium_thins_out(self, method: str, accuracy: float) -> None:
        """Out of an atmosphere of 10 m: at the start drag is strong, and nothing is left of it for an hour."""
        time, left = 3600.0, 101.0 - 10.0 * 10.0
        scene = parse_scene(
            f"body: {{mass: 1}}\ninitial: {{linear_velocity_world: [101, 0, 0]}}\nwrenches: []\nduration: {time}\n"
            f"solver: {{method: {method}, accuracy: {accuracy!r}}}\n"
        )
        run = simulate(replace(scene, effects=(Atmosphere(),)))

        path = left * time + 10.0 * math.log1p(100.0 / left)
        assert abs(run.sample.position_world[0] - path) <= accuracy * path


class Atmosphere(Effect):
    """Linear drag of 10/s that falls by e in each 10 m of height."""

    kind = "atmosphere"
    takes = LoadDependence.ANY

    def wrenching(self, body: RigidBody, start: float) -> Callable[[Point], tuple[Vector, Vector]]:
        def drag(point: Point) -> tuple[Vector, Vector]:
            return scale(-10.0 * math.exp(-0.1 * max(0.0, point.position[0])), point.velocity), ZERO

        return drag


@pytest.mark.parametrize("method", ["dop853", "dverk", "rkmk54", "radau", "rk4"])
def test_the_rounding_of_forces_that_cancel_is_no_error(method: str) -> None:
    heeled = """
body: {mass: 11.5, inertia: {diagonal: [0.16, 0.17, 0.18]}, center_of_mass: [0, 0, -0.01]}
initial: {orientation: {x: 0.3420201433256687, y: 0, z: 0, w: 0.9396926207859084}}
effects:
  - {type: uniform_gravity, acceleration_world: [0, 0, -9.80665]}
  - {type: buoyancy, volume: 0.0115, density: 1000.0, acceleration_world: [0, 0, -9.80665], center_body: [0, 0, 0.005]}
solver: {method: METHOD, accuracy: 1.0e-9}
duration: 2.0
""".replace("METHOD", method)
    end = simulate(parse_scene(heeled)).sample
    assert norm(end.linear_momentum_world) < 1e-11
    close = simulate(parse_scene(heeled.replace("1.0e-9", "1.0e-12"))).sample
    assert norm(subtract(end.angular_velocity_body, close.angular_velocity_body)) < 1e-8


@pytest.mark.parametrize("method", ["dverk", "radau"])
def test_a_thrust_that_holds_a_turning_body_up_is_no_error(method: str) -> None:
    body, turning = RigidBody.from_diagonal(1.3, (0.1, 0.2, 0.25)), State(angular_velocity_body=(0.0, 0.0, 1.3))
    up, down = (0.0, 0.0, 12.748645), (0.0, 0.0, -12.748645)
    held = HeldWrench(force_body=up, force_world=down)
    phase = driven(Case(body, turning, held, {}), method, 1e-9, 10.0).at(10 * NANOSECONDS)
    assert norm(phase.center_of_mass_world) < 1e-11


def test_a_body_that_falls_into_a_centre_of_gravity_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 2.5]}}\ninitial: {position_world: [1, 0, 0]}\n"
        "effects: [{type: central_gravity, gravitational_parameter: 1.0}]\nwrenches: []\nduration: 5\n"
    )
    with pytest.raises(ConvergenceError, match=r"at simulation time 1.1107.*near a centre of gravity into which the"):
        simulate(scene)


def test_rounding_far_from_the_origin_is_no_error_of_a_slow_body() -> None:
    """At 1e7 m the sums resolve 1e-25 m: more than a step of 1 ns may add to a path of 1e-9 m."""
    still = (0.0,) * 10
    goal = Goal(1e-7, 800.0, ends=True, x=1e7)
    begin, kept, other = (
        PhaseState((0.0, 0.0, 0.0, 1.0), (5e-4, 0.0, 0.0), (1e7, 0.0, 0.0, *still, time), (low, 0.0, 0.0, *still, 0.0))
        for low, time in ((0.0, 0.0), (4e-21, 1e-9), (4e-21 + 5e-26, 1e-9))
    )

    assert estimate(goal, 7e-10, begin, kept, other, 1e-9, 0.0)[1] == 0.0


@pytest.mark.parametrize(("method", "lag"), [("midpoint", 0.1), ("euler", 0.0)])
def test_from_rest_a_method_of_low_order_names_one_that_can(method: str, lag: float) -> None:
    scene = parse_scene(
        f"{{body: {{mass: 2, inertia: {{diagonal: [1, 1.2, 1.5]}}}}, wrenches: [{{topic: w, lag: {lag}}}], "
        f"duration: 1, solver: {{method: {method}, accuracy: 1e-3}}}}"
    )
    commands = [("w", Wrench((1.0, 0.0, 0.0)))]

    with pytest.raises(ConvergenceError, match="a method of higher order, such as auto"):
        simulate(scene, commands)
    simulate(replace(scene, solver=replace(scene.solver, method="auto")), commands)
