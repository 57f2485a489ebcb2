"""`inspect` called from Python and scripts gives the same results as on the terminal."""

from __future__ import annotations

import json
import math
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from bag_rows import write_rows
from recorded_runs import Flight

import rb_dynamics as rb
from rb_dynamics.analysis import impulse, own_log_consistency, track, twist_calibration
from rb_dynamics.analysis.read_track import TopicChoice
from rb_dynamics.cli import main
from rb_dynamics.formats import cdr, mcap_records
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.numerics import growing_array
from rb_dynamics.report.inspection_text import as_text
from rb_dynamics.sinks.mcap_sink import McapSink

SPIN = """
body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}
initial: {angular_velocity_body: [0.1, 2, 0.1]}
solver: {method: exact}
output_rate: 100
"""
WRONG = SPIN.replace("[1, 2, 3]", "[1.2, 2, 2.7]")


def test_of_our_own_log(flight: Flight) -> None:
    found = rb.inspect(flight.log)

    assert found.passed
    assert found.track.twist is not None
    assert np.allclose(found.track.twist.values[-1, 3:], flight.result.sample.angular_velocity_body)


SENSED = """
body:
  mass: 3
  inertia: {diagonal: [0.05, 0.07, 0.09]}
  frames: {box: {position: [0.1, 0, 0], orientation: {x: 0.6, y: 0, z: 0, w: 0.8}}}
initial: {angular_velocity_body: [0.8, 0.5, 0.3]}
wrenches: []
sensors:
  - {type: imu, name: imu, frame: box, rate: 100, gyro: {noise_density: 1.0e-5}}
  - {type: pose, name: cam, rate: 100, position_noise: 1.0e-4, orientation_noise: 1.0e-4}
  - {type: star_tracker, name: tracker, frame: box, rate: 100, noise: 1.0e-4}
duration: 10
"""


@pytest.mark.parametrize("pose", ["/cam", "/tracker"])
def test_sensors_of_our_own_log_are_judged_without_its_true_motion(tmp_path: Path, pose: str) -> None:
    """The exact momenta of the run were held against poses with noise: the log was said not to fit its scene."""
    rb.simulate(rb.parse_scene(SENSED), sinks=[McapSink(tmp_path / "a.mcap")])
    choice = TopicChoice(pose=pose, twist="imu")
    wrong = rb.parse_scene(SENSED.replace("[0.05, 0.07, 0.09]", "[0.05, 0.07, 0.095]"))

    found = rb.inspect(tmp_path / "a.mcap", topics=choice)
    assert found.passed
    assert [each.topic for each in found.track.motion] == [pose, "/imu"]
    assert found.summary.sensed
    assert found.summary.residual is not None
    assert found.summary.residual.explained
    assert "nan" not in as_text(found.summary)
    other = rb.inspect(tmp_path / "a.mcap", wrong, topics=choice)
    assert [each.name for each in other.summary.checks if not each.passed] == ["inertia explains the motion"]


@pytest.mark.parametrize("ramp", ["", ", rise: 0.2, fall: 0.3"])
def test_beside_sensors_of_our_own_log_it_is_known_what_its_thrusters_did(tmp_path: Path, ramp: str) -> None:
    """A log has the force of a ramp at outputs alone; it follows from the commands."""
    scene = SENSED + f"actuators: [{{type: thruster, name: jet, frame: box, force: 2{ramp}}}]\noutput_rate: 2\n"
    fired = [("jet/command", rb.Setpoint(1.0, 2_100_000_000))]
    rb.simulate(rb.parse_scene(scene), fired, sinks=[McapSink(tmp_path / "a.mcap")])
    found = rb.inspect(tmp_path / "a.mcap", topics=TopicChoice(pose="/cam", twist="imu")).summary
    assert [(each.judged, each.passed) for each in found.checks if "inertia explains" in each.name] == [(True, True)]
    assert found.residual is not None
    assert found.residual.mass == pytest.approx(3.0, rel=1e-3)


def test_a_foreign_bag_with_the_scene_as_a_value_or_a_file(example_dir: Path, scene_dir: Path) -> None:
    bag, scene = example_dir / "slew.mcap", scene_dir / "slew.yaml"
    by_file, by_value = rb.inspect(bag, scene), rb.inspect(bag, rb.read_scene(scene))

    assert by_file.passed
    assert by_file.as_dict() == by_value.as_dict()
    assert by_file.as_dict()["residual"]["explained"] is True


def test_a_message_that_cannot_be_read_stops_neither_inspect_nor_compare(tmp_path: Path) -> None:
    pose, twist = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"
    rows = []
    for k in range(100):
        at, turn = 10_000_000 * k, 0.005 * k
        place = (0.0, 0.0, 0.0, 0.0, 0.0, math.sin(turn), math.cos(turn))
        data = cdr.encode(pose, at, "world", place)
        rows.append(("/pose", pose, at, data[:-30] if k in (40, 60) else data))
        rows.append(("/twist", twist, at, cdr.encode(twist, at, "body", (0.0, 0.0, 0.0, 0.0, 0.0, 1.0))))
    bag = write_rows(tmp_path / "damaged.mcap", rows)
    found = rb.inspect(bag).as_dict()
    failed = {check["name"]: check["detail"] for check in found["checks"] if not check["passed"]}
    assert failed == {"/pose is whole": "2 of 100 messages are cut short or damaged, the first is number 41"}
    notes = rb.compare(bag, bag).notes
    assert any("2 of 100 messages of /pose are cut short or damaged, and left out" in note for note in notes)


def test_a_diagnostic_message_that_cannot_be_read_is_left_out_and_told(tmp_path: Path) -> None:
    pose, health = "geometry_msgs/msg/PoseStamped", "diagnostic_msgs/msg/DiagnosticArray"
    rows = []
    for k in range(10):
        at = 10_000_000 * k
        rows.append(("/pose", pose, at, cdr.encode(pose, at, "world", (0.1 * k, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))))
        data = cdr.encode(health, at, "", [(0, "rb_dynamics", f"message {k}", "", [])])
        rows.append(("/diagnostics", health, at, data[:-6] if k in (4, 9) else data))
    found = rb.inspect(write_rows(tmp_path / "damaged.mcap", rows)).summary
    failed = {check.name: check.detail for check in found.checks if not check.passed}
    assert failed == {"/diagnostics is whole": "2 of 10 messages are cut short or damaged, the first is number 5"}
    assert found.health is not None
    assert found.health.message == "message 8"


def test_a_stricter_bound_fails_a_balance(flight: Flight) -> None:
    assert not rb.inspect(flight.log, bound=1e-300).passed


def test_json_has_what_python_has(flight: Flight, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(flight.log), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)

    assert said == rb.inspect(flight.log).as_dict()
    assert {balance["name"] for balance in said["balances"]} >= {"energy", "angular momentum", "linear momentum"}


def test_what_is_no_scene_is_named(flight: Flight) -> None:
    with pytest.raises(TypeError, match="scene"):
        rb.inspect(flight.log, 3)  # type: ignore[arg-type]


def small_blocks(monkeypatch: pytest.MonkeyPatch, rows: int) -> None:
    for name in ("_IN_MEMORY", "_WAITING"):
        monkeypatch.setattr(growing_array, name, 2**12)
    for module in (track, impulse, own_log_consistency):
        monkeypatch.setattr(module, "_BLOCK", rows)
    # Whether a chunk that is read ahead stands beside the peak depends on how busy the machine is.
    monkeypatch.setattr(mcap_records, "one_ahead", iter)


def peak_of_inspect(path: Path, scene: rb.Scene | None = None) -> int:
    tracemalloc.start()
    try:
        rb.inspect(path, scene)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def spun(path: Path, samples: int) -> Path:
    scene = rb.parse_scene(SPIN, overrides={"duration": 0.01 * samples})
    rb.simulate(scene, sinks=[McapSink(path)])
    return path


def odometry_of(log: Path, bag: Path, factor: float = 1.0) -> Path:
    """Copy the motion as another program records it, with what it says of the rates multiplied by a factor."""
    kind = "nav_msgs/msg/Odometry"
    rows = []
    for message in open_source(log).messages():
        if message.channel.topic == "/odom":
            values = [*cdr.decode(kind, message.data)]
            values[5] = tuple(factor * value for value in values[5])
            rows.append(("/odom", kind, message.log_time, cdr.encode(kind, *values)))
    return write_rows(bag, rows)


def test_memory_hardly_grows_with_a_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The numbers of a sample, some 200 bytes, stand in files, from the first full block on."""
    small_blocks(monkeypatch, 1000)
    # The first one also fills what stays for the next: modules, tables. One peak may be 0.75 MB higher than another, as
    # a busy machine reads ahead at other times.
    logs = [spun(tmp_path / f"{samples}.mcap", samples) for samples in (1000, 6000, 36000)]
    peaks = [min(peak_of_inspect(log) for _ in range(2)) for log in logs]
    assert (peaks[2] - peaks[1]) / 30000 < 50


@pytest.mark.parametrize(("with_scene", "bytes_each"), [(False, 50), pytest.param(True, 120, marks=pytest.mark.slow)])
def test_memory_grows_little_with_a_bag(
    with_scene: bool, bytes_each: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is computed of each message, some 1000 bytes with the wrong body, stands in files, too."""
    small_blocks(monkeypatch, 500)
    monkeypatch.setattr(twist_calibration, "_MOST_BLOCKS", 500)
    scene, factor = (rb.parse_scene(WRONG), 1.0) if with_scene else (None, 1.01)
    log = tmp_path / "run.mcap"
    bags = [odometry_of(spun(log, samples), tmp_path / f"{samples}.mcap", factor) for samples in (1000, 3000, 8000)]
    peaks = [peak_of_inspect(bag, scene) for bag in bags]
    assert (peaks[2] - peaks[1]) / 5000 < bytes_each


def test_blocks_of_a_bag_change_no_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log, scene = spun(tmp_path / "run.mcap", 2000), rb.parse_scene(WRONG)
    faster, true = (odometry_of(log, tmp_path / f"{factor}.mcap", factor) for factor in (1.07, 1.0))
    whole, judged = rb.inspect(faster), rb.inspect(true, scene).summary
    assert not whole.passed
    small_blocks(monkeypatch, 37)
    assert rb.inspect(faster).as_dict() == whole.as_dict()
    # The sums of a fit are added up in another order.
    parts = rb.inspect(true, scene).summary
    assert [check.passed for check in parts.checks] == [check.passed for check in judged.checks]
    assert parts.residual is not None
    assert judged.residual is not None
    np.testing.assert_allclose(parts.residual.inertia, judged.residual.inertia, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(parts.residual.torque_body, judged.residual.torque_body, rtol=1e-9, atol=1e-9)
