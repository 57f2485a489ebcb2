"""Ensembles: each body moves as it would alone, to the bit."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motions import Recorder, scene
from plugin_effects import Given, Roped, doubled, inverse

from rb_dynamics import METHODS, Ensemble, RigidBody, Samples, Simulation, Solver, State, Wrench
from rb_dynamics import driven_motion as driven
from rb_dynamics.errors import ConvergenceError, WrenchError
from rb_dynamics.loads.central_gravity import CentralGravity
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.drag import LinearDrag
from rb_dynamics.loads.effect import Effect, Wrenching
from rb_dynamics.loads.gyrostat_rotor import Rotor
from rb_dynamics.loads.magnetic_field import MagneticField
from rb_dynamics.loads.scheduled_wrench import ScheduledWrench
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.loads.wrench import WORLD, HeldWrench
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.motion.arc import Arc
from rb_dynamics.motion.batch_kernel import Mover
from rb_dynamics.motion.fixed_step_kernel import Tally, counted_by
from rb_dynamics.motion.phase_state import PhaseState, in_principal_axes, inertia_of
from rb_dynamics.motion.plugin_kernels import PluginKernel
from rb_dynamics.motion.step_control import FixedStep, WholeArc
from rb_dynamics.numerics import compilation
from rb_dynamics.numerics.rotation import normalize
from rb_dynamics.run.sample import Sample, SampleBuilder

BODY = RigidBody.from_matrix(2.5, [[2.1, 0.1, -0.2], [0.1, 1.7, 0.3], [-0.2, 0.3, 2.9]], (0.1, -0.2, 0.3))
OTHER = RigidBody.from_diagonal(1.3, (1.0, 2.0, 2.5))
STATE = State(0, (1.0, 2.0, 3.0), normalize((0.1, 0.2, 0.3, 0.4)), (0.3, 0.2, 0.1), (0.5, -0.4, 0.7))
WRENCHES = ("force_body", "torque_body", "force_world", "torque_world")
FIELDS = [name for name in Sample.__slots__ if hasattr(Samples, name)]
needs_numba = pytest.mark.skipif(not compilation.available(), reason="numba is not installed")


@pytest.fixture(params=["never", pytest.param("always", marks=needs_numba)])
def _compile(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", request.param)
    return str(request.param)


def rows(samples: Samples) -> list[str]:
    """Return each body, or each time, on a line of its own, by repr, which shows the sign of a zero too."""
    columns = [getattr(samples, name).tolist() for name in FIELDS]
    return [repr([tuple(x) if isinstance(x, list) else x for x in row]) for row in zip(*columns, strict=True)]


def row(sample: Sample) -> str:
    return repr([getattr(sample, name) for name in FIELDS])


class Alone:
    """One body, by the parts that `simulate` is made of."""

    def __init__(self, body: RigidBody, state: State, method: str, step: float) -> None:
        self._body, self._method, self._control = body, METHODS[method], FixedStep(step)
        if self._method.order is None:
            self._control = WholeArc()
        self._phase, self._time_ns = PhaseState.of(body, state), state.time_ns
        self._observer = SampleBuilder(CombinedEffects(body), self._phase)
        self.hold(HeldWrench())

    def hold(self, held: HeldWrench) -> None:
        inertia, held = inertia_of(self._body), in_principal_axes(self._body, held)
        self._arc = Arc(self._method, inertia, held, self._control, self._time_ns, self._phase)

    def sample_at(self, time_ns: int) -> Sample:
        self._time_ns, self._phase = time_ns, self._arc.at(time_ns)
        return self._observer.sample(self._phase, time_ns)


def bodies_and_states(r: random.Random, count: int) -> tuple[list[RigidBody], list[State]]:
    def vector() -> tuple[float, float, float]:
        return (r.uniform(-1.0, 1.0), r.uniform(-1.0, 1.0), r.uniform(-1.0, 1.0))

    bodies, states = [], []
    for _ in range(count):
        a, b = r.uniform(0.5, 2.0), r.uniform(0.5, 2.0)
        turn = normalize((*vector(), 1.5))
        moments = (a, b, r.uniform(abs(a - b) + 0.01, a + b))
        bodies.append(RigidBody.from_principal(r.uniform(0.1, 10.0), moments, turn, vector()))
        states.append(State(0, vector(), normalize((*vector(), r.uniform(0.1, 1.0))), vector(), vector()))
    return bodies, states


def held_wrenches(r: random.Random, count: int, size: float = 1.0) -> dict[str, Any]:
    return {name: np.array([[r.uniform(-size, size) for _ in range(3)] for _ in range(count)]) for name in WRENCHES}


def compare(r: random.Random, method: str, count: int, step: float, pieces: list[int]) -> None:
    """Compare each body of an ensemble, at each of the ends of `pieces` ns, before and after a change of wrench."""
    bodies, states = bodies_and_states(r, count)
    many = Ensemble(bodies, states, method, step)
    alone = [Alone(body, state, method, step) for body, state in zip(bodies, states, strict=True)]
    for k in range(2):
        if k == 1 and METHODS[method].order is not None:
            held = held_wrenches(r, count)
            many.hold(**held)
            for i, one in enumerate(alone):
                one.hold(HeldWrench(*(tuple(held[name][i].tolist()) for name in WRENCHES)))
        for piece in pieces:
            many.advance_to(many.time_ns + piece)
            assert rows(many.samples()) == [row(one.sample_at(many.time_ns)) for one in alone]


@given(
    seed=st.integers(0, 2**32),
    method=st.sampled_from(list(METHODS)),
    count=st.integers(1, 5),
    step=st.sampled_from([0.01, 0.003, 1.0 / 300.0]),
    pieces=st.lists(st.integers(0, 40_000_000), min_size=1, max_size=3),
)
def test_each_body_moves_as_it_would_alone(seed: int, method: str, count: int, step: float, pieces: list[int]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RB_DYNAMICS_COMPILE", "never")
        compare(random.Random(seed), method, count, step, pieces)


@needs_numba
@pytest.mark.parametrize(
    ("method", "count"),
    [
        ("rk4", 3),
        ("rk4", 70),
        pytest.param("euler", 20, marks=pytest.mark.slow),
        pytest.param("exact", 20, marks=pytest.mark.slow),
        ("radau", 3),
    ],
)
def test_compiled_too(monkeypatch: pytest.MonkeyPatch, method: str, count: int) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    monkeypatch.setattr("rb_dynamics.motion.batch_kernel.WORTH_A_THREAD", 1)

    compare(random.Random(1), method, count, 0.003, [50_000_000, 0, 1, 7_654_321])


EFFECTS: tuple[Effect, ...] = (
    UniformGravity((0.0, 0.3, -9.81)),
    LinearDrag((0.1, 0.2, 0.3), (0.01, 0.0, 0.05)),
    CentralGravity(5.0, (9.0, -0.1, 0.3), gravity_gradient=True),
    MagneticField("uniform", (1e-5, 0.0, 0.0)),
)


@pytest.mark.parametrize("effects", [EFFECTS, EFFECTS[:1], (Roped(), *EFFECTS)], ids=["loads", "gravity", "plug-in"])
@pytest.mark.parametrize("when", ["never", pytest.param("always", marks=needs_numba)])
def test_effects_act_as_in_a_run(monkeypatch: pytest.MonkeyPatch, when: str, effects: tuple[Effect, ...]) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
    bodies, states = bodies_and_states(random.Random(3), 14)
    scenes = [
        replace(scene(body, state, Solver("rk4", step=0.01), 0.2), effects=effects)
        for body, state in zip(bodies, states, strict=True)
    ]
    many = Ensemble(bodies, states, "rk4", 0.01, effects=[each.combined_effects for each in scenes])
    alone = [Simulation(each) for each in scenes]
    torque = (0.1, -0.2, 0.3)
    for time_ns in (50_000_000, 123_456_789, 200_000_000):
        many.advance_to(time_ns)
        for run in alone:
            run.advance(time_ns)
        assert rows(many.samples()) == [row(run.look()) for run in alone]
        if time_ns == 50_000_000:
            many.hold(torque_body=torque)
            for run in alone:
                run.post("wrench", Wrench(torque=torque), time_ns)


@needs_numba
def test_effects_of_plugins_are_compiled_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    ropes = [CombinedEffects(BODY, (Roped(stiffness),)) for stiffness in (4.0, 8.0)]
    with counted_by(tally := Tally()):
        Ensemble(BODY, [STATE, STATE], "rk4", 0.01, effects=ropes).advance(0.1)
    assert {each.name.split("_")[0] for each in tally.used if isinstance(each, PluginKernel)} == {"load", "scale"}
    assert sum(not isinstance(each, PluginKernel) for each in tally.used) == 1


def test_a_body_at_which_a_plugin_fails_is_named_as_in_plain_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always" if compilation.available() else "never")
    each = [CombinedEffects(BODY, (Given(partial(inverse, strength)),)) for strength in (1.0, 2.0)]
    with pytest.raises(ConvergenceError, match=r"body 0: given: its load fails with ZeroDivisionError: .* time 0\.5 s"):
        Ensemble(BODY, [STATE, STATE], "rk4", 0.125, effects=each).advance(1.0)


@dataclass(frozen=True)
class _FromStart(Given):
    """A load that differs from arc to arc."""

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        return partial(doubled, 1.0 + start)


@pytest.mark.parametrize(
    ("method", "effects", "message"),
    [
        ("rk4", _FromStart(None), "is given, expected"),
        ("rk4", Given(lambda point: doubled(1.0, point)), "is given, expected"),
        ("rk4", Rotor((0.0, 0.0, 1.0), 0.1, ((0.0, 5.0),)), r"effects\[0\] is rotor, expected .* simulate this body"),
        ("rk4", ScheduledWrench(((1.0, Wrench((1.0, 0.0, 0.0), frame_id=WORLD)),)), "is scheduled_wrench, expected"),
        ("rk4", UniformGravity((0.0, 0.0, 1e300)), "is uniform_gravity, expected"),
        ("dlm6", LinearDrag((0.1, 0.1, 0.1)), "method is dlm6, expected one that takes such effects side by side: "),
    ],
)
def test_effects_that_no_ensemble_takes(method: str, effects: Effect, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Ensemble(BODY, [STATE], method, 0.1, effects=[CombinedEffects(BODY, (effects,))])


def test_each_body_has_effects_of_its_own() -> None:
    other = CombinedEffects(OTHER, (LinearDrag((0.1, 0.1, 0.1)),))
    drag = CombinedEffects(BODY, (LinearDrag((0.1, 0.1, 0.1)),))
    for effects in (
        [drag],
        [drag, other],
        [drag, CombinedEffects(BODY)],
    ):
        with pytest.raises(ValueError, match=r"expected one on each|effects\[1\] is none, expected the kinds"):
            Ensemble(BODY, [STATE, STATE], "rk4", 0.1, effects=effects)


@pytest.mark.usefixtures("_compile")
@pytest.mark.parametrize("step", [0.003, 1.0 / 300.0, 0.7, 1e-3 / 7.0])
def test_a_schedule_is_what_simulate_makes_of_the_commands(step: float) -> None:
    r, count, period_ns = random.Random(2), 6, 20_000_000
    held, recorder = held_wrenches(r, count), Recorder()
    run = Simulation(
        scene(BODY, STATE, Solver("rk4", step=step), 1.0, 1e9 / period_ns, (Channel("body"), Channel("world"))),
        [recorder],
    )
    run.start()
    for k in range(count):
        force_body, torque_body, force_world, torque_world = (tuple(held[name][k].tolist()) for name in WRENCHES)
        run.post("body", Wrench(force_body, torque_body), k * period_ns)
        run.post("world", Wrench(force_world, torque_world, "world"), k * period_ns)
    run.advance(count * period_ns)

    times = period_ns * np.arange(1, count + 1)
    found = driven(BODY, STATE, times, method="rk4", step=step, **held)
    assert rows(found) == [row(sample) for sample in recorder.samples[1:]]
    assert found.time_ns.tolist() == [sample.time_ns for sample in recorder.samples[1:]]
    assert found.impulse_world[-1] == pytest.approx(
        found.linear_momentum_world[-1] - recorder.samples[0].linear_momentum_world
    )


@pytest.mark.usefixtures("_compile")
@pytest.mark.parametrize("for_all", [True, False])
def test_to_follow_is_to_hold_and_to_advance(for_all: bool) -> None:
    r, intervals, bodies = random.Random(3), 5, 3
    held = {n: np.array([held_wrenches(r, bodies)[n] for _ in range(intervals)]) for n in WRENCHES}
    if for_all:
        held = {name: part[:, 0] for name, part in held.items()}
    times = np.cumsum([10_000_000, 0, 1, 34_567_890, 5_000_000])
    states = bodies_and_states(r, bodies)
    one, other = (Ensemble(*states, "rk4", 0.002) for _ in range(2))

    one.follow(times, **held)
    for k in range(intervals):
        other.hold(**{name: part[k] for name, part in held.items()})
        other.advance_to(int(times[k]))

    assert rows(one.samples()) == rows(other.samples())
    for many in (one, other):
        many.advance(0.0033)
    assert rows(one.samples()) == rows(other.samples())


@pytest.mark.usefixtures("_compile")
def test_long_stretches_and_schedules_come_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    held = held_wrenches(random.Random(4), 9)
    times = 3_500_000 * np.arange(1, 10)

    def ends() -> list[str]:
        many = Ensemble([BODY, OTHER], [STATE, STATE], "rk4", 0.001)
        many.follow(times, **held)
        many.advance(0.02)
        return [*rows(many.samples()), *rows(driven(BODY, STATE, times, method="rk4", step=0.001, **held))]

    def last() -> list[str]:
        return rows(driven(BODY, STATE, times, method="rk4", step=0.001, last_only=True, **held))

    whole = ends()
    assert last() == whole[-1:]
    monkeypatch.setattr("rb_dynamics.run.ensemble.LONGEST_STRETCH", 7)
    assert ends() == whole
    assert last() == whole[-1:]


def test_lengths_beyond_53_bits_are_exact() -> None:
    """A step with many decimal digits, in a schedule and in the steps of a hold."""
    held, step = held_wrenches(random.Random(5), 3), 0.01234567890123456
    times = np.array([10**8, 10**8 + 1, 3 * 10**8])
    many = Ensemble(BODY, [STATE], "rk4", step)
    for k, time_ns in enumerate(times.tolist()):
        many.hold(**{name: part[k] for name, part in held.items()})
        many.advance_to(time_ns)

    assert rows(many.samples()) == rows(driven(BODY, STATE, times, method="rk4", step=step, **held))[-1:]


def test_a_time_of_numpy_is_as_good_as_one_of_python() -> None:
    """The step is a decimal number of so many digits that its multiples are no longer 64 bits."""
    ends = []
    for kind in (int, np.int64):
        many = Ensemble(BODY, [STATE], "rk4", 0.01234567890123456)
        many.advance_to(kind(250_000_000))
        ends.append(rows(many.samples()))
        assert type(many.time_ns) is int

    assert ends[0] == ends[1]


@pytest.mark.usefixtures("_compile")
def test_a_step_that_cannot_be_solved_names_the_body_and_changes_nothing() -> None:
    fast = State(angular_velocity_body=(1e4, 1e4, 1e4))
    many = Ensemble(OTHER, [STATE, STATE, fast], "rk4", 0.01)
    before = rows(many.samples())

    with pytest.raises(ConvergenceError, match=r"body 2: rk4: after a step of 0.01 s"):
        many.advance(1.0)
    assert many.time_ns == 0
    assert rows(many.samples()) == before


@pytest.mark.usefixtures("_compile")
@pytest.mark.parametrize("last_only", [False, True])
def test_a_schedule_that_cannot_be_solved_says_why(last_only: bool) -> None:
    torques = [[0, 0, 0], [1e9, 1e8, 1e7]]
    with pytest.raises(ConvergenceError, match=r"^rk4: after a step of 0.01 s"):
        driven(OTHER, STATE, [10**9, 2 * 10**9], method="rk4", step=0.01, torque_body=torques, last_only=last_only)


def test_exact_takes_what_has_a_closed_form_alone() -> None:
    many = Ensemble(BODY, [STATE], "exact")
    many.hold(torque_body=(0.0, 1.0, 0.0))

    with pytest.raises(ConvergenceError, match=r"^exact: .* use method auto"):
        many.advance(1.0)


def test_numbers_that_run_out_of_range_are_told_with_their_time() -> None:
    body = RigidBody.from_diagonal(1.0, (1.0, 2.0, 3.0))
    fast = State(linear_velocity_world=(1e305, 0.0, 0.0))
    with pytest.raises(ConvergenceError, match=r"^the state is no longer finite after 3000 s: "):
        Ensemble(body, [fast], "rk4", 100.0).advance(3000.0)


def test_a_particle_moves_and_takes_no_torque() -> None:
    many = Ensemble([BODY, RigidBody.particle(2.0)], [STATE, State()], "rk4", 0.1)
    many.hold(force_world=(4.0, 0.0, 0.0), torque_body=[(1.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
    many.advance(1.0)

    assert many.samples().position_world[1] == pytest.approx((1.0, 0.0, 0.0))
    with pytest.raises(WrenchError, match=r"torque_body acts on body 1, expected none: .* particle"):
        many.hold(torque_body=(1.0, 0.0, 0.0))


def test_what_is_no_number_is_no_wrench() -> None:
    many = Ensemble(BODY, [STATE], "rk4", 0.1)

    with pytest.raises(WrenchError, match=r"force_world.* is nan, expected finite numbers"):
        many.hold(force_world=(math.nan, 0.0, 0.0))


@pytest.mark.parametrize("wrench", [{"force_world": (0.0, -1e200, 0.0)}, {"torque_body": (1e20, 0.0, 0.0)}])
def test_what_no_body_can_follow_is_no_wrench(wrench: dict[str, tuple[float, float, float]]) -> None:
    with pytest.raises(WrenchError, match=r"about the centre of mass is 1e\+20.*expected at most"):
        Ensemble(BODY, [STATE], "rk4", 0.1).hold(**wrench)
    with pytest.raises(WrenchError, match=r"about the centre of mass is 1e\+20.*expected at most"):
        driven(BODY, STATE, [1000], method="rk4", step=0.1, **wrench)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((BODY, [], "rk4", 0.1), "0 bodies and 0 states, expected at least one state"),
        (([BODY], [STATE, STATE], "rk4", 0.1), "1 bodies and 2 states"),
        ((BODY, [STATE, State(5)], "rk4", 0.1), "between 0 and 5 ns, expected the same time for all"),
        ((BODY, [STATE], "auto", 0.1), "method is 'auto', expected one of exact, taylor"),
        ((BODY, [STATE], "strang4", 0.1), "; strang4 was removed; take dmv104, or strang6 for a slender body"),
        ((BODY, [STATE], "rk4"), "step is None, expected a number of 1e-15 or more"),
        ((BODY, [STATE], "rk4", -1.0), "step is -1.0, expected a number of 1e-15 or more"),
        ((BODY, [STATE], "rk4", 5e-324), "step is 5e-324, expected a number of 1e-15 or more"),
        ((BODY, [STATE], "rk4", 0.1, 0), "threads is 0, expected a whole number of at least 1"),
    ],
)
def test_what_makes_no_ensemble(arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Ensemble(*arguments)


@pytest.mark.parametrize(
    ("times", "wrench", "message"),
    [
        ([0.1], 0.0, r"shape \(1,\) and type float64, expected \(K,\) integers"),
        ([], 0.0, r"shape \(0,\)"),
        ([[1]], 0.0, r"shape \(1, 1\)"),
        ([5, 4], 0.0, r"times_ns\[1\] is 4, expected 5 or later"),
        ([-1], 0.0, r"times_ns\[0\] is -1, expected 0 or later"),
        ([1, 2], np.zeros((3, 3)), r"force_body has shape \(3, 3\), expected one that broadcasts to \(2, 3\) or"),
    ],
)
def test_what_makes_no_schedule(times: Any, wrench: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        driven(BODY, STATE, times, method="rk4", step=0.1, force_body=wrench)


def test_time_only_grows() -> None:
    many = Ensemble(BODY, [STATE], "rk4", 0.1)
    many.advance(1.0)

    with pytest.raises(ValueError, match=r"time_ns is 5, expected 1000000000 or later"):
        many.advance_to(5)
    with pytest.raises(ValueError, match=r"seconds is -1.0, expected a finite number of 0 or more"):
        many.advance(-1.0)


def test_the_number_of_bodies() -> None:
    assert len(Ensemble(BODY, [STATE] * 3, "rk4", 0.1)) == 3


@pytest.mark.usefixtures("_compile")
def test_what_was_seen_stays_as_it_was() -> None:
    """Buffers are reused, but never those of samples or of a hold."""
    r = random.Random(6)
    many, other = (Ensemble(*bodies_and_states(random.Random(7), 70), "rk4", 0.002) for _ in range(2))
    held, seen, expected = held_wrenches(r, 70), [], []
    for k in range(6):
        for one in (many, other):
            if k == 2:
                one.hold(**held)
            one.advance(0.0033)
        seen.append(many.samples())
        expected.append(rows(other.samples()))

    assert [rows(samples) for samples in seen] == expected
    assert len(seen[0]) == 70


def test_what_is_held_does_not_change_with_the_array_it_came_from() -> None:
    torque, times = np.array([[0.0, 0.1, -0.0]]), np.array([1, 2])
    many, other = (Ensemble(BODY, [STATE], "rk4", 0.002) for _ in range(2))
    many.hold(torque_body=torque)
    other.hold(torque_body=torque.copy())
    torque[:] = 5.0
    many.advance(0.01)
    other.advance(0.01)
    assert rows(many.samples()) == rows(other.samples())

    torques = np.full((2, 3), 0.1)
    many.follow(many.time_ns + times, torque_body=torques)
    other.follow(other.time_ns + times, torque_body=torques.copy())
    torques[:] = 5.0
    many.advance(0.01)
    other.advance(0.01)
    assert rows(many.samples()) == rows(other.samples())


@needs_numba
def test_one_edge_does_not_wait_for_the_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By `exact`, which takes it longest."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    one_by_one = Mover(METHODS["exact"])._one_by_one
    assert one_by_one is not None

    assert one_by_one.get(1, 1) is None


@pytest.mark.parametrize("force", [(0.0, 0.0, 0.0), (1.0, 2.0, -9.8)])
@pytest.mark.usefixtures("_compile")
def test_exact_takes_a_force_in_the_world_in_one_step(force: tuple[float, float, float]) -> None:
    times = [10**9, 3 * 10**9]
    alone = Alone(BODY, STATE, "exact", 1.0)
    expected = []
    for time_ns in times:
        alone.hold(HeldWrench(force_world=force))
        expected.append(row(alone.sample_at(time_ns)))

    assert rows(driven(BODY, STATE, times, method="exact", force_world=force)) == expected


def test_each_body_has_a_largest_torque_of_its_own() -> None:
    large, small = (RigidBody.from_principal(m, [m, m, m], (0.0, 0.0, 0.0, 1.0)) for m in (1.0, 1e-6))
    many = Ensemble([large, small], [State(0), State(0)], "rk4", 0.01)
    many.hold(torque_body=[[1e9, 0.0, 0.0], [0.0, 0.0, 0.0]])

    with pytest.raises(WrenchError, match=r"body 1: wrench torque about the centre of mass is 1e\+09 N m"):
        many.hold(torque_body=[[0.0, 0.0, 0.0], [1e9, 0.0, 0.0]])


def test_times_whose_difference_64_bits_do_not_hold_do_not_go_back() -> None:
    with pytest.raises(ValueError, match="time only grows"):
        driven(RigidBody.from_diagonal(1.0, (1.0, 1.2, 1.5)), State(), [2**62 + 5, -(2**62) - 10], method="exact")


def test_times_beyond_64_bits_are_shown_as_given() -> None:
    """Unsigned ones were shown negative."""
    with pytest.raises(ValueError, match=rf"the largest of times_ns is {2**63 + 5}"):
        Ensemble(BODY, [STATE], "rk4", 0.002).follow(np.array([1, 2**63 + 5], dtype=np.uint64))
