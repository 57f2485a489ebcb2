"""A log stands wherever a scene with its commands does: it gives the same bits, and what would have been otherwise."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from recorded_runs import COMMANDS, SCENE, Flight, coasting, flight, flown

import rb_dynamics as rb
from rb_dynamics.cli import main
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.run.state_change import StateChange
from rb_dynamics.sinks.mcap_sink import McapSink

__all__ = ["coasting", "flight", "flown"]


def states(log: Path) -> str:
    return read_bag(log).metadata["rb_dynamics.result"]["states_sha256"]


def test_it_gives_the_same_bits(flight: Flight, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    assert main(["simulate", str(flight.log), "--mcap", str(again)]) == 0
    assert states(again) == states(flight.log)
    assert rb.compare(flight.log, again).as_dict()["run"] == []


def test_what_if_in_one_line(flight: Flight, flown: Callable[..., Flight], tmp_path: Path) -> None:
    heavier = tmp_path / "heavier.mcap"
    assert main(["simulate", str(flight.log), "--set", "body.mass=5.5", "--mcap", str(heavier)]) == 0
    assert states(heavier) == states(flown(mass="5.5").log)
    assert main(["compare", str(flight.log), str(heavier), "--bound", "1e-3"]) == 1
    # The new log says what it is, and can be changed again.
    assert main(["replay", str(heavier)]) == 0
    assert main(["simulate", str(heavier), "--set", "body.mass=4.0", "--mcap", str(tmp_path / "back.mcap")]) == 0
    assert states(tmp_path / "back.mcap") == states(flight.log)


def test_commands_act_when_they_did_whatever_their_stamp(tmp_path: Path) -> None:
    """As in the log of a node: stamps are of another clock, the run has no duration, and one command is rejected."""
    scene = rb.parse_scene(SCENE.replace("duration: 3.0\n", ""), "test.yaml")
    log, again = tmp_path / "node.mcap", tmp_path / "again.mcap"
    run = rb.Simulation(scene, [McapSink(log)])
    run.start()
    for topic, wrench in COMMANDS:
        run.advance(wrench.stamp_ns)
        run.post(topic, replace(wrench, stamp_ns=1_700_000_000_000_000_000 - wrench.stamp_ns), wrench.stamp_ns)
    with pytest.raises(rb.WrenchError):
        run.post("push", rb.Wrench((1.0, 0.0, 0.0), frame_id="nowhere"), run.time_ns)
    run.advance(2_600_000_000)
    run.finish()
    assert main(["simulate", str(log), "--mcap", str(again)]) == 0
    assert states(again) == states(log)


def test_a_run_without_a_duration_ends_where_its_recovered_log_does(tmp_path: Path) -> None:
    scene = rb.parse_scene(SCENE.replace("duration: 3.0\n", "").replace("rate: 50.0", "rate: 1000.0"))
    log, cut, whole, again = (tmp_path / f"{name}.mcap" for name in ("node", "cut", "whole", "again"))
    run = rb.Simulation(scene, [McapSink(log)])
    run.start()
    run.advance(2_600_000_000)
    run.finish()
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    assert main(["recover", str(cut), str(whole)]) == 0
    assert main(["simulate", str(whole), "--mcap", str(again)]) == 0
    last_ns = int(read_bag(whole).topics["/pose"].log_times[-1])
    assert 0 < last_ns < 2_600_000_000
    assert read_bag(again).metadata["rb_dynamics.result"]["end_time_ns"] == str(last_ns)


ACTUATED = """\
body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}
wrenches: [{topic: wrench}]
actuators:
  - {type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 0.1}
  - {type: reaction_wheel, name: idle, axis: [0, 1, 0], inertia: 0.1}
duration: 2
"""


@pytest.mark.parametrize("remap", [{}, {"wheel/command": "/elsewhere"}])
def test_actuators_are_commanded_under_any_name(tmp_path: Path, remap: dict[str, str]) -> None:
    log, again = tmp_path / "run.mcap", tmp_path / "again.mcap"
    commands = [("wheel/command", rb.Setpoint(0.1, stamp_ns=500_000_000))]
    rb.simulate(rb.parse_scene(ACTUATED), commands, [McapSink(log, namespace="/sat", remap=remap)])
    assert main(["simulate", str(log), "--mcap", str(again)]) == 0
    assert states(again) == states(log)
    assert main(["explain", str(log)]) == 0


def test_a_move_from_outside_is_said_to_be_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, log = rb.parse_scene(SCENE), tmp_path / "run.mcap"
    run = rb.Simulation(scene, [McapSink(log, namespace="/sat")])
    run.start()
    run.set_state(StateChange.to(rb.State(1_000_000_000, angular_velocity_body=(0.1, 0.2, 0.3)), scene.body))
    run.advance(3_000_000_000)
    run.finish()
    assert main(["simulate", str(log), "--json"]) == 0
    assert "1 states to which the body was moved (set_state) are left out" in capsys.readouterr().err


def test_other_commands_replace_those_of_the_log(flight: Flight, coasting: Flight, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    assert main(["simulate", str(coasting.log), "--wrench", str(flight.log), "--mcap", str(again)]) == 0
    assert states(again) == states(flight.log)


def test_explain_and_body_take_a_log(flight: Flight, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["body", str(flight.log), "--json", "--set", "body.mass=7"]) == 0
    assert json.loads(capsys.readouterr().out)["mass"] == 7.0
    assert main(["explain", str(flight.log), "--duration", "0.2"]) == 0
    assert "thrust" in capsys.readouterr().out


def test_a_bag_of_another_program_is_no_scene(example_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", str(example_dir / "slew.mcap")]) == 2
    said = capsys.readouterr().err
    assert "no log of this package" in said
    assert "simulate SCENE --wrench BAG" in said


def test_a_log_gives_body_and_frames_to_a_bag(example_dir: Path, scene_dir: Path, tmp_path: Path) -> None:
    log = tmp_path / "slew.mcap"
    rb.simulate(rb.read_scene(scene_dir / "slew.yaml", {"duration": 0.1}), sinks=[McapSink(log)])
    assert rb.inspect(example_dir / "slew.mcap", log).track.body == rb.read_scene(scene_dir / "slew.yaml").body
