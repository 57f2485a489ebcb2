"""What comes gradually: the lag of a channel, the rise and fall of a thruster; books, bits, log and replay."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

import rb_dynamics as rb
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.actuator import Setpoint
from rb_dynamics.loads.wrench import Wrench, WrenchFrames
from rb_dynamics.loads.wrench_channels import AppliedWrench, Channel, WrenchChannels
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.wrench_bags import RecordedWrenches
from rb_dynamics.numerics.rotation import rotate_inverse
from rb_dynamics.run.posting import Command
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study.continued_run import scene_at
from rb_dynamics.study.replay import replay

LAG = 0.05
SCENE = f"""
body: {{mass: 2, inertia: {{matrix: [[0.2, 0.01, 0], [0.01, 0.3, 0.02], [0, 0.02, 0.25]]}}}}
initial: {{angular_velocity_body: [0.1, -0.2, 0.3]}}
wrenches: [{{topic: wrench, lag: {LAG}, timeout: 0.3, delay: 0.01}}, {{topic: other}}]
duration: 6
output_rate: 20
"""
COMMANDS = [
    ("wrench", Wrench((1.0, 0.0, 0.0), (0.0, 0.0, 0.02), "world", 500_000_000)),
    ("other", Wrench((0.0, 0.0, 0.25), stamp_ns=600_000_001)),
    ("wrench", Wrench((0.0, 1.0, 0.0), (0.01, 0.0, 0.0), "body", 650_000_000)),
]


def along_x(t: float) -> float:
    """Return the force in world x at `t`: 1 N is commanded from 0.51 s to 0.66 s."""
    up, down = max(0.0, t - 0.51), max(0.0, t - 0.66)
    return (1.0 - math.exp(-up / LAG)) - (1.0 - math.exp(-down / LAG))


class TestLag:
    def test_what_acts_follows_the_command_in_closed_form(self) -> None:
        scene = rb.parse_scene(SCENE.replace(", timeout: 0.3", ""))
        world = COMMANDS[0][1]
        torque = replace(world, torque=(0.0, 0.0, 0.0))
        run = rb.simulate(scene, [("wrench", torque), ("wrench", Wrench(frame_id="world", stamp_ns=650_000_000))])
        # All of the impulse of 0.15 s, as the 5.3 s after it are 107 time constants; free of the attitude.
        assert run.sample.linear_momentum_world[0] == pytest.approx(0.15, abs=1e-12)
        mid = rb.simulate(replace(scene, duration=0.56), [("wrench", torque)])
        assert mid.sample.linear_momentum_world[0] == pytest.approx(0.05 - LAG * (1 - math.exp(-1.0)), abs=1e-12)

    def test_books_log_and_replay(self, tmp_path: Path) -> None:
        scene, path, sink = rb.parse_scene(SCENE), tmp_path / "run.mcap", rb.MemorySink()
        run = rb.simulate(scene, COMMANDS, [sink, McapSink(path)])
        assert abs(run.sample.energy_defect) < 1e-11
        assert max(map(abs, run.sample.angular_momentum_defect_world)) < 1e-12
        assert max(map(abs, run.sample.linear_momentum_defect_world)) < 1e-15
        # The last transient is over 40 time constants after the timeout: then the motion has a closed form again.
        assert run.method.startswith("exact+")
        on_wrench = [each for each in sink.applied if each.topic == "wrench"]
        sample = {int(t): q for t, q in zip(sink.time_ns, sink.orientation_xyzw, strict=True)}
        for each in on_wrench:
            if each.time_ns in sample and each.time_ns < 660_000_000:
                assert each.frame_id == "world"
                assert each.force[0] == pytest.approx(along_x(each.time_ns / 1e9), abs=1e-15)
            elif each.time_ns in sample:
                # From the axes of the world to those of the body: told in those of the body.
                x = rotate_inverse(tuple(sample[each.time_ns]), (along_x(each.time_ns / 1e9), 0.0, 0.0))
                assert each.frame_id == "body"
                assert each.force[2] == pytest.approx(x[2], abs=1e-15)
        assert [each.time_ns for each in on_wrench if each.timed_out] == [960_000_000]
        assert (on_wrench[-1].time_ns, on_wrench[-1].force) == (2_960_000_000, (0.0, 0.0, 0.0))
        assert replay(path).identical
        assert rb.inspect(path).passed
        bag = read_bag(path)
        assert bag.topics["/wrench"].log_times.tolist() == [500_000_000, 650_000_000]
        again = rb.simulate(scene, RecordedWrenches([path], ["wrench", "other"], start="auto"))
        assert again.sample == run.sample
        # A scene that goes on from within the lag has the bits of the run.
        on = rb.parse_scene(scene_at(path, 700_000_000).text)
        assert rb.simulate(on).sample.orientation_xyzw == run.sample.orientation_xyzw

    def test_neither_outputs_nor_pieces_change_a_bit(self) -> None:
        scene = rb.parse_scene(SCENE)
        whole = rb.simulate(scene, COMMANDS, [rb.MemorySink()]).sample
        assert rb.simulate(replace(scene, output_rate=70.0), COMMANDS, [rb.MemorySink()]).sample == whole
        run = Simulation(scene)
        run.start()
        for topic, wrench in COMMANDS:
            run.post(topic, wrench, wrench.stamp_ns)
        for k in range(1, 101):
            run.advance(k * 60_000_000)
        assert run.sample == whole

    def test_a_lag_far_shorter_than_a_step_is_not_passed_over(self) -> None:
        text = SCENE.replace("duration: 6", "duration: 200").replace("timeout: 0.3, ", "").replace(f"{LAG}", "1.0e-4")
        for method in ("auto", "dop853"):
            scene = rb.parse_scene(text, overrides={"solver": {"method": method, "accuracy": 1e-9}})
            push = Wrench((0.0, 0.0, 1.0), frame_id="world", stamp_ns=100_000_000_000)
            run = rb.simulate(scene, [("wrench", push)])
            expected = 99.99 - 1e-4
            assert run.sample.linear_momentum_world[2] == pytest.approx(expected, rel=1e-11)

    @pytest.mark.parametrize(
        ("lag", "says"), [(-1.0, "lag is -1.0"), (1e-10, "lag is 1e-10"), (math.nan, "lag is nan")]
    )
    def test_what_is_no_lag_is_one_clear_error(self, lag: float, says: str) -> None:
        with pytest.raises(SceneError, match=says):
            Channel("wrench", lag=lag)
        with pytest.raises(SceneError, match=r"lag: found .*, expected a time of 0 or from 1e-09"):
            rb.parse_scene(SCENE, overrides={"wrenches[0].lag": lag})

    def test_a_method_for_held_wrenches_alone_is_refused(self) -> None:
        with pytest.raises(SceneError, match="expected a method that supports wrench/lag"):
            rb.simulate(rb.parse_scene(SCENE, overrides={"solver": {"method": "taylor", "accuracy": 1e-9}}))


def test_a_recording_notes_as_a_timeout_only_what_is_one() -> None:
    """Each edge of a thruster was noted as one, and each command of a log that was converted."""
    pytest.importorskip("rerun")
    from rb_dynamics.sinks.rerun_sink import _told

    c = WrenchChannels([Channel("wrench", timeout=1e-8)], WrenchFrames())
    c.post("wrench", COMMANDS[0][1], 0)
    notes = [_told(each) for time_ns in (0, 10) for each in c.apply(time_ns) if isinstance(each, AppliedWrench)]
    assert notes[1] == "wrench: timed out, drops to zero"
    opened = AppliedWrench(5, "jet", None, "body", (0.5, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert notes[0].startswith("wrench: force (1, 0, 0) N")
    assert _told(opened) == "jet: force (0.5, 0, 0) N, torque (0, 0, 0) N m, in body axes"


JET = """
body: {mass: 4, frames: {jet: {position: [0, 0, 0], orientation: {x: 0, y: 0, z: 0, w: 1}}}}
wrenches: []
actuators: [{type: thruster, name: jet, frame: jet, force: 0.5, command: COMMAND, delay: 0.001,
  rise: 0.004, fall: 0.01}]
duration: 50
output_rate: 100
solver: {method: rk4, step: 1.0}
"""


class TestRiseAndFall:
    def test_the_impulse_of_pulses_is_exact(self) -> None:
        scene = rb.parse_scene(JET.replace("COMMAND", "on_time"))
        # Whole, closed while it rises, and opened while it falls.
        commands = [(1.0, 0.02), (2.0, 0.002), (3.0, 0.01), (3.016, 0.01)]
        run = rb.simulate(scene, [("jet/command", Setpoint(on, round(at * 1e9))) for at, on in commands])
        whole = 0.02 - 0.002 + 0.005
        short = 0.5 * 0.5 * 0.002 + 0.5 * 0.5 * 0.005
        # From 0.4 of its force, 6 ms after the edge, up again.
        twice = (0.002 + 0.006) + 0.5 * (1.0 + 0.4) * 0.006 + 0.5 * (0.4 + 1.0) * 0.0024 + 0.0076 + 0.005
        assert run.sample.linear_momentum_world[0] == pytest.approx(0.5 * (whole + short + twice), rel=1e-14)
        assert run.sample.energy_defect == pytest.approx(0.0, abs=1e-18)

    def test_the_impulse_is_exact_where_a_ramp_would_end_between_nanoseconds(self) -> None:
        scene = rb.parse_scene(JET.replace("COMMAND", "level"), overrides={"duration": 4.0})
        # The third goes down for a millisecond, by 0.1, until the last replaces it.
        commands = [(1.0, 1.0 / 7.0), (2.0, 2.0 / 3.0), (3.0, 0.1), (3.001, 0.9)]
        run = rb.simulate(scene, [("jet/command", Setpoint(to, round(at * 1e9))) for at, to in commands])
        lasting = [1.0 / 7.0, 2.0 / 3.0, 0.001 * (2.0 / 3.0 - 0.05), 0.998 * 0.9]
        rising = [-0.5 * 0.004 * step * step for step in (1.0 / 7.0, 11.0 / 21.0, 1.0 / 3.0)]
        assert run.sample.linear_momentum_world[0] == pytest.approx(0.5 * math.fsum(lasting + rising), abs=2e-15)

    @pytest.mark.parametrize(("rise", "fall"), [(0.004, 0.0), (0.0, 0.01), (0.004, 0.01)])
    def test_of_changes_at_one_nanosecond_only_the_last_acts(self, rise: float, fall: float) -> None:
        """A pulse that begins where one ends finds the valve open; one that is closed at once gives no impulse."""
        changes: dict[str, object] = {"actuators.jet.rise": rise, "actuators.jet.fall": fall}
        scene = rb.parse_scene(JET.replace("COMMAND", "on_time"), overrides=changes)
        commands = [(1.0, 0.1), (1.1, 0.1), (1.2, 0.1), (2.0, 0.1), (2.0, 0.0)]
        run = rb.simulate(scene, [("jet/command", Setpoint(on, round(at * 1e9))) for at, on in commands])
        impulse = 0.5 * (0.3 - 0.5 * rise + 0.5 * fall)
        assert run.sample.linear_momentum_world[0] == pytest.approx(impulse, rel=1e-14)

    def test_edges_fall_on_their_nanosecond_and_the_log_shows_what_acts(self, tmp_path: Path) -> None:
        shorter: dict[str, object] = {"duration": 0.2, "output_rate": 1000.0}
        scene = rb.parse_scene(JET.replace("COMMAND", "level"), overrides=shorter)
        sink, path = rb.MemorySink(), tmp_path / "run.mcap"
        commands = [("jet/command", Setpoint(0.5, 100_000_001)), ("jet/command", Setpoint(0.0, 150_000_001))]
        rb.simulate(scene, commands, [sink, McapSink(path)])
        edges = [each.time_ns for each in sink.applied if each.time_ns % 1_000_000]
        assert edges == [101_000_001, 103_000_001, 151_000_001, 156_000_001]
        at = {each.time_ns: each.force[0] for each in sink.applied}
        assert at[102_000_000] == pytest.approx(0.5 * 999_999 / 4e6, rel=1e-13)
        assert (at[103_000_001], at[156_000_001]) == (0.25, 0.0)
        assert replay(path).identical

    def test_torque_books_close_on_a_turning_body_with_wheels(self) -> None:
        text = """
body:
  mass: 10
  inertia: {matrix: [[0.2, 0.01, 0], [0.01, 0.3, 0.02], [0, 0.02, 0.25]]}
  frames: {jet: {position: [0.1, 0.2, 0.05], orientation: {x: 0, y: 0, z: 0.6, w: 0.8}}}
initial: {angular_velocity_body: [0.1, -0.2, 0.3]}
wrenches: [{topic: wrench, lag: 0.2}]
actuators:
  - {type: thruster, name: jet, frame: jet, force: 0.5, rise: 0.3, fall: 0.2}
  - {type: reaction_wheel, name: wheel, axis: [0, 1, 1], inertia: 1.0e-3, max_torque: 0.01, command: torque, speed: 50}
duration: 4
output_rate: 10
"""
        sink = rb.MemorySink()
        commands: list[Command] = [
            ("jet/command", Setpoint(1.0, 500_000_000)),
            ("wheel/command", Setpoint(0.005, 600_000_000)),
            ("wrench", Wrench((1.0, 0.0, 0.0), (0.0, 0.05, 0.0), "world", 700_000_000)),
        ]
        rb.simulate(rb.parse_scene(text), commands, [sink])
        assert abs(sink.energy_defect).max() < 1e-11
        assert abs(sink.angular_momentum_defect_world).max() < 1e-11
        assert abs(sink.linear_momentum_defect_world).max() < 1e-14


@pytest.mark.parametrize("method", ["dop853", "dverk"])
def test_a_quick_ramp_beside_a_wheel_needs_no_shorter_step(method: str) -> None:
    """The search for switches of wheels tries the whole step, far beyond the end of the ramp."""
    scene = rb.parse_scene(f"""
body:
  mass: 10
  inertia: {{diagonal: [0.05, 0.12, 0.14]}}
  frames: {{jet: {{position: [0.1, 0.2, 0], orientation: {{x: 0, y: 0, z: 0, w: 1}}}}}}
wrenches: []
actuators:
  - {{type: thruster, name: jet, frame: jet, force: 5.0, rise: 1.0e-5}}
  - {{type: reaction_wheel, name: wheel, axis: [1, 0, 0], inertia: 1.0e-3, speed: 1.0}}
solver: {{method: {method}, step: 0.1}}
duration: 0.4
""")
    end = rb.simulate(scene, [("jet/command", Setpoint(0.05, stamp_ns=200_000_000))]).sample
    # From rest, by its torque times time, before the body turns.
    assert end.angular_momentum_world[2] == pytest.approx(-0.2 * 5.0 * (0.05 - 0.5e-5), rel=0.05)
    assert abs(end.energy_defect) < 1e-12


def test_the_end_of_a_ramp_beside_a_lag_leaves_the_accuracy_within_reach() -> None:
    """Steps are short just before a ramp ends, and only there: rounding does not add up over the rest of the run."""
    scene = rb.parse_scene("""
body:
  mass: 5
  inertia: {diagonal: [1, 1.5, 2]}
  frames: {jet: {position: [0.1, 0.2, 0.3], orientation: {x: 0, y: 0, z: 0, w: 1}}}
initial: {angular_velocity_body: [0.5, 0.3, -0.4]}
wrenches: [{topic: wrench, lag: 0.33}]
actuators: [{type: thruster, name: jet, frame: jet, force: 2.0, rise: 0.2, fall: 0.1}]
solver: {method: dop853, accuracy: 1.0e-11}
duration: 7.3
""")
    commands: list[Command] = [
        ("wrench", Wrench((1.0, 2.0, 1.0), (0.1, -0.2, 0.1))),
        ("jet/command", Setpoint(0.5, stamp_ns=1_000_000_000)),
    ]
    found, finer = (
        rb.simulate(replace(scene, solver=rb.Solver("dop853", accuracy=accuracy)), commands).sample.orientation_xyzw
        for accuracy in (1e-11, 1e-12)
    )
    assert math.dist(found, finer) < 1e-11
