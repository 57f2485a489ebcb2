"""Thrusters and magnetorquers: edges on their nanosecond, limits, torque in the field; log, replay and bags."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rb_dynamics as rb
from rb_dynamics.errors import SceneError, WrenchError
from rb_dynamics.loads.actuator import Setpoint
from rb_dynamics.loads.wrench_channels import AppliedWrench
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.wrench_bags import RecordedWrenches
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study.replay import replay

SCENE = """
body:
  mass: 10
  center_of_mass: [0.01, 0.02, -0.01]
  inertia: {matrix: [[0.2, 0.01, 0], [0.01, 0.3, 0.02], [0, 0.02, 0.25]]}
  frames:
    jet: {position: [0.1, 0.2, 0.05], orientation: {x: 0, y: 0, z: 0.6, w: 0.8}}
initial: {angular_velocity_body: [0.1, -0.2, 0.3]}
wrenches: []
effects: [{type: magnetic_field, model: uniform, field_world: [2.0e-5, 0, -4.0e-5]}]
actuators:
  - {type: thruster, name: jet, frame: jet, force: 0.5, minimum_on: 0.005, delay: 0.002}
  - {type: thruster, name: valve, frame: jet, force: 2.0, command: level}
  - {type: magnetorquer, name: rod, axis: [0, 3, 4], max_dipole: 0.2}
duration: 3
output_rate: 10
"""
COMMANDS = [
    ("rod/command", Setpoint(1.0, 500_000_000)),
    ("jet/command", Setpoint(0.0123456789, 1_000_000_001)),
    ("jet/command", Setpoint(0.001, 1_500_000_000)),
    ("valve/command", Setpoint(0.25, 1_700_000_000)),
    ("valve/command", Setpoint(0.0, 1_900_000_000)),
]


def edges(applied: list[AppliedWrench], name: str) -> list[tuple[int, bool]]:
    return [(each.time_ns, any(each.force)) for each in applied if each.topic == name]


def test_the_edges_of_a_pulse_fall_on_their_nanosecond_and_its_impulse_is_exact() -> None:
    text = """
body: {mass: 4, frames: {jet: {position: [0, 0, 0], orientation: {x: 0, y: 0, z: 0, w: 1}}}}
wrenches: []
actuators: [{type: thruster, name: jet, frame: jet, force: 0.5, delay: 0.002}]
duration: 100
solver: {method: rk4, step: 1.0}
"""
    sink = rb.MemorySink()
    commands = [("jet/command", Setpoint(0.002, 10**9 * k + 1)) for k in range(50)]
    run = rb.simulate(rb.parse_scene(text), commands, [sink])
    assert edges(sink.applied, "jet")[:4] == [
        (2_000_001, True),
        (4_000_001, False),
        (1_002_000_001, True),
        (1_004_000_001, False),
    ]
    assert run.sample.linear_momentum_world[0] == pytest.approx(0.05, rel=1e-15)


def test_a_new_command_replaces_the_pulse_before() -> None:
    scene = rb.parse_scene(SCENE)
    for second, expected in (
        (Setpoint(0.3, 200_000_000), [(102_000_000, True), (502_000_000, False)]),
        (Setpoint(0.0, 200_000_000), [(102_000_000, True), (202_000_000, False)]),
        (Setpoint(0.5, 100_000_000), [(102_000_000, True), (602_000_000, False)]),
    ):
        sink = rb.MemorySink()
        rb.simulate(scene, [("jet/command", Setpoint(0.25, 100_000_000)), ("jet/command", second)], [sink])
        assert edges(sink.applied, "jet") == expected


def test_a_pulse_that_begins_as_another_ends_is_told_alike_whichever_was_posted_first() -> None:
    """A replay posts the commands of a moment at which the body was moved after the others: it told of no change."""
    told = []
    for order in (1, -1):
        sink = rb.MemorySink()
        run = Simulation(rb.parse_scene(SCENE), [sink])
        for time_ns in (100_000_000, 200_000_000)[::order]:
            run.actuate("jet/command", 0.1, time_ns)
        run.start()
        run.advance(1_000_000_000)
        run.finish()
        told.append(edges(sink.applied, "jet"))
    assert told[0] == [(102_000_000, True), (202_000_000, False), (202_000_000, True), (302_000_000, False)]
    assert told[1] == told[0]


def test_a_thruster_acts_like_the_wrench_in_its_frame() -> None:
    """As the same force commanded on a wrench channel in the frame, to the bit."""
    scene = rb.parse_scene(SCENE)
    channel = rb.parse_scene(SCENE.replace("wrenches: []", "wrenches: [{topic: wrench}]"))
    by_jet = rb.simulate(scene, [("valve/command", Setpoint(0.25, 10**9))]).sample
    force = rb.Wrench((0.5, 0.0, 0.0), frame_id="jet", stamp_ns=10**9)
    assert rb.simulate(channel, [("wrench", force)]).sample == by_jet


@pytest.mark.parametrize(("level", "acts"), [(-0.5, 0.0), (1.5, 2.0)])
def test_a_level_beyond_its_ends_acts_as_the_end_and_counts_as_clipped(level: float, acts: float) -> None:
    sink = rb.MemorySink()
    run = rb.simulate(rb.parse_scene(SCENE), [("valve/command", Setpoint(level, 10**9))], [sink])
    assert (run.clipped_on, run.rejected) == ({"valve/command": 1}, ())
    found = [np.linalg.norm(each.force) for each in sink.applied if each.topic == "valve"]
    assert max(found, default=0.0) == pytest.approx(acts)


def test_a_magnetorquer_turns_the_body_by_its_dipole_in_the_field() -> None:
    sink = rb.MemorySink()
    rb.simulate(rb.parse_scene(SCENE, overrides={"output_rate": 200}), [("rod/command", Setpoint(-1.0))], [sink])
    field, dipole = np.array([2.0e-5, 0.0, -4.0e-5]), -0.2 * np.array([0.0, 0.6, 0.8])
    torque = np.cross(Rotation.from_quat(sink.orientation_xyzw).apply(dipole), field)
    momentum = sink.angular_momentum_world
    # Simpson's rule over the whole run.
    weights = np.full(len(torque), 2.0)
    weights[1::2], weights[[0, -1]] = 4.0, 1.0
    assert momentum[-1] - momentum[0] == pytest.approx(weights @ torque / 600.0, abs=5e-12)
    assert np.abs(sink.angular_momentum_defect_world).max() < 1e-11
    assert np.abs(momentum[-1] - momentum[0]).max() > 1e-6


def test_limits_and_unknown_actuators_are_counted() -> None:
    sink = rb.MemorySink()
    run = rb.simulate(
        rb.parse_scene(SCENE), [*COMMANDS, ("rot/command", Setpoint(1.0)), ("valve/command", Setpoint(7.0))], [sink]
    )
    assert len(run.rejected) == 2
    assert "one of jet/command, rod/command, valve/command" in run.rejected[0]
    assert "0 or from minimum_on = 0.005 s" in run.rejected[1]
    assert run.clipped == 2
    assert run.clipped_on == {"rod/command": 1, "valve/command": 1}
    assert [(each.topic, bool(each.reason), each.clipped) for each in sink.commands] == [
        ("valve/command", False, True),
        ("rod/command", False, True),
        ("jet/command", False, False),
        ("jet/command", True, False),
        ("valve/command", False, False),
        ("valve/command", False, False),
    ]
    simulation = rb.Simulation(rb.parse_scene("body: {mass: 1}"))
    with pytest.raises(WrenchError, match="lists none"):
        simulation.actuate("jet/command", 1.0)


def test_log_replay_pieces_and_a_bag_of_commands_give_the_same_bits(tmp_path: Path) -> None:
    scene, path = rb.parse_scene(SCENE), tmp_path / "run.mcap"
    sink, pieces = rb.MemorySink(), rb.MemorySink()
    run = rb.simulate(scene, COMMANDS, [sink, McapSink(path)])
    found = replay(path)
    assert found.identical
    assert found.uncompared == {
        ("/jet/command", "rejected commands, whose numbers have no effect"): 1,
        ("/diagnostics", "warnings and the state of a node"): 1,
    }
    assert rb.inspect(path).passed
    bag = read_bag(path)
    assert bag.metadata["rb_dynamics"]["effects_not_logged_as_wrench"] == "magnetorquer"
    assert len(bag.topics["/jet/applied"].log_times) == 2
    again = rb.simulate(scene, RecordedWrenches([path], [], 3e9, start="auto", actuators=scene.actuators))
    assert again.sample == run.sample
    simulation = rb.Simulation(scene, [pieces])
    for topic, setpoint in COMMANDS:
        try:
            simulation.actuate(topic, setpoint.value, setpoint.stamp_ns)
        except WrenchError:
            assert topic == "jet/command"
    simulation.start()
    for k in range(1, 301):
        simulation.advance(k * 10_000_000)
    simulation.finish()
    assert pieces.samples == sink.samples


@pytest.mark.parametrize(
    ("change", "to"),
    [
        ("name: jet,", "name: pose,"),
        ("name: jet, frame: jet", "name: jet, frame: jot"),
        ("name: jet, frame: jet,", "name: jet,"),
        ("force: 0.5", "force: -1"),
        ("command: level", "command: torque"),
        ("axis: [0, 3, 4]", "axis: [0, 0, 0]"),
        ("name: valve", "name: jet"),
        ("type: magnetorquer", "type: magnetorqer"),
        ("effects: [{type: magnetic_field, model: uniform, field_world: [2.0e-5, 0, -4.0e-5]}]\n", ""),
        ("minimum_on: 0.005", "minimum_no: 0.005"),
    ],
)
def test_what_is_no_actuator_is_one_clear_error(change: str, to: str) -> None:
    assert change in SCENE
    with pytest.raises(rb.SceneError, match="expected") as error:
        rb.parse_scene(SCENE.replace(change, to))
    assert len(str(error.value).splitlines()) <= 2


@pytest.mark.parametrize(
    "key", ["actuators.jet.rise", "actuators.jet.fall", "actuators.jet.delay", "wrenches[0].delay"]
)
def test_a_time_below_a_nanosecond_is_refused_rather_than_rounded_to_none(key: str) -> None:
    text = SCENE.replace("wrenches: []", "wrenches: [{topic: wrench}]")
    for none in (0.0, 1e-9):
        rb.parse_scene(text, overrides={key: none})
    with pytest.raises(SceneError, match=rf"{key.rpartition('.')[2]}: .*4e-10.*, expected a time of 0 or from 1e-09"):
        rb.parse_scene(text, overrides={key: 4e-10})
    with pytest.raises(SceneError, match=r"rise is 4e-10, expected a time of 0 or from 1e-09"):
        rb.Thruster(name="jet", frame="jet", force=1.0, rise=4e-10)
