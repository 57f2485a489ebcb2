"""`convert RUN.mcap state.yaml --at T`: a scene that goes on with the same bits, to the end of the run."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from recorded_runs import COMMANDS, SCENE, Flight, coasting, flight, flown, fly

import rb_dynamics as rb
from rb_dynamics.cli import main
from rb_dynamics.formats.yaml import document
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study import continued_run
from rb_dynamics.study.continued_run import scene_at

__all__ = ["coasting", "flight", "flown"]

# After the timeout of a channel and while another one holds; in the middle of a step; at a command.
TIMES = (900_000_000, 1_234_567_890, 2_250_000_000)


def later(at_ns: int, commands: Any = COMMANDS) -> Iterator[tuple[str, rb.Wrench]]:
    """The commands from a time on, counted from there."""
    for topic, wrench in commands:
        if wrench.stamp_ns >= at_ns:
            yield topic, rb.Wrench(wrench.force, wrench.torque, wrench.frame_id, wrench.stamp_ns - at_ns)


def bits(run: rb.Run) -> dict[str, Any]:
    """All that a run comes to; attributes are equal if their bits are."""
    return {**{k: v for k, v in asdict(run.sample).items() if k != "time_ns"}, "steps": run.steps}


@pytest.mark.parametrize("solver", ["{method: rkmk4, step: 0.01}", "{}", "{method: dop853, accuracy: 1.0e-8}"])
def test_it_goes_on_with_the_same_bits_and_books(tmp_path: Path, solver: str) -> None:
    log = tmp_path / "run.mcap"
    text = SCENE.replace("{method: rkmk4, step: 0.01}", solver)
    whole = rb.simulate(rb.parse_scene(text), COMMANDS, [McapSink(log)])
    for at_ns in TIMES:
        found = scene_at(log, at_ns)
        assert found.notes == ()
        scene = rb.parse_scene(found.text)
        rest = rb.simulate(scene, list(later(at_ns)))
        assert rest.sample.time_ns == 3_000_000_000 - at_ns
        assert bits(rest) == bits(whole)


def test_a_rejected_command_that_no_scene_can_say_is_left_out(tmp_path: Path) -> None:
    log, topic = tmp_path / "run.mcap", COMMANDS[0][0]
    commands = [*COMMANDS, (topic, rb.Wrench((float("nan"), 0.0, float("inf")), stamp_ns=100_000_000))]
    whole = rb.simulate(rb.parse_scene(SCENE), commands, [McapSink(log)])
    assert len(whole.rejected) == 1
    found = scene_at(log, TIMES[1])
    assert found.notes == ()
    assert bits(rb.simulate(rb.parse_scene(found.text), list(later(TIMES[1])))) == bits(whole)


def test_a_free_body_in_closed_form_goes_on(coasting: Flight, tmp_path: Path) -> None:
    log = tmp_path / "spin.mcap"
    text = "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0.1, 2, 0.1]}\n"
    whole = rb.simulate(rb.parse_scene(text + "wrenches: []\nduration: 5.0"), sinks=[McapSink(log)])
    assert bits(rb.simulate(rb.parse_scene(scene_at(log, 3_333_333_333).text))) == bits(whole)


def test_its_initial_state_is_that_of_the_log_to_the_bit(flight: Flight) -> None:
    scene = rb.parse_scene(scene_at(flight.log, 1_000_000_000).text)
    times = flight.samples.time_ns.tolist()
    at = times.index(1_000_000_000)
    assert scene.initial.position_world == tuple(flight.samples.position_world[at])
    assert scene.initial.orientation_xyzw == tuple(flight.samples.orientation_xyzw[at])
    assert scene.initial.linear_velocity_world == tuple(flight.samples.linear_velocity_world[at])
    assert scene.initial.angular_velocity_body == tuple(flight.samples.angular_velocity_body[at])
    assert scene.duration == 2.0


def test_as_a_user_does_it_and_again_from_the_log_of_that(
    flight: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state, again = tmp_path / "state.yaml", tmp_path / "again.yaml"
    rest, end = tmp_path / "rest.mcap", tmp_path / "end.mcap"
    assert main(["convert", str(flight.log), str(state), "--at", "0.6"]) == 0
    assert f"simulate {state} --wrench {flight.log} --wrench-start 0.6" in capsys.readouterr().out
    assert (
        main(["simulate", str(state), "--wrench", str(flight.log), "--wrench-start", "0.6", "--mcap", str(rest)]) == 0
    )
    assert main(["replay", str(rest)]) == 0
    # What was held at its beginning is in the log, so that its balances close.
    assert rb.inspect(rest).passed, [check for check in rb.inspect(rest).summary.checks if not check.passed]
    assert main(["convert", str(rest), str(again), "--at", "0.9"]) == 0
    assert main(["simulate", str(again), "--wrench", str(rest), "--wrench-start", "0.9", "--mcap", str(end)]) == 0
    compared = rb.compare(flight.log, end, align=-1.5)
    assert compared.first_ns is None
    assert compared.samples == 76
    assert (compared.commands, compared.body) == ([], [])


@pytest.mark.parametrize(("at_ns", "frame"), [(2_000_000_000, ""), (1_000_000_000, "nowhere")])
def test_as_a_user_does_it_where_no_later_command_acts(
    at_ns: int, frame: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The only one came at the end of the run, or was rejected."""
    log, state = tmp_path / "run.mcap", tmp_path / "state.yaml"
    scene = rb.parse_scene(
        "body: {mass: 2, inertia: {diagonal: [0.3, 0.4, 0.6]}}\ninitial: {angular_velocity_body: [0.1, 0.2, -0.3]}\n"
        "wrenches: [{topic: push}]\nduration: 2.0\noutput_rate: 10\n"
    )
    whole = rb.simulate(scene, [("push", rb.Wrench((1, 0, 0), frame_id=frame, stamp_ns=at_ns))], [McapSink(log)])
    assert main(["convert", str(log), str(state), "--at", "0.5"]) == 0
    capsys.readouterr()
    assert main(["simulate", str(state), "--wrench", str(log), "--wrench-start", "0.5", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["orientation_xyzw"] == list(whole.sample.orientation_xyzw)


@pytest.mark.parametrize("timeout", [0.0, 0.2])
def test_as_a_user_does_it_after_the_last_command(
    timeout: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, state, rest = tmp_path / "run.mcap", tmp_path / "state.yaml", tmp_path / "rest.mcap"
    scene = rb.parse_scene(
        "body: {mass: 2, inertia: {diagonal: [0.3, 0.4, 0.6]}}\ninitial: {angular_velocity_body: [0.1, 0.2, -0.3]}\n"
        f"wrenches: [{{topic: push, timeout: {timeout}}}]\nduration: 2.0\noutput_rate: 10\n"
    )
    pushes = [("push", rb.Wrench((1, 0, 0), (0, at, 0), stamp_ns=round(at * 1e9))) for at in (0.1, 0.3)]
    whole = rb.simulate(scene, pushes, [McapSink(log)])
    assert main(["convert", str(log), str(state), "--at", "1.5"]) == 0
    onward = [str(state), "--wrench", str(log), "--wrench-start", "1.5"]
    capsys.readouterr()
    assert main(["simulate", *onward, "--json", "--mcap", str(rest)]) == 0
    assert json.loads(capsys.readouterr().out)["orientation_xyzw"] == list(whole.sample.orientation_xyzw)
    assert main(["replay", str(rest)]) == 0


@pytest.mark.parametrize("written", [["--mcap"], ["--max-bag-duration", "0.3", "--bag"]])
def test_the_logs_of_both_become_that_of_the_whole_run(
    written: list[str], flight: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state, again, whole = tmp_path / "state.yaml", tmp_path / "again.yaml", tmp_path / "whole.mcap"
    rest, end = (tmp_path / f"{name}{'.mcap' * (len(written) == 1)}" for name in ("rest", "end"))
    main(["convert", str(flight.log), str(state), "--at", "0.605"])
    main(["simulate", str(state), "--wrench", str(flight.log), "--wrench-start", "0.605", *written, str(rest)])
    main(["convert", str(rest), str(again), "--at", "0.92"])
    main(["simulate", str(again), "--wrench", str(rest), "--wrench-start", "0.92", *written, str(end)])
    assert main(["convert", str(end), str(flight.log), str(rest), str(whole)]) == 0
    assert f"wrote {whole}: 151 samples of one run" in capsys.readouterr().out
    assert main(["replay", str(whole)]) == 0
    compared = rb.compare(flight.log, whole)
    assert (compared.first_ns, compared.commands, compared.samples) == (None, [], 151)
    # Its commands are those of one run for any reader: those of the parts had their stamps from the start of each.
    wrenches = [read_bag(log).wrenches("/thrust") for log in (flight.log, whole)]
    assert wrenches[0] == wrenches[1]
    assert all(at_ns == wrench.stamp_ns for at_ns, wrench in wrenches[1])


@pytest.mark.parametrize("with_acceleration", ["first", "last"])
def test_logs_with_and_without_the_acceleration_are_joined(
    with_acceleration: str, flight: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state, first = tmp_path / "state.yaml", tmp_path / "first.mcap"
    rest, whole = tmp_path / "rest.mcap", tmp_path / "whole.mcap"
    accel = {each: ["--accel"] * (each == with_acceleration) for each in ("first", "last")}
    main(["convert", str(flight.log), str(tmp_path / "scene.yaml")])
    begin = [str(tmp_path / "scene.yaml"), "--wrench", str(flight.log)]
    main(["simulate", *begin, "--mcap", str(first), *accel["first"]])
    main(["convert", str(first), str(state), "--at", "0.605"])
    onward = [str(state), "--wrench", str(first), "--wrench-start", "0.605"]
    main(["simulate", *onward, "--mcap", str(rest), *accel["last"]])
    capsys.readouterr()
    assert main(["convert", str(first), str(rest), str(whole)]) == 0
    assert f"wrote {whole}: 151 samples of one run" in capsys.readouterr().out
    assert "/accel" in read_bag(whole).topics
    assert main(["replay", str(whole)]) == 0


def test_another_flight_is_no_part_of_the_run(
    flight: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state, rest, whole = tmp_path / "state.yaml", tmp_path / "rest.mcap", tmp_path / "whole.mcap"
    other = fly(tmp_path / "other.mcap", SCENE.replace("0.3, -0.4", "0.3, -0.5"))
    main(["convert", str(other.log), str(state), "--at", "1.5"])
    main(["simulate", str(state), "--mcap", str(rest)])
    capsys.readouterr()
    assert main(["convert", str(flight.log), str(rest), str(whole)]) == 2
    said = capsys.readouterr().err
    assert "comes to other numbers at 1.5 s" in said
    assert said.count("\n") == 1
    assert not whole.exists()


def test_without_later_commands_it_goes_on_with_what_is_held(flown: Callable[..., Flight]) -> None:
    whole = flown(commands=COMMANDS[:3])
    assert bits(rb.simulate(rb.parse_scene(scene_at(whole.log, 1_500_000_000).text))) == bits(whole.result)


def test_at_its_end_it_is_the_last_state_and_goes_on_as_long_as_is_said(
    flight: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "state.yaml"
    assert main(["convert", str(flight.log), str(target), "--at", "3"]) == 0
    assert "--duration" in capsys.readouterr().err
    assert rb.read_scene(target).duration is None
    longer = rb.simulate(rb.parse_scene(SCENE, overrides={"duration": 5.0}), COMMANDS)
    assert bits(rb.simulate(rb.read_scene(target, {"duration": 2.0}))) == bits(longer)


TIMED = """
body: {mass: 4.0, inertia: {matrix: [[0.5, 0.02, -0.01], [0.02, 0.7, 0.03], [-0.01, 0.03, 0.9]]}}
initial: {angular_velocity_body: [0.3, -0.4, 0.5]}
effects:
  - {type: rotor, axis_body: [1, 2, 0], axial_inertia: 0.05, spin_rate: [{time: 0, rate: 2}, {time: 2, rate: 9}]}
  - {type: scheduled_wrench, frame_id: body, schedule: [{time: 0.2, force: [0, 0, 0], torque: [0.1, 0, 0]},
                                                        {time: 1.8, force: [0, 1, 0], torque: [0, 0, 0]}]}
wrenches: [{topic: thrust, timeout: 0.9, delay: 0.3}, {topic: push, lag: 0.4}]
solver: {method: dop853, accuracy: 1.0e-10}
duration: 3.0
output_rate: 50
"""
AT_NS = 1_250_000_000


@pytest.mark.parametrize("why", ["another body", "too many commands"])
def test_one_that_begins_anew_goes_on_by_the_clock_of_the_run(
    tmp_path: Path, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ramps of a rotor and schedules, and the age of what is held: its timeout, delay and lag."""
    whole = fly(tmp_path / "run.mcap", TIMED, COMMANDS)
    overrides = {"body.mass": 4.0 * (1.0 + 1e-14)}
    if why == "too many commands":
        commands = [*COMMANDS, *(("push", rb.Wrench((0.0, 0.0, 0.1), stamp_ns=k)) for k in range(60))]
        whole, overrides = fly(tmp_path / "run.mcap", TIMED, commands), {}
        monkeypatch.setattr(document, "MAX_CHARACTERS", 4000)
        monkeypatch.setattr(continued_run, "_KEPT", 5)
    found = scene_at(whole.log, AT_NS)
    assert ("too many" in str(found.notes)) == (why == "too many commands")
    # A bag of the whole run has the commands before AT_NS, too: the scene has them already.
    for since_ns in (AT_NS, 0):
        commands = [
            (topic, rb.Wrench(wrench.force, wrench.torque, wrench.frame_id, wrench.stamp_ns - AT_NS))
            for topic, wrench in COMMANDS
            if wrench.stamp_ns >= since_ns
        ]
        rest = rb.simulate(rb.parse_scene(found.text, overrides=overrides), commands).sample
        for name in ("angular_velocity_body", "linear_velocity_world", "orientation_xyzw", "angular_momentum_world"):
            assert getattr(rest, name) == pytest.approx(getattr(whole.result.sample, name), abs=1e-9)


def test_another_body_begins_anew_from_that_state_and_that_is_said(
    flight: Flight, caplog: pytest.LogCaptureFixture
) -> None:
    text = scene_at(flight.log, 1_500_000_000).text
    with caplog.at_level(logging.WARNING):
        scene = rb.parse_scene(text, overrides={"body.mass": 5.0})
        memory = rb.MemorySink()
        heavier = rb.simulate(scene, sinks=[memory])
    assert "starts anew" in caplog.text
    caplog.clear()
    rb.simulate(replace(scene, solver=rb.Solver("rk4", step=0.1)))
    assert "starts anew" not in caplog.text, "said again"
    there = zip(memory.samples[0].orientation_xyzw, scene.initial.orientation_xyzw, strict=True)
    assert max(abs(a - b) for a, b in there) < 1e-15
    # The force that was held goes on: p = m v + F t.
    gained = [F * 1.5 for F in (1.0, -2.0, 0.5)]
    start = memory.samples[0].linear_momentum_world
    for reached, before, more in zip(heavier.sample.linear_momentum_world, start, gained, strict=True):
        assert abs(reached - before - more) < 1e-12


def test_bad_times_are_one_line(flight: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "state.yaml"
    for at in ("3.000000001", "3.5"):
        assert main(["convert", str(flight.log), str(target), "--at", at]) == 2
        said = capsys.readouterr().err
        assert "--at: found" in said
        assert said.count("\n") == 1
    with pytest.raises(SystemExit) as stopped:
        main(["convert", str(flight.log), str(tmp_path / "x.csv"), "--at", "1"])
    assert stopped.value.code == 2
    assert not target.exists()


def test_a_velocity_may_be_given_in_body_axes(tmp_path: Path) -> None:
    turned = "orientation: {x: 0, y: 0, z: 0.7071067811865476, w: 0.7071067811865476}"
    text = "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {" + turned + ", linear_velocity_body: [1, 0, 0]}"
    velocity = rb.parse_scene(text).initial.linear_velocity_world
    assert max(abs(a - b) for a, b in zip(velocity, (0.0, 1.0, 0.0), strict=True)) < 1e-15
    with pytest.raises(rb.SceneError, match="remove the other"):
        rb.parse_scene(text.replace("[1, 0, 0]}", "[1, 0, 0], linear_velocity_world: [1, 0, 0]}"))


def test_what_a_scene_continues_is_checked_key_by_key(flight: Flight) -> None:
    text = scene_at(flight.log, 1_500_000_000).text
    for key, value in (
        ("continues.after_ns", -1),
        ("continues.after_ns", 0.5),
        ("continues.commands", [[1, 2]]),
        ("continues.initial", {"speed": 1}),
        ("continues.since", 1),
    ):
        with pytest.raises(rb.SceneError, match="continues"):
            rb.parse_scene(text, overrides={key: value})


def test_the_log_of_it_says_what_it_is(flight: Flight, tmp_path: Path) -> None:
    log = tmp_path / "rest.mcap"
    rb.simulate(rb.parse_scene(scene_at(flight.log, 1_500_000_000).text), sinks=[McapSink(log)])
    assert b"continues:" in read_bag(log).attachments["scene.yaml"]
    assert json.loads(json.dumps(rb.inspect(log).as_dict()))["passed"]


def test_actuators_are_refused(scene_dir: Path, tmp_path: Path) -> None:
    log = tmp_path / "wheels.mcap"
    rb.simulate(rb.read_scene(scene_dir / "wheels.yaml", {"duration": 0.2}), sinks=[McapSink(log)])
    with pytest.raises(rb.LogError, match="has actuators"):
        scene_at(log, 100_000_000)


def test_a_state_from_outside_is_refused(tmp_path: Path) -> None:
    from rb_dynamics.run.state_change import StateChange

    log = tmp_path / "moved.mcap"
    run = rb.Simulation(rb.parse_scene(SCENE), [McapSink(log)])
    run.start()
    run.advance(500_000_000)
    run.set_state(StateChange(500_000_000, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.1, 0.0, 0.0)))
    run.advance(3_000_000_000)
    run.finish()
    assert scene_at(log, 400_000_000).notes == ()
    with pytest.raises(rb.LogError, match="moved from outside"):
        scene_at(log, 1_000_000_000)


def test_after_months_every_nanosecond_counts(tmp_path: Path) -> None:
    log, at_ns = tmp_path / "run.mcap", 15_000_000_123_456_789
    given = {"solver": {"accuracy": 1e-7}, "duration": 2e7, "output_rate": 1e-6}
    whole = rb.simulate(rb.parse_scene(SCENE, overrides=given), [], [McapSink(log)])
    found = scene_at(log, at_ns)
    rest = rb.parse_scene(found.text)
    assert found.notes == ()
    assert rest.past is not None
    assert rest.past.length_ns == at_ns
    assert bits(rb.simulate(rest)) == bits(whole)

    assert scene_at(log, at_ns - 10**16).notes == (
        "its end is +2 ns from that of the run: a double of so many seconds has gaps of them",
    )
