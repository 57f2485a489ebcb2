"""`inspect` called from Python and scripts gives the same results as on the terminal."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from recorded_runs import Flight

import rb_dynamics as rb
from rb_dynamics.cli import main
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


def test_memory_grows_no_faster_than_the_numbers_of_a_log(tmp_path: Path) -> None:
    """What is kept of a sample is its some 70 numbers, 600 bytes; as messages they would be several kB."""
    peaks = []
    for samples in (1000, 6000):
        scene = rb.parse_scene(SPIN, overrides={"duration": 0.01 * samples})
        rb.simulate(scene, sinks=[McapSink(tmp_path / "run.mcap")])
        tracemalloc.start()
        try:
            rb.inspect(tmp_path / "run.mcap")
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert (peaks[1] - peaks[0]) / 5000 < 1000
