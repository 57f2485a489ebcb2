"""`auto` keeps the accuracy, chooses by cost and step, and always chooses the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest
from motions import errors, forced

from rb_dynamics.body.state import State
from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import METHODS, auto_method
from rb_dynamics.motion.adaptive_kernel import LONGEST, RATES
from rb_dynamics.motion.arc import Stepper
from rb_dynamics.motion.auto_method import CANDIDATES, COST_OF_A_STEP, cheapest, longest_stride
from rb_dynamics.motion.load_time_scale import fastest_rate, steady_time
from rb_dynamics.motion.method import Method
from rb_dynamics.motion.phase_state import PhaseState, in_principal_axes, inertia_of
from rb_dynamics.motion.step_control import AccuracyControl, StepControl
from rb_dynamics.numerics import compilation
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import angle_between
from rb_dynamics.numerics.vector import norm, subtract
from rb_dynamics.run.plan import Plan
from rb_dynamics.run.simulate import simulate
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.scene.model import Solver
from rb_dynamics.scene.read import parse_scene

needs_numba = pytest.mark.skipif(not compilation.available(), reason="nothing to compare with: numba is not installed")

DRIVEN = (
    "body: {mass: 2.5, center_of_mass: [0.1, -0.2, 0.3], "
    "inertia: {matrix: [[2.1, 0.1, -0.2], [0.1, 1.7, 0.3], [-0.2, 0.3, 2.9]]}}\n"
    "initial: {position_world: [5, 0, 0], linear_velocity_world: [0, 1, 0], angular_velocity_body: [0.4, -0.2, 0.7]}\n"
    "duration: 5\noutput_rate: 10\nwrenches: [{topic: a}, {topic: b}]\n"
)
EFFECTS = {
    LoadDependence.HELD: "effects: [{type: scheduled_wrench, "
    "schedule: [{time: 0, force: [1, 2, 0], torque: [0.3, 0, 0.2]}]}]",
    LoadDependence.FIELD: "effects: [{type: central_gravity, gravitational_parameter: 2, gravity_gradient: true}]",
    LoadDependence.ANY: "effects: [{type: linear_drag, translation: 0.2, rotation: 0.3}, "
    "{type: rotor, axis_body: [0, 1, 1], axial_inertia: 0.1, spin_rate: 10}]",
}


@pytest.mark.parametrize("accuracy", [1e-4, 1e-7, 1e-10])
def test_keeps_the_accuracy_against_thirty_digits(accuracy: float) -> None:
    case = forced()
    for time in case.states:
        if time > 0.0:
            plan = Plan(case.scene(Solver("auto", accuracy=accuracy), time))
            start = PhaseState.of(case.body, case.initial)
            arc = plan.arc(in_principal_axes(case.body, case.held), 0, start, None)
            phase = arc.at(round(time * NANOSECONDS))
            found = errors(case, time, phase)
            path = norm(subtract(phase.state(case.body, 0).position_world, case.initial.position_world))
            assert found["attitude"] <= accuracy
            assert found["position_world"] <= accuracy * path


@pytest.mark.parametrize("accuracy", [1e-4, 1e-7, 1e-10])
@pytest.mark.parametrize("takes", EFFECTS)
def test_keeps_the_accuracy_under_every_kind_of_load(takes: LoadDependence, accuracy: float) -> None:
    """The reference is another method, a hundred times finer than the finest; mild scenes, where errors do not grow."""
    reference = simulate(parse_scene(f"{DRIVEN}{EFFECTS[takes]}\nsolver: {{method: rkmk54, accuracy: 1.0e-12}}")).sample
    sample = simulate(parse_scene(f"{DRIVEN}{EFFECTS[takes]}\nsolver: {{method: auto, accuracy: {accuracy!r}}}")).sample

    assert angle_between(sample.orientation_xyzw, reference.orientation_xyzw) <= accuracy + 1e-12
    path = norm(subtract(reference.position_world, (5.0, 0.0, 0.0)))
    assert norm(subtract(sample.position_world, reference.position_world)) <= (accuracy + 1e-12) * path


def test_every_candidate_is_a_method_that_takes_the_load_and_has_a_cost() -> None:
    for takes, names in CANDIDATES.items():
        # States of a load's own, as those of wheels, are taken by one method so far.
        assert len(set(names)) == len(names) >= (1 if takes is LoadDependence.STATES else 2)
        for name in names:
            assert METHODS[name].takes >= takes
            assert COST_OF_A_STEP[name] > 0.0


class TestChoice:
    def choose(self, costs: Mapping[str, float], monkeypatch: pytest.MonkeyPatch) -> str:
        case = forced()
        monkeypatch.setattr(auto_method, "COST_OF_A_STEP", costs)
        plan = Plan(case.scene(Solver("auto", accuracy=1e-8), 10.0))
        held = in_principal_axes(case.body, case.held)
        (found,) = plan.arc(held, 0, PhaseState.of(case.body, case.initial), None).methods
        return found

    def test_follows_the_cost(self, monkeypatch: pytest.MonkeyPatch) -> None:
        names = CANDIDATES[LoadDependence.HELD]
        for wanted in names:
            costs = {name: 1e-9 if name == wanted else 1e9 for name in names}
            assert self.choose(costs, monkeypatch) == wanted

    def test_on_short_arcs_the_cost_of_a_step_decides(self) -> None:
        case = forced()
        start, held = PhaseState.of(case.body, case.initial), in_principal_axes(case.body, case.held)
        inertia = inertia_of(case.body)
        methods = (METHODS["taylor"], METHODS["dverk"])

        def control_for(method: object) -> StepControl:
            return Plan(case.scene(Solver(method.name, accuracy=1e-6), 10.0)).arc(held, 0, start, None)._control

        def advance_with(method: object) -> Stepper:
            return Stepper(method, inertia, held, None)

        long, _ = cheapest(methods, control_for, advance_with, start, 10.0, 10.0)
        short, control = cheapest(methods, control_for, advance_with, start, 1e-6, 10.0)
        assert long.name == "taylor"
        assert short.name == min(("taylor", "dverk"), key=COST_OF_A_STEP.__getitem__)
        assert longest_stride(control, advance_with(short), start) > 1e-6

    def test_a_candidate_that_cannot_keep_the_accuracy_is_left_out(self) -> None:
        """1e-12 is beyond what rkmk4 can do in any number of steps; taylor can."""
        run = simulate(
            parse_scene(f"{DRIVEN}{EFFECTS[LoadDependence.HELD]}\nsolver: {{method: auto, accuracy: 1.0e-12}}")
        )
        assert set(run.method.split("+")) <= {"exact", "taylor", "dop853", "dlm6"}

    @pytest.mark.parametrize(("rotation", "wanted"), [(0.3, False), (100.0, True)])
    def test_an_implicit_method_is_only_tried_where_stability_limits_the_step(
        self, rotation: float, wanted: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A trial of it takes longer than a whole run by a compiled explicit method."""
        tried = []

        def found(control: StepControl, advance: Stepper, phase: PhaseState) -> float:
            tried.append(advance._method.name)
            return longest_stride(control, advance, phase)

        monkeypatch.setattr(auto_method, "longest_stride", found)
        drag = f"effects: [{{type: linear_drag, translation: 0.2, rotation: {rotation}}}]"
        simulate(parse_scene(f"{DRIVEN.replace('duration: 5', 'duration: 500')}{drag}"))
        assert ("radau" in tried) == wanted

    def test_none_that_can_is_an_error_that_says_what_can_be_had(self) -> None:
        with pytest.raises(ConvergenceError, match="cannot be kept"):
            simulate(
                parse_scene(f"{DRIVEN}{EFFECTS[LoadDependence.HELD]}\nsolver: {{method: auto, accuracy: 1.0e-17}}")
            )


def test_commands_of_one_time_may_come_one_by_one() -> None:
    """The choice counts the arcs that time goes into: the same bits whether commands are posted together or apart."""
    commands = [
        (topic, Wrench(torque=(0.1 * k, 0.05, -0.02 * k), stamp_ns=k * 70_000_000)) for k in range(60) for topic in "ab"
    ]
    text = f"{DRIVEN}solver: {{method: auto, accuracy: 1.0e-8}}"
    together = simulate(parse_scene(text), commands)

    apart = Simulation(parse_scene(text))
    apart.start()
    for topic, wrench in commands:
        apart.advance(wrench.stamp_ns)
        apart.post(topic, wrench, wrench.stamp_ns)
        apart.advance(wrench.stamp_ns)
    apart.advance(5 * NANOSECONDS)

    assert apart.sample == together.sample
    assert apart.methods == together.method


@pytest.mark.parametrize("outputs", [0, 200])
def test_the_cheapest_strides_are_kept_while_one_takes_a_whole_arc(
    outputs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Edge by edge, and by the kernel: it is not chosen again after 2, 4, 8 ... arcs, but where these are longer."""
    chosen = []

    def counted(*arguments: object) -> tuple[Method, StepControl]:
        chosen.append(cheapest(*arguments))
        return chosen[-1]

    monkeypatch.setattr("rb_dynamics.run.plan.cheapest", counted)
    scene = parse_scene(f"{DRIVEN}solver: {{accuracy: 1.0e-8}}", overrides={"output_rate": outputs})

    def fly(apart_ns: int, count: int) -> int:
        chosen.clear()
        times_ns = [apart_ns * k for k in range(count)]
        simulate(
            scene, [("a", Wrench(torque=(0.1, 0.05, -0.02 * (k % 7)), stamp_ns=t)) for k, t in enumerate(times_ns)]
        )
        return len(chosen)

    assert fly(10_000_000, 100) == 2
    assert chosen[-1][0].name == "dverk"
    assert fly(250_000_000, 20) == 6


ORBIT = """
body: {mass: 10, inertia: {diagonal: [0.2, 0.25, 0.3]}}
initial:
  position_world: [6878137, 0, 0]
  linear_velocity_world: [0, 0, 7612.6]
  angular_velocity_body: [0.02, 0, 0.03]
wrenches: [{topic: wrench, lag: LAG}]
effects: [{type: central_gravity, gravitational_parameter: 3.986004418e14, gravity_gradient: true}]
duration: 2000
"""


def _steps(lag: float, pulses: int, length_ns: int = 0) -> int:
    """Return the steps of a part of an orbit with so many torques, which end again where they have a length."""
    commands = []
    for at_ns in (round((10 + 400 * k) * NANOSECONDS) for k in range(pulses)):
        commands.append(("wrench", Wrench((0.0, 0.0, 0.0), (0.0, 1e-6, 0.0), "body", at_ns)))
        if length_ns:
            commands.append(("wrench", Wrench((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "body", at_ns + length_ns)))
    return simulate(parse_scene(ORBIT.replace("LAG", str(lag))), commands).steps


def test_a_pulse_of_milliseconds_does_not_choose_for_the_coast_after_it() -> None:
    assert _steps(0.0, 1, 2_000_000) < _steps(0.0, 0) + 100


@pytest.mark.parametrize("lag", [1e-2, 1e-5])
def test_a_lag_costs_the_steps_of_its_own_time_alone_and_is_not_refused(lag: float) -> None:
    assert _steps(lag, 3) < _steps(lag, 0) + 100


@pytest.mark.parametrize(("arc", "tried"), [(1e-3, ["taylor", "dop853", "dverk"]), (10.0, None)])
def test_what_cannot_be_the_cheapest_in_short_arcs_is_not_tried(arc: float, tried: list[str] | None) -> None:
    case = forced()
    inertia, start = inertia_of(case.body), PhaseState.of(case.body, case.initial)
    held, asked = in_principal_axes(case.body, case.held), list[str]()

    def control(method: Method) -> StepControl:
        asked.append(method.name)
        order = method.order or 0
        return AccuracyControl(1e-6, 100.0, order, inertia, start=start.center_of_mass_world)

    names = CANDIDATES[LoadDependence.HELD]
    methods = tuple(METHODS[name] for name in names)
    found, _ = cheapest(methods, control, lambda method: Stepper(method, inertia, held, None), start, arc, 100.0)
    assert asked == (tried or [*names])
    # As if all had been tried: in so short an arc each takes one stride, and only the price of a stride counts.
    assert tried is None or found.name == min(names, key=lambda name: COST_OF_A_STEP[name])


def test_a_control_it_returns_knows_its_stride() -> None:
    case = forced()
    start, held = PhaseState.of(case.body, case.initial), in_principal_axes(case.body, case.held)
    control = AccuracyControl(1e-9, 10.0, 4, inertia_of(case.body), start=start.center_of_mass_world)
    stepper = Stepper(METHODS["rk4"], inertia_of(case.body), held, None)
    found = longest_stride(control, stepper, start)
    first, _ = control.stride(start, stepper)
    assert first / NANOSECONDS == pytest.approx(found, rel=0.5)


@needs_numba
@pytest.mark.parametrize("takes", [LoadDependence.FIELD, LoadDependence.ANY])
@pytest.mark.parametrize("name", ["rk4", "dop853"])
def test_kernels_find_the_strides_and_rates_of_plain_python(
    monkeypatch: pytest.MonkeyPatch, name: str, takes: LoadDependence
) -> None:
    in_plain: list[float] = []
    for what in (steady_time, fastest_rate):
        monkeypatch.setattr(f"rb_dynamics.motion.arc.{what.__name__}", lambda *of, f=what: in_plain.append(1) or f(*of))
    found = []
    for when in ("never", "always"):
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
        run = Simulation(parse_scene(f"{DRIVEN}{EFFECTS[takes]}\nsolver: {{method: rk4, accuracy: 1.0e-9}}"))
        stepper, control = run._arc._stepper(METHODS[name]), run.plan.control_of(METHODS[name])
        for kernel in (stepper.strides(control), LONGEST, RATES):
            assert kernel is not None
            kernel.get(1, 1)
        in_plain.clear()
        found.append((longest_stride(control, stepper, run.phase), control.learnt, stepper.fastest_rate(run.phase)))
        assert len(in_plain) == (2 if when == "never" else 0)
    assert found[0] == found[1]


MOVING = (
    "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\n"
    "initial: {linear_velocity_world: [1, 2, 3], angular_velocity_body: [1, 2, 3]}\nwrenches: []\noutput_rate: 1\n"
)


class TestNasty:
    @pytest.mark.parametrize("coefficient", [1e3, 1e5, 1e6])
    def test_stiff_drag_stops_the_body_and_the_steps_grow_again(self, coefficient: float) -> None:
        """An explicit method needs 1e5 steps and more; the transient must not determine the choice for all of it."""
        drag = f"effects: [{{type: linear_drag, translation: {coefficient!r}, rotation: {coefficient!r}}}]"
        run = simulate(parse_scene(f"{MOVING}duration: 1\n{drag}"))
        assert run.steps < 2000
        assert run.sample.position_world == pytest.approx(
            (1.0 / coefficient, 2.0 / coefficient, 3.0 / coefficient), rel=1e-6, abs=3e-9
        )
        assert norm(run.sample.angular_velocity_body) < 1e-9

    def test_radau_goes_on_where_the_speed_is_gone(self) -> None:
        drag = "effects: [{type: linear_drag, translation: 1.0e+5}]\nsolver: {method: radau, accuracy: 1.0e-9}"
        run = simulate(parse_scene(f"{MOVING}duration: 1\n{drag}"))
        assert run.steps < 2000
        assert norm(run.sample.linear_velocity_world) < 1e-9

    def test_a_kick_after_a_long_coast_has_little_time_to_grow(self) -> None:
        """Errors grow only over the rest of the run, so nothing has to be refused."""
        kick = "effects: [{type: scheduled_wrench, schedule: [{time: 1990, torque: [50, 20, 10]}, {time: 1991}]}]"
        run = simulate(parse_scene(f"{MOVING}duration: 2000\n{kick}"))
        coast = simulate(parse_scene(f"{MOVING}duration: 1990\nsolver: {{method: exact}}")).sample
        start = State(
            0, coast.position_world, coast.orientation_xyzw, coast.linear_velocity_world, coast.angular_velocity_body
        )
        after = f"{MOVING}duration: 10\n{kick.replace('1990', '0').replace('1991', '1')}\n"
        fine = simulate(replace(parse_scene(f"{after}solver: {{method: taylor, step: 0.007}}"), initial=start))
        assert angle_between(run.sample.orientation_xyzw, fine.sample.orientation_xyzw) <= 1e-9

    def test_a_run_without_end_keeps_its_accuracy_for_ever(self) -> None:
        """Also after the horizon of an hour: the choice still has a positive remaining time."""
        endless = DRIVEN.replace("duration: 5\noutput_rate: 10", "output_rate: 0.1")
        text = f"{endless}solver: {{method: auto, accuracy: 1.0e-8}}"
        late, early = Simulation(parse_scene(text)), Simulation(parse_scene(text))
        late.advance(5000 * NANOSECONDS)
        for run in (late, early):
            run.start()
            run.post("a", Wrench(torque=(0.3, -0.2, 0.1)))
            run.advance(run.time_ns + 10 * NANOSECONDS)
        assert late.steps - 1 <= 2 * early.steps
        assert "exact" in late.methods

    def test_the_bits_do_not_depend_on_how_often_it_is_asked(self) -> None:
        drag = "effects: [{type: linear_drag, translation: 1.0e+3, rotation: 1.0e+3}]"
        whole = simulate(parse_scene(f"{MOVING}duration: 1\n{drag}"))
        pieces = Simulation(parse_scene(f"{MOVING}duration: 1\n{drag}"))
        for k in range(1, 1001):
            pieces.advance(k * NANOSECONDS // 1000)
        assert pieces.sample == whole.sample
        assert pieces.methods == whole.method


SPINNING = (
    "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0, 100, 0]}\nwrenches: []\n"
)


def test_a_closed_form_too_refuses_what_rounding_spoils() -> None:
    """After 1e10 rad the attitude is known to 1e-6 rad: a finer accuracy is refused, naming the method is not."""
    with pytest.raises(
        ConvergenceError, match=r"1e-09 cannot be kept: in closed form too, rounding alone .* 3e-06 rad"
    ):
        simulate(parse_scene(f"{SPINNING}duration: 1.0e+8\n"))
    simulate(parse_scene(f"{SPINNING}duration: 1.0e+8\nsolver: {{method: auto, accuracy: 1.0e-5}}\n"))
    simulate(parse_scene(f"{SPINNING}duration: 1.0e+8\nsolver: {{method: exact}}\n"))


def test_what_is_braked_in_time_keeps_its_accuracy() -> None:
    """The actual rotation counts, not the one without the brake."""
    brake = "effects: [{type: scheduled_wrench, schedule: [{time: 1000, torque: [0, -20, 0]}, {time: 1010}]}]\n"
    simulate(parse_scene(f"{SPINNING}{brake}duration: 1.0e+8\n"))
    with pytest.raises(ConvergenceError, match="in closed form too"):
        simulate(
            parse_scene(f"{SPINNING}{brake.replace('1000', '1.0e+6').replace('1010', '1000010')}duration: 1.0e+8\n")
        )


def test_a_run_without_end_is_not_stopped_by_its_closed_form() -> None:
    run = Simulation(parse_scene(f"{SPINNING}output_rate: 1.0e-8"))
    run.start()
    run.advance(10**17)
    assert run.methods == "exact"
