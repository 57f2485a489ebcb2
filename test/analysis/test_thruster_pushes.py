"""Thrusters push as commanded: what a bag of another program says of their commands gives what acted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fired_thrusters import BEGIN, FITTED, SCENE, commands, contained, recorded, rough
from foreign_bags import GEOMETRY, Row, header, of, pose, write_bag

import rb_dynamics as rb
from rb_dynamics.analysis.bag_selection import part_of
from rb_dynamics.analysis.identification.flights import flight_of
from rb_dynamics.analysis.impulse import integral
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import summarize
from rb_dynamics.analysis.thruster_pushes import pushes
from rb_dynamics.logs.bag_reader import read_bag

NOTHING = np.empty(0, dtype=np.int64)


def test_mass_centre_and_inertia_are_found_from_the_firings(tmp_path: Path) -> None:
    """Delays, ramps, replaced and rejected pulses count; `tools/calibrate_thrusters.py` tries more flights."""
    scene, within = rb.parse_scene(SCENE), list[bool]()
    for seed in range(100, 105):
        bag = recorded(tmp_path / str(seed), scene, seed)
        found = rb.identify(rough(), [str(bag)], FITTED)
        within += contained(found, scene)
        assert found.body.mass == pytest.approx(12.0, rel=3e-3)
    assert len(within) == 50
    assert sum(within) >= 43


def test_a_flight_that_was_held_out_is_predicted_with_the_centre_of_mass_that_was_found(tmp_path: Path) -> None:
    """Its torques are about that of the scene, 4 cm away: taken as they are, rates miss by 100 times the noise."""
    scene = rb.parse_scene(SCENE)
    made, held_out = (str(recorded(tmp_path / str(seed), scene, seed, noise=1e-3)) for seed in (110, 111))
    found = rb.identify(rough(), [made], FITTED, validate=[held_out])
    assert max(each.rms for each in found.validation) < 1.5e-3
    assert found.validated is True


def test_a_thruster_is_calibrated(tmp_path: Path) -> None:
    """Of a known body; the scene takes one of three for stronger than it is."""
    bag = recorded(tmp_path / "bag", rb.parse_scene(SCENE), 7)
    found = rb.identify(rb.parse_scene(SCENE.replace("force: 2", "force: 2.5")), [str(bag)], ["wrench_scale"])
    scales = {each.name: each.value for each in found.parameters if each.name.startswith("wrench_scale")}
    assert scales == {
        "wrench_scale./sat/jet_a/command": pytest.approx(0.8, rel=3e-3),
        "wrench_scale./sat/jet_b/command": pytest.approx(1.0, rel=3e-3),
        "wrench_scale./sat/jet_c/command": pytest.approx(1.0, rel=3e-3),
    }


def test_inspect_finds_nothing_else_that_acted_and_a_force_that_is_wrong(tmp_path: Path) -> None:
    scene = rb.parse_scene(SCENE)
    bag = recorded(tmp_path / "bag", scene, 8)
    right = summarize(read_track(read_bag(bag), scene))
    assert not [check.name for check in right.checks if not check.passed]
    wrong = summarize(read_track(read_bag(bag), rb.parse_scene(SCENE.replace("force: 2", "force: 4"))))
    assert [check.name for check in wrong.checks if not check.passed]


@pytest.mark.parametrize("begin_s", [1.7, 3.1, 4.3])
def test_what_was_commanded_before_a_part_acts_in_it(tmp_path: Path, begin_s: float) -> None:
    """`inspect --from` left it out, and found torques that nobody commanded."""
    scene = rb.parse_scene(SCENE)
    bag = recorded(tmp_path / "bag", scene, 8)
    found = rb.inspect(bag, scene=scene, window_s=(begin_s, 8.0))
    assert not [check.name for check in found.summary.checks if not check.passed]


def test_thrusters_do_the_same_in_a_part_as_in_the_whole(tmp_path: Path) -> None:
    """Commands that wait or still ramp when it begins, and pulses that go on after one that is rejected, were lost."""
    scene = rb.parse_scene(SCENE.replace("delay: 0.015", "delay: 0.3"))
    whole = read_track(read_bag(recorded(tmp_path / "bag", scene, 8)), scene)
    assert whole.pose is not None
    for begin in range(0, len(whole.pose.time_ns) - 10, 3):
        sampled = whole.pose.time_ns[begin:]
        part = read_track(part_of(whole, (float(sampled[0] - BEGIN) * 1e-9, None), scene), scene)
        acts = {each.topic: each for each in part.wrenches}
        for each in whole.wrenches:
            found = [integral(one.time_ns, one.force, sampled) for one in (each, acts[each.topic])]
            assert np.abs(found[1] - found[0]).max() < 10.0, (each.topic, begin)


@pytest.mark.slow
def test_commands_that_are_recorded_some_milliseconds_late_accuse_nobody(tmp_path: Path) -> None:
    """They have no stamps: what acted is known only as well as when."""
    scene = rb.parse_scene(
        SCENE.replace("duration: 8", "duration: 5").replace("[0.1, -0.2, 0.15]", "[0.02, -0.01, 0.01]")
    )
    for seed in (21, 23, 24, 25):
        bag = recorded(tmp_path / str(seed), scene, seed, noise=1e-3, late=0.003)
        (check,) = [
            each for each in summarize(read_track(read_bag(bag), scene)).checks if each.name.startswith("inertia")
        ]
        assert check.passed


def test_pushes_have_the_impulses_of_their_commands() -> None:
    scene = rb.parse_scene(SCENE)
    _, _, jet = scene.actuators
    times, rows = pushes(jet, scene, np.array([0, 10**9]), np.array([0.3, 0.2]), NOTHING)  # type: ignore[arg-type]
    spans = np.diff(times) * 1e-9
    assert rows[-1].tolist() == [0.0] * 6
    assert (rows[:-1, 0] * spans).sum() == pytest.approx(0.5, rel=1e-12)


def test_the_impulse_is_right_at_each_sample_within_a_ramp() -> None:
    """Steps that are right only at the end of a ramp failed the balance of momentum of an exact recording."""
    scene = rb.parse_scene(SCENE.replace("rise: 0.01, fall: 0.01", "rise: 0.05, fall: 0.04"))
    sampled = np.array([3, 18, 49, 57]) * 10**6
    times, rows = pushes(scene.actuators[2], scene, np.array([0]), np.array([0.3]), sampled)  # type: ignore[arg-type]
    assert len(times) == 25
    for at in sampled.tolist():
        row = np.searchsorted(times, at)
        so_far = np.diff(np.append(times[:row], at))
        seconds = 1e-9 * at
        expected = 10.0 * min(seconds, 0.05) ** 2 + max(seconds - 0.05, 0.0)
        assert (rows[:row, 0] * so_far).sum() * 1e-9 == pytest.approx(expected, rel=1e-12)


def test_a_command_that_comes_while_the_force_ramps_ends_the_ramp_when_it_acts() -> None:
    """Not when it arrives: 0.03 s before. A rejected one never does."""
    scene = rb.parse_scene(
        SCENE.replace("rise: 0.01, fall: 0.01", "rise: 0.04, fall: 0.04, delay: 0.03, minimum_on: 0.1")
    )
    jet = scene.actuators[2]
    # Opens at 0.03, of which the ramp lasts to 0.07; from 0.05 on another pulse of 0.2, so that it closes at 0.25.
    for sent in ([(0, 0.3), (20, 0.2)], [(0, 0.3), (10, 0.01), (20, 0.2), (35, 0.01)]):
        at, values = (np.array(column) for column in zip(*sent, strict=True))
        times, rows = pushes(jet, scene, at * 10**6, values, NOTHING)  # type: ignore[arg-type]
        assert (rows[:-1, 0] * np.diff(times)).sum() * 1e-9 == pytest.approx(0.22, rel=1e-12)
    # One to close that acts halfway up: the force rises to half, and falls from there.
    times, rows = pushes(jet, scene, np.array([0, 20 * 10**6]), np.array([0.3, 0.0]), NOTHING)  # type: ignore[arg-type]
    assert (rows[:-1, 0] * np.diff(times)).sum() * 1e-9 == pytest.approx(0.01, rel=1e-12)


def test_what_is_taken_for_granted_is_said(tmp_path: Path) -> None:
    rod = "  - {type: magnetorquer, name: rod, axis: [0, 0, 1], max_dipole: 1}\n"
    field = "effects: [{type: magnetic_field, model: uniform, field_world: [1.0e-5, 0, 0]}]\n"
    scene = rb.parse_scene(SCENE.replace("duration", f"{rod}{field}duration"))
    told = flight_of(read_bag(recorded(tmp_path / "bag", rb.parse_scene(SCENE), 9)), scene).notes
    assert "rod: no command is recorded: taken to have done nothing" in told
    assert sum("is taken to have pushed as commanded" in note for note in told) == 3


def test_commands_may_be_in_a_bag_of_their_own(tmp_path: Path) -> None:
    """One to a magnetorquer is refused there, too: what it did is not known."""
    scene = rb.parse_scene(SCENE)
    sent = commands(np.random.default_rng([10, 31]))
    rows = [
        (f"/{topic}", "std_msgs/msg/Float64", BEGIN + each.stamp_ns, of("std_msgs/msg/Float64", each.value))
        for topic, each in sent
    ]
    apart = write_bag(tmp_path / "commands", rows)
    whole = recorded(tmp_path / "whole", scene, 10)
    moved = read_bag(whole)
    found = flight_of(moved, scene, [str(apart)])
    mine = {each.topic: each for each in found.channels if each.topic.startswith("/jet")}
    for name in ("a", "b", "c"):
        there = next(each for each in found.channels if each.topic == f"/sat/jet_{name}/command")
        assert mine[f"/jet_{name}/command"].time_ns.tolist() == there.time_ns.tolist()
        assert mine[f"/jet_{name}/command"].held.tolist() == there.held.tolist()
    rod = "  - {type: magnetorquer, name: rod, axis: [0, 0, 1], max_dipole: 1}\n"
    field = "effects: [{type: magnetic_field, model: uniform, field_world: [1.0e-5, 0, 0]}]\n"
    driven = write_bag(tmp_path / "rod", [*rows, ("/rod/command", *rows[-1][1:])])
    with pytest.raises(rb.SceneError, match="actuators: found commands to rod, expected only wheels, and thrusters"):
        rb.identify(rb.parse_scene(SCENE.replace("duration", f"{rod}{field}duration")), [str(whole)], ["mass"],
                    commands=[str(driven)])  # fmt: skip


@pytest.mark.parametrize("stamped", [False, True])
def test_commands_in_a_bag_of_their_own_go_by_the_stamps_where_log_times_are_of_another_clock(
    tmp_path: Path, stamped: bool
) -> None:
    """By those of the motion, recorded at that time, or by those of a wrench beside them."""
    scene, ahead = rb.parse_scene(SCENE + "wrenches: [{topic: wrench}]\n"), 3600 * 10**9
    whole = recorded(tmp_path / "whole", scene, 10, ahead_ns=ahead)
    rows: list[Row] = [
        (f"/{topic}", "std_msgs/msg/Float64", BEGIN + each.stamp_ns + ahead, of("std_msgs/msg/Float64", each.value))
        for topic, each in commands(np.random.default_rng([10, 31]))
    ]
    push = of("Wrench", of("Vector3", 0.0, 0.0, 0.0), of("Vector3", 0.0, 0.0, 0.0))
    kind = f"{GEOMETRY}WrenchStamped"
    times = [BEGIN + k * 10**9 for k in range(8)] if stamped else []
    rows += [("/wrench", kind, at + ahead, of("WrenchStamped", header(at, "body"), push)) for at in times]
    apart = write_bag(tmp_path / "commands", sorted(rows, key=lambda row: row[2]))
    found = flight_of(read_bag(whole), scene, [str(apart)])
    by_topic = {each.topic: each.time_ns.tolist() for each in found.channels}
    for name in ("a", "b", "c"):
        assert by_topic[f"/jet_{name}/command"] == by_topic[f"/sat/jet_{name}/command"]
        (told,) = [note for note in found.notes if f"/commands: /jet_{name}/command has no stamps" in note]
        assert told.endswith(f"put 3600 s earlier than it was logged, as {'/wrench' if stamped else '/sat/pose'} is.")


def test_thrusters_in_the_namespace_of_another_body_do_not_push_this_one(tmp_path: Path) -> None:
    """Of bodies in one bag, `b` spins freely about its principal axis. Jets of another were taken for its own."""
    scene = rb.parse_scene(
        "body: {mass: 2, inertia: {diagonal: [0.2, 0.3, 0.4]}, frames: {jet: {position: [0.1, 0.2, 0]}}}\n"
        "wrenches: []\nactuators: [{type: thruster, name: jet, frame: jet, force: 1}]\n"
    )
    rng, rows = np.random.default_rng(7), list[Row]()
    for k in range(400):
        at, turn = BEGIN + k * 20_000_000, 0.5 * 0.02 * k
        spin = of("Twist", of("Vector3", 0.0, 0.0, 0.0), of("Vector3", *(1e-3 * rng.standard_normal(3)) + [0, 0, 1]))
        for name in ("/a", "/b", "/b/c"):
            place = (*(1e-3 * rng.standard_normal(3)), 0.0, 0.0, np.sin(turn), np.cos(turn))
            rows.append(
                (f"{name}/pose", f"{GEOMETRY}PoseStamped", at, of("PoseStamped", header(at, "map"), pose(place)))
            )
            kind = f"{GEOMETRY}TwistStamped"
            rows.append((f"{name}/twist", kind, at, of("TwistStamped", header(at, "body"), spin)))
    for name, near in (("/a", False), ("/b/c", False), ("/b", True)):
        at = BEGIN + 10**9
        rows.append(
            (f"{name}/jet/command", "std_msgs/msg/Float64", at, of("std_msgs/msg/Float64", 0.0 if near else 1.0))
        )
        bag = write_bag(tmp_path / name.replace("/", "_"), sorted(rows, key=lambda row: row[2]))
        found = rb.inspect(bag, scene, topics=rb.TopicChoice("/b/pose", "/b/twist"))
        assert found.passed
        told = [note for note in found.summary.notes if "cannot tell wh" in note]
        assert bool(told) == (not near)
        if near:
            assert any("/b/jet/command: jet is taken to have pushed" in note for note in found.summary.notes)
