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
from rb_dynamics.analysis import impulse, own_log_consistency, track
from rb_dynamics.cli import main
from rb_dynamics.formats import cdr
from rb_dynamics.numerics import growing_array
from rb_dynamics.sinks.mcap_sink import McapSink

SPIN = """
body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}
initial: {angular_velocity_body: [0.1, 2, 0.1]}
solver: {method: exact}
output_rate: 100
"""


def test_of_our_own_log(flight: Flight) -> None:
    found = rb.inspect(flight.log)

    assert found.passed
    assert found.track.twist is not None
    assert np.allclose(found.track.twist.values[-1, 3:], flight.result.sample.angular_velocity_body)


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


def test_memory_hardly_grows_with_a_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The numbers of a sample, some 200 bytes, stand in files; its time is kept, and what is sorted for a while."""
    for name in ("_IN_MEMORY", "_WAITING"):
        monkeypatch.setattr(growing_array, name, 2**12)
    for module in (track, impulse, own_log_consistency):
        monkeypatch.setattr(module, "_BLOCK", 1000)
    peaks = []
    for samples in (6000, 11000):
        scene = rb.parse_scene(SPIN, overrides={"duration": 0.01 * samples})
        rb.simulate(scene, sinks=[McapSink(tmp_path / "run.mcap")])
        tracemalloc.start()
        try:
            rb.inspect(tmp_path / "run.mcap")
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert (peaks[1] - peaks[0]) / 5000 < 100
