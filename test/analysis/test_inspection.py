"""`inspect` called from Python and scripts gives the same results as on the terminal."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from recorded_runs import Flight

import rb_dynamics as rb
from rb_dynamics.cli import main


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
