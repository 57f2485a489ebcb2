"""The loop: timing and order of events, and that observers do not change the motion."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Iterator, Mapping
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motions import Recorder, forced, scene

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import ConvergenceError, SceneError, WrenchError
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.loads.wrench_channels import AppliedWrench, Channel
from rb_dynamics.loads.wrench_command_arrays import Wrenches
from rb_dynamics.numerics.vector import ZERO
from rb_dynamics.run.posting import LOOK_AHEAD
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.simulate import simulate
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.run.sink import Event, RunInfo
from rb_dynamics.run.state_change import StateChange
from rb_dynamics.scene import parse_scene
from rb_dynamics.scene.model import Scene, Solver
from rb_dynamics.sinks.memory_sink import MemorySink

SECOND = 1_000_000_000
END = 2 * SECOND

CHANNELS = (Channel("body", timeout=0.7), Channel("world"))
# On and off every grid, two at one time, one at the very end and one at 0.
COMMANDS = [
    ("body", Wrench((0.9, -0.4, 0.6), (0.3, -0.2, 0.25), "body", 0)),
    ("world", Wrench((-0.5, 0.8, 0.3), (0.2, 0.35, -0.3), "world", 123_456_789)),
    ("body", Wrench((-0.9, 0.4, 0.0), (-0.3, 0.2, 0.1), "", 500_000_000)),
    ("world", Wrench((0.5, -0.8, 0.3), (-0.2, 0.0, 0.3), "world", 500_000_000)),
    ("world", Wrench((0.1, 0.0, 0.0), ZERO, "world", 1_000_000_001)),
    ("body", Wrench((0.1, 0.0, 0.0), ZERO, "body", END)),
]
SOLVERS = {
    "whole step": Solver("rkmk4", step=0.02, accuracy=None),
    "step of no whole ns": Solver("rkmk4", step=1.0 / 30.0, accuracy=None),
    "accuracy": Solver("rkmk4", accuracy=1e-6),
    "midpoint": Solver("midpoint", step=0.03, accuracy=None),
}

RUBBED_WHEEL = parse_scene(
    """
body: {mass: 1, inertia: {diagonal: [0.1, 0.2, 0.3]}}
initial: {angular_velocity_body: [0.3, -0.2, 3]}
actuators: [{type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 0.01, friction: {coulomb: 0.01}, speed: 0.2}]
effects: [{type: linear_drag, rotation: 0.01}]
"""
)

each_solver = pytest.mark.parametrize("solver", SOLVERS.values(), ids=list(SOLVERS))


def driven(solver: Solver, output_rate: float = 100.0, duration: float | None = 2.0) -> Scene:
    return scene(forced().body, forced().initial, solver, duration, output_rate, CHANNELS)


def _stamp(command: tuple[str, Wrench]) -> int:
    return command[1].stamp_ns


def record(solver: Solver, output_rate: float) -> tuple[Sample, int, Recorder]:
    recorder = Recorder()
    run = simulate(driven(solver, output_rate), COMMANDS, [recorder])
    return run.sample, run.steps, recorder


WHEEL_AND_JET = """
body: {mass: 4, inertia: {diagonal: [0.05, 0.12, 0.14]}, frames: {jet: {position: [0.1, 0.15, 0.05]}}}
initial: {angular_velocity_body: [0.1, -0.15, 0.05]}
actuators:
  - {type: reaction_wheel, name: wheel, axis: [0, 1, 0], inertia: 1.0e-4, command: speed, max_torque: 5.0e-3}
  - {type: thruster, name: jet, frame: jet, force: 0.5, command: on_time, rise: 0.01, fall: 0.02}
output_rate: 50.0
duration: 2
"""


class TestBits:
    @each_solver
    def test_do_not_depend_on_the_output_rate(self, solver: Solver) -> None:
        by_rate = {rate: record(solver, rate) for rate in (0.0, 1.0, 10.0, 100.0, 333.3, 30.0)}

        finest: Mapping[int, Sample] = {s.time_ns: s for s in by_rate[100.0][2].samples}
        reference, steps, _ = by_rate[100.0]
        for rate, (sample, count, recorder) in by_rate.items():
            assert sample == reference, rate
            assert count == steps, rate
            shared = [s for s in recorder.samples if s.time_ns in finest]
            assert len(shared) >= 2, rate
            assert all(s == finest[s.time_ns] for s in shared), rate

    @each_solver
    @pytest.mark.parametrize("output_rate", [0.0, 10.0, 333.3])
    @given(pieces=st.lists(st.integers(0, END) | st.sampled_from([w.stamp_ns for _, w in COMMANDS]), max_size=10))
    @settings(max_examples=6)
    def test_do_not_depend_on_how_advance_is_called(
        self, solver: Solver, output_rate: float, pieces: list[int]
    ) -> None:
        whole, split = Recorder(), Recorder()
        for recorder, ends in ((whole, []), (split, sorted(pieces))):
            run = Simulation(driven(solver, output_rate), [recorder])
            for topic, wrench in COMMANDS:
                run.post(topic, wrench, wrench.stamp_ns)
            run.start()
            for end in [*ends, END]:
                run.advance(end)
            run.finish()

        assert split.events == whole.events
        assert split.result == whole.result

    @pytest.mark.parametrize("scene", [*map(driven, SOLVERS.values()), RUBBED_WHEEL], ids=[*SOLVERS, "wheel"])
    def test_do_not_depend_on_when_it_was_enough(self, scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
        # A kernel takes many strides in one call.
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
        whole, split = Recorder(), Recorder()
        calls = 0
        for recorder in (whole, split):
            run = Simulation(scene, [recorder])
            for topic, wrench in COMMANDS:
                if scene.actuators:
                    run.actuate("wheel/command", wrench.force[0], wrench.stamp_ns)
                else:
                    run.post(topic, wrench, wrench.stamp_ns)
            run.start()
            run.advance(END, None if recorder is whole else lambda: True)
            while run.computed_ns < END:
                before_ns = run.computed_ns
                run.advance(END, lambda: True)
                assert run.computed_ns > before_ns
                # A run that ends here has in its log what made the edge.
                assert (change := run._next_change_ns()) is None or change > run.time_ns
                calls += 1
            run.finish()

        assert calls >= int(whole.result["steps"])
        assert split.events == whole.events
        assert split.result == whole.result

    @pytest.mark.parametrize("strides", [1, 6, 12])
    def test_do_not_depend_on_whether_a_command_was_known_when_a_wheel_is_searched_for_a_switch(
        self, strides: int
    ) -> None:
        """As of a node, whose commands come between two bursts of strides; `replay` knows them from the start."""
        text = """
        body: {mass: 10, inertia: {diagonal: [0.05, 0.12, 0.14]}}
        initial: {angular_velocity_body: [0.3, 0.6, -0.3]}
        wrenches: []
        actuators:
          - {type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 1.0e-4, max_torque: 5.0e-3,
             friction: {coulomb: 1.0e-5, viscous: 1.0e-7}}
        duration: 8
        output_rate: 10
        """
        came, known = Simulation(parse_scene(text)), Simulation(parse_scene(text))
        came.start()
        for _ in range(strides):
            came.advance(7 * SECOND, lambda: True)
        now_ns = came.computed_ns
        came.actuate("wheel/command", 1e-3)
        known.start()
        known.actuate("wheel/command", 1e-3, now_ns)
        for run in (came, known):
            run.advance(8 * SECOND)

        assert came.phase == known.phase

    @each_solver
    def test_do_not_depend_on_when_a_command_arrives_before_its_time(self, solver: Solver) -> None:
        early = record(solver, 0.0)[0]

        run = Simulation(driven(solver, 0.0))
        waiting = sorted(COMMANDS, key=lambda c: c[1].stamp_ns)
        for topic, wrench in waiting:
            run.advance(wrench.stamp_ns - 1)
            run.post(topic, wrench, wrench.stamp_ns)
        run.advance(END)

        assert run.sample == early

    def test_the_same_run_twice(self) -> None:
        first, second = (record(SOLVERS["accuracy"], 100.0) for _ in range(2))

        assert first[2].events == second[2].events
        assert first[2].result == second[2].result


class TestOutputs:
    @pytest.mark.parametrize("rate", [30.0, 100.0, 333.3, 7.0, 59.94, 1000.0, 0.1])
    def test_fall_on_the_nearest_nanosecond(self, rate: float) -> None:
        """k / rate, rounded to the nearest nanosecond; rounding does not accumulate."""
        recorder = Recorder()
        still = scene(RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0)), State(), Solver(step=1.0), 2.0, rate)
        simulate(still, (), [recorder])

        expected = [
            math.floor(k * SECOND / Fraction(repr(rate)) + Fraction(1, 2)) for k in range(math.floor(2 * rate) + 1)
        ]
        times = [s.time_ns for s in recorder.samples]
        assert times == [*expected, *([END] if expected[-1] != END else [])]
        assert len(set(times)) == len(times)

    @pytest.mark.parametrize(
        ("rate", "expected"),
        [(30.0, 33_333_333_333_333), (333.3, 3_000_300_030_003), (1e3, 10**12), (0.1, 10**16)],
    )
    def test_are_exact_after_a_million(self, rate: float, expected: int) -> None:
        run = Simulation(driven(SOLVERS["whole step"], rate, None))
        run._outputs = 1_000_000

        assert run.next_output_ns() == expected

    def test_rate_zero_is_every_step_and_every_change(self) -> None:
        recorder = Recorder()
        simulate(driven(Solver("rk4", step=0.25), 0.0), COMMANDS, [recorder])

        times = [s.time_ns for s in recorder.samples]
        # From each change on, steps are counted anew: at 0.7 s a timeout would fall, were it not renewed at 0.5 s.
        expected = [0, 123_456_789, 373_456_789, 500_000_000, 750_000_000]
        assert times[:5] == expected
        assert times[5:] == [
            1_000_000_000,
            1_000_000_001,
            1_200_000_000,
            1_450_000_000,
            1_700_000_000,
            1_950_000_000,
            END,
        ]

    def test_the_end_is_always_told_once(self) -> None:
        for rate in (0.0, 0.3, 1.0, 3.0, 100.0):
            recorder = Recorder()
            simulate(driven(SOLVERS["whole step"], rate), COMMANDS, [recorder])
            assert [s.time_ns for s in recorder.samples].count(END) == 1
            assert recorder.samples[0].time_ns == 0

    def test_times_never_decrease(self) -> None:
        recorder = record(SOLVERS["step of no whole ns"], 333.3)[2]

        times = [event.time_ns for event in recorder.events]
        assert times == sorted(times)


class TestCommands:
    def test_take_effect_at_their_stamp(self) -> None:
        """v = F t / m from the stamp on, to the nanosecond, off every grid."""
        body = RigidBody.from_diagonal(2.0, (1.0, 1.0, 1.0))
        stamp = 333_333_337
        commands = [("wrench", Wrench((4.0, 0.0, 0.0), ZERO, "world", stamp))]

        run = simulate(scene(body, State(), Solver(step=0.1), 1.0), commands)

        held = (SECOND - stamp) / SECOND
        assert run.sample.linear_velocity_world[0] == pytest.approx(2.0 * held, rel=1e-15)
        assert run.sample.position_world[0] == pytest.approx(held**2, rel=1e-15)

    def test_are_told_with_the_state_they_find(self) -> None:
        recorder = record(SOLVERS["whole step"], 10.0)[2]

        at_half = [event for event in recorder.events if event.time_ns == 500_000_000]
        assert [type(event) for event in at_half] == [Sample, AppliedWrench, AppliedWrench]
        applied = [event for event in recorder.events if isinstance(event, AppliedWrench)]
        assert [(a.time_ns, a.topic, a.received is None) for a in applied] == [
            (0, "body", False),
            (123_456_789, "world", False),
            (500_000_000, "body", False),
            (500_000_000, "world", False),
            (1_000_000_001, "world", False),
            (1_200_000_000, "body", True),
            (END, "body", False),
        ]

    def test_of_the_past_take_effect_now(self) -> None:
        run = Simulation(driven(SOLVERS["whole step"]))
        run.advance(SECOND)
        run.post("world", COMMANDS[1][1], 5)
        run.advance(SECOND)
        other = Simulation(driven(SOLVERS["whole step"]))
        other.post("world", COMMANDS[1][1], SECOND)
        other.advance(END)
        run.advance(END)

        assert run.sample == other.sample

    def test_of_the_past_keep_their_order_of_arrival(self) -> None:
        """Both act now, so the last arrival wins regardless of stamps."""
        run = Simulation(driven(SOLVERS["whole step"]))
        run.advance(SECOND)
        for x, stamp in ((1.0, 9), (2.0, 5)):
            run.post("world", Wrench((x, 0.0, 0.0), ZERO, "world"), stamp)
        run.advance(END)
        other = Simulation(driven(SOLVERS["whole step"]))
        other.post("world", Wrench((2.0, 0.0, 0.0), ZERO, "world"), SECOND)
        other.advance(END)

        assert run.sample == other.sample

    def test_of_one_time_the_last_wins(self) -> None:
        once = [("world", Wrench((1.0, 0.0, 0.0), ZERO, "world", 7))]
        thrice = [("world", Wrench((float(x), 0.0, 0.0), (0.0, float(x), 0.0), "world", 7)) for x in (5, 9)] + once

        assert (
            simulate(driven(SOLVERS["whole step"]), thrice).sample
            == simulate(driven(SOLVERS["whole step"]), once).sample
        )

    def test_after_the_end_have_no_effect(self) -> None:
        late = [*COMMANDS, ("world", Wrench((1e3, 0.0, 0.0), ZERO, "world", END + 1))]

        assert simulate(driven(SOLVERS["whole step"]), late).sample == record(SOLVERS["whole step"], 100.0)[0]

    @pytest.mark.parametrize("ahead", [1, 2, 1000])
    def test_may_come_as_an_iterator_in_order_or_as_a_sequence_in_any(
        self, ahead: int, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        for name in ("LOOK_AHEAD", "_AT_ONCE"):
            monkeypatch.setattr(sys.modules["rb_dynamics.run.posting"], name, ahead)
        unknown = ("body", Wrench(frame_id="nowhere", stamp_ns=123_456_789))
        late = ("world", Wrench(frame_id="nowhere", stamp_ns=END + 1))
        told = []
        for posted in (sorted([*COMMANDS, unknown, late], key=_stamp), [late, unknown, *reversed(COMMANDS)]):
            for commands in (posted, iter(sorted(posted, key=_stamp))):
                recorder = Recorder()
                run = simulate(driven(SOLVERS["accuracy"]), commands, [recorder])
                told.append((recorder.events, recorder.result, run.sample, run.steps, run.rejected))

        assert len(told[0][-1]) == 2
        assert all(each == told[0] for each in told)

    @pytest.mark.parametrize("at_once", [1, 3, 1000])
    def test_as_arrays_give_the_bits_of_single_ones(self, at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
        """In any order, of the past, for after the end, not finite, in a frame or on a channel that is not there."""
        monkeypatch.setattr(sys.modules["rb_dynamics.run.posting"], "_AT_ONCE", at_once)
        random = np.random.default_rng(3)
        times = np.append(random.permutation(17) * 100_000_000, [-5, 500_000_000, END, END + 1])
        forces = random.normal(size=(len(times), 3))
        forces[[2, -1]] = math.nan
        arrays = [
            ("body", Wrenches(forces, (0.0, 0.1, 0.0), "body", times)),
            ("world", Wrenches(torque=0.1 * forces, frame_id="world", stamp_ns=times + 1)),
            ("body", Wrenches(forces[:2], frame_id="nowhere", stamp_ns=times[:2])),
            ("nobody", Wrenches(forces[:2], stamp_ns=times[:2])),
        ]
        each, told = [(topic, wrench) for topic, wrenches in arrays for wrench in wrenches], []
        for commands in (arrays, each, iter(sorted(each, key=_stamp))):
            recorder = Recorder()
            run = simulate(driven(SOLVERS["accuracy"]), commands, [recorder])
            # As text, in which NaN is NaN.
            told.append((recorder.events, str(recorder.events), run.sample, run.steps, sorted(run.rejected)))

        assert [each[1:] == told[0][1:] for each in told] == 3 * [True]
        assert len(told[0][-1]) == 8
        assert sum(isinstance(event, AppliedWrench) for event in told[0][0]) > 30

    def test_are_read_as_the_run_goes_on(self) -> None:
        read = [0]

        def endless() -> Iterator[tuple[str, Wrench]]:
            for k in range(5 * LOOK_AHEAD):
                read[0] += 1
                yield "world", Wrench((1.0, 0.0, 0.0), ZERO, "world", k * END // (5 * LOOK_AHEAD))

        waiting: list[int] = []

        class Watch(Recorder):
            def write(self, event: Event) -> None:
                super().write(event)
                if isinstance(event, AppliedWrench):
                    waiting.append(read[0] - 1 - len(waiting))

        simulate(driven(SOLVERS["whole step"], 1.0), endless(), [Watch()])

        assert read[0] == len(waiting) == 5 * LOOK_AHEAD
        assert max(waiting) <= LOOK_AHEAD

    def test_out_of_order_and_too_late_are_refused(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(sys.modules["rb_dynamics.run.posting"], "LOOK_AHEAD", 1)

        with pytest.raises(ValueError, match="found one at 5 ns when the run had reached 123456789 ns"):
            simulate(driven(SOLVERS["whole step"]), iter([*COMMANDS[:3], ("world", Wrench(stamp_ns=5))]))

    def test_that_cannot_be_honoured_leave_the_run_as_it_is(self) -> None:
        run = Simulation(driven(SOLVERS["whole step"]))
        for bad in (Wrench((math.nan, 0.0, 0.0)), Wrench(frame_id="nowhere")):
            for time_ns in (0, 123_456_789, SECOND):
                with pytest.raises(WrenchError):
                    run.post("body", bad, time_ns)
        with pytest.raises(WrenchError, match="wrench topic is 'wrench'"):
            run.post("wrench", Wrench())
        run.advance(END)

        assert run.sample == simulate(driven(SOLVERS["whole step"])).sample

    def test_a_pulse_of_one_nanosecond_counts(self) -> None:
        body = RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0))
        pulse = [
            ("wrench", Wrench((1e9, 0.0, 0.0), ZERO, "world", 500_000_000)),
            ("wrench", Wrench(ZERO, ZERO, "world", 500_000_001)),
        ]

        run = simulate(scene(body, State(), Solver(step=0.1), 1.0), pulse)

        assert run.sample.linear_velocity_world[0] == pytest.approx(1.0, rel=1e-15)
        assert run.sample.position_world[0] == pytest.approx(0.5 - 0.5e-9, rel=1e-12)


class TestTime:
    def test_a_step_of_no_whole_nanosecond_carries_its_remainder(self) -> None:
        run = simulate(scene(forced().body, forced().initial, Solver("rk4", step=1.0 / 3e3), 1.0, 1.0))

        assert run.steps == math.ceil(1 / Fraction(repr(1.0 / 3e3)))

    def test_advance_stops_at_the_last_edge(self) -> None:
        run = Simulation(driven(SOLVERS["whole step"], 10.0))
        run.advance(199_999_999)

        assert run.time_ns == 100_000_000
        run.advance(10**18)
        assert run.time_ns == END
        assert run.ended

    def test_without_a_duration_it_runs_until_stopped(self) -> None:
        run = Simulation(driven(SOLVERS["whole step"], 1.0, None))
        run.advance(5 * SECOND)

        assert run.time_ns == 5 * SECOND
        assert not run.ended

    def test_no_duration_at_all(self) -> None:
        recorder = Recorder()
        run = simulate(driven(SOLVERS["whole step"], 100.0, 0.0), COMMANDS, [recorder])

        assert [s.time_ns for s in recorder.samples] == [0]
        assert run.steps == 0

    @pytest.mark.parametrize("number", [float, np.float64, np.float32, int])
    def test_numbers_of_any_kind_will_do(self, number: type) -> None:
        one = dataclasses.replace(driven(Solver("rk4", step=number(1))), duration=number(2), output_rate=number(1))

        assert simulate(one, COMMANDS).sample == simulate(driven(Solver("rk4", step=1.0), 1.0), COMMANDS).sample


class TestRefusal:
    def test_simulate_needs_an_end(self) -> None:
        with pytest.raises(SceneError, match="duration: found nothing, expected the length"):
            simulate(driven(SOLVERS["whole step"], duration=None))

    @pytest.mark.parametrize("bad", [0.0, -0.1, math.nan, math.inf])
    def test_what_would_never_end_is_refused(self, bad: float) -> None:
        for step in (bad, 5e-324):
            with pytest.raises(SceneError, match=r"solver\.step is"):
                Simulation(driven(Solver("rk4", step=step)))
        with pytest.raises(SceneError, match=r"solver\.accuracy is"):
            Simulation(driven(Solver("rk4", accuracy=bad)))

    @pytest.mark.parametrize("bad", [-1.0, math.nan, math.inf, 1e300])
    def test_rate_and_duration_are_checked(self, bad: float) -> None:
        with pytest.raises(SceneError, match="output_rate is"):
            Simulation(driven(SOLVERS["whole step"], bad))
        with pytest.raises(SceneError, match="duration is"):
            Simulation(driven(SOLVERS["whole step"], duration=bad))

    def test_an_unknown_method_is_named_with_the_known_ones(self) -> None:
        with pytest.raises(SceneError, match=r"solver\.method is 'rk5', expected auto or one of .*rk4"):
            Simulation(driven(Solver("rk5", step=0.1)))


class TestFailure:
    """A torque that spins the body up until a step of 10 ms turns it too far, some 13 s later."""

    def spun_up(self) -> tuple[Simulation, Recorder]:
        recorder = Recorder()
        run = Simulation(scene(forced().body, State(), Solver("rkmk4", step=0.01), 100.0, 1.0), [recorder])
        run.post("wrench", Wrench(ZERO, (100.0, 0.0, 0.0), "body"))
        run.start()
        with pytest.raises(ConvergenceError, match="expected less than 3 rad"):
            run.advance(100 * SECOND)
        return run, recorder

    def test_stands_at_the_last_good_state(self) -> None:
        run, recorder = self.spun_up()

        assert run.time_ns == recorder.samples[-1].time_ns > SECOND
        assert run.sample == recorder.samples[-1]

    def test_goes_on_where_the_cause_is_taken_away(self) -> None:
        run, _ = self.spun_up()
        stopped = run.sample

        run.post("wrench", Wrench(ZERO, ZERO, "body"))
        run.advance(run.time_ns + SECOND)

        assert run.time_ns == stopped.time_ns + SECOND
        assert math.isfinite(run.sample.kinetic_energy)
        assert run.sample.kinetic_energy == pytest.approx(stopped.kinetic_energy, rel=0.05)

    def test_goes_on_with_the_bits_of_a_run_that_never_failed(self) -> None:
        """Between two outputs, from the time up to which the motion was computed when it failed."""
        run, never = (Simulation(driven(Solver("rkmk4", step=1e-3), 1.0)) for _ in range(2))
        for each in (run, never):
            each.post("world", Wrench(ZERO, (1.4e4, 0.0, 0.0), "body"))
        run.advance(400_000_000)
        with pytest.raises(ConvergenceError, match="expected less than 3 rad"):
            run.advance(SECOND)
        assert run.computed_ns == 400_000_000
        for each in (run, never):
            each.post("world", Wrench(), 400_000_000)
            each.advance(SECOND)
        assert run.sample == never.sample

    def test_the_sinks_are_closed(self) -> None:
        recorder = Recorder()
        spun = scene(forced().body, State(), Solver("rkmk4", step=0.01), 100.0, 1.0)
        with pytest.raises(ConvergenceError):
            simulate(spun, [("wrench", Wrench(ZERO, (100.0, 0.0, 0.0), "body"))], [recorder])

        assert recorder.result is not None
        assert recorder.result["end_time_ns"] == str(recorder.samples[-1].time_ns)


class TestSinks:
    def test_each_is_told_the_same(self) -> None:
        first, second = Recorder(), Recorder()
        simulate(driven(SOLVERS["whole step"]), COMMANDS, [first, second])

        assert first.events == second.events
        assert first.run is second.run
        assert first.run is not None
        assert first.run.method == "rkmk4"
        assert first.result is not None
        assert {"steps", "end_time_ns", "inputs_sha256"} <= set(first.result)

    def test_one_that_fails_to_close_does_not_keep_the_others_open(self) -> None:
        class Broken(Recorder):
            def close(self, result: Mapping[str, str]) -> None:
                raise OSError("disk full")

        whole = [Recorder(), Recorder()]
        with pytest.raises(OSError, match="disk full"):
            simulate(driven(SOLVERS["whole step"], 1.0), (), [whole[0], Broken(), whole[1]])

        assert all(recorder.result is not None for recorder in whole)

    def test_one_that_fails_to_open_is_heard(self) -> None:
        class Broken(Recorder):
            def open(self, run: RunInfo) -> None:
                raise OSError("no such folder")

        with pytest.raises(OSError, match="no such folder"):
            simulate(driven(SOLVERS["whole step"]), (), [Broken()])

    def test_the_inputs_have_a_hash_of_their_own(self) -> None:
        def inputs(commands: list[tuple[str, Wrench]]) -> str:
            recorder = Recorder()
            simulate(driven(SOLVERS["whole step"], 1.0), commands, [recorder])
            assert recorder.result is not None
            return recorder.result["inputs_sha256"]

        changed = [("body", dataclasses.replace(COMMANDS[0][1], force=(0.9, -0.4, 0.6000000000000001))), *COMMANDS[1:]]
        assert inputs(COMMANDS) == inputs(list(COMMANDS))
        assert inputs(COMMANDS) != inputs(changed)
        assert inputs(COMMANDS) != inputs(COMMANDS[1:])

    def test_progress_ends_at_one(self) -> None:
        told: list[float] = []
        simulate(driven(SOLVERS["whole step"], 1.0), (), progress=told.append)

        assert told == sorted(told)
        assert told[-1] == 1.0


def test_what_a_run_returns() -> None:
    recorder = Recorder()
    run = simulate(driven(SOLVERS["midpoint"]), COMMANDS, [recorder])

    assert run.sample == recorder.samples[-1]
    assert run.method == "midpoint"
    assert recorder.result is not None
    assert run.steps == int(recorder.result["steps"])
    assert run.wall_time_s > 0.0
    events: list[Event] = recorder.events
    assert events[0] == recorder.samples[0]


def test_commands_after_the_end_are_not_counted_as_clipped() -> None:
    text = """\
body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}
duration: 1
wrenches: [{topic: push, max_force: 1.0, on_excess: clip}]
actuators: [{type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 0.1, max_torque: 1.0}]
"""
    commands = [("push", Wrench((9.0, 0.0, 0.0), ZERO, "", time_ns)) for time_ns in (SECOND // 2, 2 * SECOND)]
    assert simulate(parse_scene(text), commands).clipped == 1
    run = Simulation(parse_scene(text))
    assert run.actuate("wheel/command", 5.0, 2 * SECOND)
    assert run.clipped == 0
    assert run.actuate("wheel/command", 5.0, SECOND)
    assert run.clipped == 1


def test_a_run_without_end_is_not_stopped_for_what_rounding_would_add_in_an_hour() -> None:
    """The node has no end; short strides, due to commands in quick succession, must not stop it."""
    solver = Solver("auto", accuracy=1e-10)
    run = Simulation(driven(solver, duration=None))
    run.start()
    for k in range(40):
        torque = (0.3 * (-1.0) ** k, 0.2, 0.1 * k)
        run.post("body", Wrench(torque=torque, stamp_ns=k * 1_700_000), k * 1_700_000)
    run.advance(100_000_000)

    assert run.time_ns == 100_000_000
    with pytest.raises(ConvergenceError, match="rounding alone"):
        simulate(driven(solver, duration=3600.0), [("body", Wrench(torque=(0.3, 0.2, 0.1)))])


class TestTooLarge:
    """A command that cannot be integrated is rejected without any other effect."""

    GOOD = ("body", Wrench((1.0, 0.0, 0.0), (0.0, 0.1, 0.02), "body", 100_000_000))
    # The last is possible as a wrench, but not with steps of 20 ms.
    BAD = (
        Wrench((0.0, 1e308, 0.0), stamp_ns=300_000_000),
        Wrench((1e200, 0.0, 0.0), frame_id="world", stamp_ns=300_000_000),
        Wrench(torque=(1e15, 0.0, 1.0), stamp_ns=300_000_000),
        Wrench(torque=(1e8, 1e8, 2e8), stamp_ns=305_000_000),
    )

    @pytest.mark.parametrize("bad", BAD, ids=["1e308 N", "1e200 N", "1e15 N m", "1e8 N m"])
    def test_leaves_no_trace_and_is_named(self, bad: Wrench) -> None:
        solver = SOLVERS["whole step"]
        good = ("world", dataclasses.replace(self.GOOD[1], stamp_ns=bad.stamp_ns))
        without, told = MemorySink(), MemorySink()
        expected = simulate(driven(solver), [self.GOOD, good], [without])
        run = simulate(driven(solver), [self.GOOD, good, ("body", bad)], [told])

        assert run.sample == expected.sample
        assert run.steps == expected.steps
        assert told.samples == without.samples
        assert told.applied == without.applied
        assert [(each.time_ns, each.received) for each in told.rejected] == [(bad.stamp_ns, bad)]
        [said] = run.rejected
        assert said.startswith(f"body at simulation time {bad.stamp_ns / 1e9:.9f} s: ")
        assert expected.rejected == ()
        # Nobody listens, nothing is output, and the same is said.
        assert simulate(driven(solver, 0.0), [self.GOOD, good, ("body", bad)]).rejected == run.rejected

    def test_where_a_step_is_too_long_for_a_wrench_that_is_possible_that_is_an_error(self) -> None:
        with pytest.raises(ConvergenceError, match=r"rkmk4: a step of 0.02 s turns the body by"):
            simulate(driven(SOLVERS["whole step"]), [("body", Wrench(torque=(1e4, 1e4, 0.0)))])


FELL = "body: {mass: 10, inertia: {diagonal: [0.05, 0.12, 0.14]}}\nwrenches: []\nduration: 600\n"
ORBIT = (
    f"{FELL}initial: {{position_world: [7e6, 0, 0], linear_velocity_world: [0, 7e3, 0]}}\n"
    "effects: [{type: central_gravity, gravitational_parameter: 4e14}]\n"
)
SPUN = f"{FELL}initial: {{angular_velocity_body: [0.1, 0.2, 0.3]}}\n"
DRAG = f"{SPUN}effects: [{{type: linear_drag, translation: 0.1, rotation: 0.001}}]\n"
WHEEL = (
    f"{SPUN}actuators: [{{type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 1e-3,"
    " friction: {coulomb: 1e-4}}]\n"
    "solver: {method: dop853, step: 0.02}\n"
)


class TestStateThatNothingFollows:
    """A change of state after which no step can be taken is refused without any trace."""

    GLITCH = State(angular_velocity_body=(1e9, 3e8, 0.0))

    @pytest.mark.parametrize(
        ("text", "bad"),
        [
            (ORBIT, State()),
            (f"{ORBIT}solver: {{method: rk4, step: 0.5}}\n", State()),
            (DRAG, dataclasses.replace(GLITCH, angular_velocity_body=(1e6, 0.0, 0.0))),
            (DRAG, GLITCH),
            (SPUN, GLITCH),
            (WHEEL, GLITCH),
        ],
        ids=["at the centre", "at the centre by steps", "drag", "faster under drag", "closed form", "wheel"],
    )
    @pytest.mark.parametrize("ahead_ns", [0, 77_777_777])
    def test_leaves_no_trace_and_a_later_one_acts(self, text: str, bad: State, ahead_ns: int) -> None:
        def flown(*moves: State) -> tuple[Simulation, Recorder]:
            recorder = Recorder()
            run = Simulation(parse_scene(text), [recorder])
            run.start()
            if run.scene.actuators:
                run.actuate("wheel/command", 0.01)
            run.advance(123_456_789)
            for move in moves:
                run.set_state(StateChange.to(move, run.scene.body).at(123_456_789 + ahead_ns))
            run.advance(SECOND)
            return run, recorder

        good = State(position_world=(7e6, 0.0, 0.0), angular_velocity_body=(0.5, 0.1, 0.0))
        for before, after in (((), ()), ((), (good,)), ((good,), ())):
            expected, told = flown(*before, *after)
            run, recorder = flown(*before, bad, *after)
            [(refused, reason)] = run.refused
            assert (refused.time_ns, refused.state.position_world) == (123_456_789 + ahead_ns, bad.position_world)
            assert reason.startswith("the motion cannot continue from there: ")
            assert recorder.events == told.events
            run.finish()
            expected.finish()
            assert recorder.result == told.result

    @pytest.mark.parametrize("at_ns", [183_000_001, 930_000_010])
    def test_comes_to_the_same_bits_with_a_command_of_its_time_or_after_it(self, at_ns: int) -> None:
        """Replay of a node's log differed: after a move, loads that change had a step control of their own."""

        def flown(apart: bool) -> MemorySink:
            recorded = MemorySink()
            run = Simulation(parse_scene(WHEEL_AND_JET), [recorded])
            run.start()
            run.advance(at_ns)
            run.actuate("wheel/command", 38.7, at_ns)
            if apart:
                run.advance(at_ns)
            run.set_state(StateChange.to(State(angular_velocity_body=(-0.4, 0.3, -0.13)), run.scene.body).at(at_ns))
            run.advance(at_ns + 100_000_000)
            run.actuate("jet/command", 0.13, at_ns + 100_000_000)
            run.advance(2 * SECOND)
            run.finish()
            return recorded

        together, apart = flown(apart=False), flown(apart=True)
        assert together.angular_velocity_body.tolist() == apart.angular_velocity_body.tolist()

    def test_is_refused_at_once_by_name_and_foreseen(self) -> None:
        run = Simulation(parse_scene(DRAG))
        run.advance(123_456_789)
        before = run.look()
        bad, good = (
            StateChange.to(State(angular_velocity_body=rate), run.scene.body)
            for rate in ((1e6, 0.0, 0.0), (1.0, 0.0, 0.0))
        )
        assert "accuracy 1e-09 cannot be kept: at 1e+06 rad/s" in run.hindrance(bad)
        assert run.hindrance() == run.hindrance(good) == ""
        with pytest.raises(ConvergenceError, match=r"cannot continue from there: accuracy 1e-09 .* at 1e\+06 rad/s"):
            run.move(bad)
        assert (run.look(), run.refused) == (before, [])
        run.move(good)
        assert run.look().angular_velocity_body == (1.0, 0.0, 0.0)
        assert run.time_ns == 123_456_789

    @pytest.mark.parametrize(
        ("text", "rate", "reason"),
        [
            (SPUN, 1e6, "accuracy 1e-09 cannot be kept: in closed form too, rounding alone adds"),
            (SPUN.replace("duration: 600\n", ""), 1e12, "no digit of the attitude is known"),
        ],
        ids=["accuracy at the end", "attitude within an hour"],
    )
    def test_free_motion_is_foreseen_to_the_end(self, text: str, rate: float, reason: str) -> None:
        """A rate was accepted that stopped the run seconds later, which no command had caused."""
        bad = State(angular_velocity_body=(rate, 0.2 * rate, 0.0))
        run = Simulation(parse_scene(text))
        run.advance(SECOND)
        assert reason in run.hindrance(StateChange.to(bad, run.scene.body))
        run.set_state(StateChange.to(bad, run.scene.body).at(2 * SECOND))
        run.advance(3 * SECOND)
        [(_, told)] = run.refused
        assert reason in told
        assert reason in Simulation(dataclasses.replace(run.scene, initial=bad, text="")).hindrance()

    def test_what_is_known_to_come_ends_what_is_foreseen_of_free_motion(self) -> None:
        text = SPUN.replace("wrenches: []", "wrenches: [{topic: wrench}]")
        fast = State(angular_velocity_body=(1e5, 2e5, 0.0))
        for commands in (0, 1):
            run = Simulation(parse_scene(text))
            run.move(StateChange.to(State(angular_velocity_body=(1.0, 2.0, 0.0)), run.scene.body))
            for _ in range(commands):
                run.post("wrench", Wrench(force=(1.0, 0.0, 0.0)), 2 * SECOND)
            assert bool(run.hindrance(StateChange.to(fast, run.scene.body))) == (not commands)

    def test_a_change_now_frees_a_motion_that_cannot_continue(self) -> None:
        text = SPUN.replace("wrenches: []", "wrenches: [{topic: wrench}]").replace("0.1, 0.2", "1e5, 2e5")
        text = text.replace("duration: 600", "duration: 10")
        run = Simulation(parse_scene(text))
        # The accuracy can be kept in closed form only.
        run.post("wrench", Wrench(torque=(0.1, 0.2, 0.1)), SECOND)
        for _ in range(2):
            with pytest.raises(ConvergenceError, match="rounding alone"):
                run.advance(2 * SECOND)
        assert "rounding alone" in run.hindrance()
        run.post("wrench", Wrench())
        run.advance(2 * SECOND)
        assert (run.hindrance(), run.sample.time_ns) == ("", 2 * SECOND)


def test_steps_are_those_to_the_last_edge_however_far_was_computed() -> None:
    scene = parse_scene(
        "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: wrench}]\n"
        "solver: {method: rk4, step: 0.01}\noutput_rate: 2\n"
    )
    run = Simulation(scene)
    run.post("wrench", Wrench(torque=(0.1, 0.0, 0.0)))
    run.advance(700_000_000)
    assert (run.time_ns, run.steps, run.steps_computed) == (500_000_000, 50, 70)
    run.advance(705_000_000)
    assert (run.time_ns, run.steps, run.steps_computed) == (500_000_000, 50, 71)
    # The grid of the steps begins anew at a command.
    run.post("wrench", Wrench(torque=(0.0, 0.1, 0.0)), 805_000_000)
    run.advance(1_000_000_000)
    assert run.steps == run.steps_computed == 50 + 31 + 20
