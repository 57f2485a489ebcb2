"""`Arc`: time is exact, and reading the motion does not change it."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motions import EPS, forced

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Increment, Inertia, Method
from rb_dynamics.motion.arc import Arc
from rb_dynamics.motion.method import Load
from rb_dynamics.motion.phase_state import PhaseState, in_principal_axes, inertia_of
from rb_dynamics.motion.step_control import AccuracyControl, FixedStep, StepControl
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector, scale

SECOND = 1_000_000_000


def drift(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance a free particle: a cheap method whose displacement shows the elapsed time."""
    return Increment(scale(h, velocity), orientation, angular_velocity, ZERO, ZERO, h)


DRIFT = Method("drift", order=9, invariants=frozenset(), step=drift)


def drifting(step: float, start_ns: int = 0) -> Arc:
    body = RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0))
    phase = PhaseState.of(body, State(linear_velocity_world=(1.0, 0.0, 0.0)))
    return Arc(DRIFT, inertia_of(body), HeldWrench(), FixedStep(step), start_ns, phase)


def tumbling(control: StepControl, method: str = "rkmk4", start_ns: int = 0) -> Arc:
    case = forced()
    held = in_principal_axes(case.body, case.held)
    return Arc(METHODS[method], inertia_of(case.body), held, control, start_ns, PhaseState.of(case.body, case.initial))


def controls(kind: str) -> StepControl:
    if kind == "accuracy":
        return AccuracyControl(1e-6, 2.0, 4, inertia_of(forced().body), start=forced().initial.position_world)
    return FixedStep({"whole": 0.02, "third": 1.0 / 30.0, "odd": 0.0123456789}[kind])


KINDS = ["whole", "third", "odd", "accuracy"]


class TestTime:
    @pytest.mark.parametrize(
        "step",
        [
            0.001,
            pytest.param(1.0 / 3e3, marks=pytest.mark.slow),
            0.0001234567890123,
            pytest.param(2.0**-13, marks=pytest.mark.slow),
        ],
    )
    def test_is_the_sum_of_all_steps(self, step: float) -> None:
        """The path after 1e5 steps on a grid off whole nanoseconds shows that none was lost, doubled or cut."""
        arc = drifting(step)
        end_ns = math.floor(100_000 * Fraction(repr(step)) * SECOND)

        phase = arc.at(end_ns)

        assert phase.center_of_mass_world[0] == pytest.approx(end_ns / SECOND, rel=4.0 * EPS)
        assert arc.steps_to(end_ns) == math.ceil(Fraction(end_ns, SECOND) / Fraction(repr(step)))

    @pytest.mark.parametrize("step", [0.001, 1.0 / 3e3, 1.0 / 7e3])
    def test_grid_points_never_drift(self, step: float) -> None:
        """The k-th grid point lies at k steps of the number the user wrote, rounded up to the ns it is reached in."""
        arc, time_ns = drifting(step, start_ns=77), 77
        for k in range(1, 2001):
            time_ns = arc.next_grid_ns()
            assert time_ns == 77 + math.ceil(k * Fraction(repr(step)) * SECOND)
            arc.at(time_ns)

    def test_a_grid_point_on_a_whole_nanosecond_is_reached_by_whole_steps(self) -> None:
        arc = drifting(0.25)

        assert arc.at(SECOND).work == 1.0
        assert arc.steps_to(SECOND) == 4

    @pytest.mark.parametrize("step", [1e-9, 0.4e-9, 1e-12])
    def test_steps_of_a_nanosecond_and_less(self, step: float) -> None:
        arc = drifting(step)

        assert arc.next_grid_ns() == 1
        assert arc.at(3).work == pytest.approx(3e-9, rel=1e-12)
        assert arc.steps_to(3) == math.ceil(3e-9 / step - 1e-6)
        assert arc.next_grid_ns() == 4

    def test_a_step_longer_than_the_arc(self) -> None:
        arc = drifting(1e9)

        assert arc.at(SECOND).center_of_mass_world[0] == 1.0
        assert arc.at(2 * SECOND).center_of_mass_world[0] == 2.0
        assert arc.steps_to(2 * SECOND) == 1
        assert arc.next_grid_ns() == 10**18

    def test_late_start_is_no_different(self) -> None:
        """An arc that begins after 30 years has the same bits as one that begins at 0."""
        late = 10**18 + 1
        here, there = tumbling(FixedStep(0.01)), tumbling(FixedStep(0.01), start_ns=late)

        assert here.at(SECOND + 7) == there.at(late + SECOND + 7)


class TestLooking:
    @pytest.mark.parametrize("kind", KINDS)
    @given(looks=st.lists(st.integers(0, 2 * SECOND), max_size=12))
    @settings(max_examples=15)
    def test_leaves_every_bit(self, kind: str, looks: list[int]) -> None:
        looked, other = tumbling(controls(kind)), tumbling(controls(kind))

        seen = {time_ns: looked.at(time_ns) for time_ns in sorted(looks)}

        assert looked.at(2 * SECOND) == other.at(2 * SECOND)
        assert looked.steps_to(2 * SECOND) == other.steps_to(2 * SECOND)
        # And what was seen is what one sees who looks but once.
        for time_ns in list(seen)[:2]:
            assert tumbling(controls(kind)).at(time_ns) == seen[time_ns]

    @pytest.mark.parametrize("kind", KINDS)
    def test_asking_for_the_grid_leaves_every_bit(self, kind: str) -> None:
        asked, other = tumbling(controls(kind)), tumbling(controls(kind))

        while (time_ns := asked.next_grid_ns()) < 2 * SECOND:
            asked.at(time_ns)

        assert asked.at(2 * SECOND) == other.at(2 * SECOND)

    @pytest.mark.parametrize("kind", KINDS)
    def test_what_is_not_entered_leaves_no_trace_in_the_control(self, kind: str) -> None:
        """Two arcs share a control, as in a run; reading the first one does not affect the second."""
        ends = []
        for ask in (False, True):
            control = controls(kind)
            first = tumbling(control)
            first.at(SECOND)
            if ask:
                first.next_grid_ns()
            idle = Arc(METHODS["rkmk4"], inertia_of(forced().body), HeldWrench(), control, SECOND, first.at(SECOND))
            if ask:
                idle.next_grid_ns()
            ends.append(tumbling(control, start_ns=SECOND).at(3 * SECOND))

        assert ends[0] == ends[1]

    def test_the_same_time_twice(self) -> None:
        arc = tumbling(FixedStep(0.03))

        assert arc.at(SECOND) == arc.at(SECOND)

    def test_the_start_is_the_phase_given(self) -> None:
        arc = tumbling(FixedStep(0.03))

        assert arc.at(0) == PhaseState.of(forced().body, forced().initial)
        assert arc.steps_to(0) == 0


class TestSums:
    def test_small_increments_to_a_large_sum_lose_nothing(self) -> None:
        """At 1e12 m one unit in the last place is 1.2e-4 m; each step moves by a tenth of it."""
        phase = PhaseState((0.0, 0.0, 0.0, 1.0), ZERO, (1e12,) + (0.0,) * 13, (0.0,) * 14)
        step = Increment((1e-5, 0.0, 0.0), phase.orientation, ZERO, ZERO, ZERO, 0.1)
        n = 100_000
        for _ in range(n):
            phase = phase.after(step, 0.0)

        assert phase.center_of_mass_world[0] == float(Fraction(1e12) + n * Fraction(1e-5))
        assert phase.work == pytest.approx(n * 0.1, rel=EPS)

    @given(st.lists(st.floats(-1e16, 1e16), min_size=1, max_size=60))
    def test_a_sum_is_rounded_once(self, terms: list[float]) -> None:
        phase = PhaseState((0.0, 0.0, 0.0, 1.0), ZERO, (0.0,) * 14, (0.0,) * 14)
        for term in terms:
            phase = phase.after(Increment(ZERO, phase.orientation, ZERO, (0.0, term, 0.0), ZERO, term), 0.0)

        exact = sum(map(Fraction, terms))
        largest = max(abs(t) for t in terms)
        for found in (phase.work, phase.impulse_world[1], phase.linear_momentum_world[1]):
            assert abs(Fraction(found) - exact) <= Fraction(EPS) * abs(exact) + Fraction(
                len(terms) ** 2 * EPS**2 * largest
            )
