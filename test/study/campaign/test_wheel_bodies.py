"""Campaigns of satellites with wheels and sensors side by side: the rows of each run alone."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import write

from rb_dynamics.numerics.compilation import available
from rb_dynamics.run.sample_arrays import Samples
from rb_dynamics.study.campaign import block_of_runs
from rb_dynamics.study.campaign.block_of_runs import simulate_alone, simulate_block, watch_runs
from rb_dynamics.study.campaign.engine import SIDE_BY_SIDE, _block, goes_alone
from rb_dynamics.study.campaign.model import Campaign
from rb_dynamics.study.campaign.read import read_campaign

# The first test compiles the kernels.
pytestmark = [pytest.mark.skipif(not available(), reason="needs numba"), pytest.mark.timeout(600)]

WHEEL = "inertia: 1.0e-4, max_torque: 5.0e-4, max_speed: 12.0, friction: {coulomb: 2.0e-5, viscous: 1.0e-7}"
SATELLITE = f"""\
body:
  mass: 10.0
  inertia: {{diagonal: [0.05, 0.12, 0.14]}}
  center_of_mass: [0.01, 0.0, 0.02]
  frames:
    skew: {{position: [0.1, 0, 0], orientation: {{x: 0.6, y: 0, z: 0, w: 0.8}}}}
initial: {{position_world: [6.9e+6, 0, 0], linear_velocity_world: [0, 0, 7612.6],
  angular_velocity_body: [0.01, -0.02, 0.015]}}
wrenches: []
effects: [{{type: central_gravity, gravitational_parameter: 3.986e+14, gravity_gradient: true}}]
actuators:
  - {{type: reaction_wheel, name: x, axis: [1, 0, 0], {WHEEL}}}
  - {{type: reaction_wheel, name: y, axis: [0, 1, 0], {WHEEL}, speed: 3.0}}
  - {{type: reaction_wheel, name: z, axis: [0, 0, 1], {WHEEL}}}
sensors:
  - {{type: imu, name: imu, frame: skew, rate: 10.0, delay: 0.03, dropout: 0.2,
     gyro: {{bias: [0, 0, 0], noise_density: 1.0e-4, random_walk: 1.0e-5, misalignment: [0.01, 0, 0],
       range: 0.05, resolution: 1.0e-5}}}}
  - {{type: star_tracker, name: tracker, frame: skew, rate: 3.0, noise: 1.0e-3, delay: 0.1, dropout: 0.1}}
solver: {{accuracy: 1.0e-7}}
duration: 4.0
output_rate: 4
"""
CAMPAIGN = """\
scene: scene.yaml
runs: 6
seed: 3
sampling: random
disperse:
  initial.angular_velocity_body: {normal: {deviation: 0.01}}
  body.inertia: {second_moments: 0.1, axes: 0.05}
  actuators.x.max_torque: {normal: {relative: 0.1}}
  sensors.imu.gyro.bias: {normal: {deviation: 1.0e-3}}
  control.delay: {choice: {values: [0.0, 0.07, 0.25]}}
control: {law: attitude_pd, rate: 5, delay: 0, through: [x, y, z], parameters: {proportional: 0.02, derivative: 0.05}}
metrics:
  final_rate: {final: rate}
  attitude: {final: attitude}
  energy_defect: {worst: energy_defect}
  energy: {final: energy}
  speed: {worst: wheel_speed}
  rejected: {final: rejected_commands}
  clipped: {final: clipped_commands}
"""
LAW = """\
import numpy as np


def law(parameters):
    calls, kept = 0, []

    def command(measured):
        nonlocal calls
        calls += 1
        rate = measured.angular_velocity_body
        found = {axis: 0.05 * rate[:, i] for i, axis in enumerate("xyz") if calls % (i + 2)}
        BODY
        return found

    return command
"""


@pytest.fixture(autouse=True)
def _compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")


def require_rows_of_runs_alone(campaign: Campaign, runs: int) -> dict[str, Any]:
    """Fly a block side by side, and require each run alone to have its row, to the bit."""
    rows = simulate_block(campaign, 0, runs)
    assert not any(rows["error"])
    for run in range(runs):
        for name, value in simulate_alone(campaign, run).items():
            assert rows[name][run] == value, (run, name)
    return rows


def without_wheels(scene: str, campaign: str) -> tuple[str, str]:
    """Return scene and campaign without wheels, by a method that they need then."""
    scene = re.sub(r"  - {type: reaction_wheel.*\n", "", scene).replace(
        "solver: {accuracy", "solver: {method: dop853, accuracy"
    )
    return scene, re.sub(r"  actuators.x.*\n|  speed: .*\n", "", campaign)


def alone_in(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list that will have the runs of blocks that are executed alone."""
    found: list[int] = []
    fly = block_of_runs._fly_alone

    def noted(campaign: Campaign, run: Any) -> Any:
        found.append(run.number)
        return fly(campaign, run)

    monkeypatch.setattr(block_of_runs, "_fly_alone", noted)
    return found


@pytest.mark.parametrize(
    "solver", ["accuracy: 1.0e-7", pytest.param("method: dop853, step: 0.05", marks=pytest.mark.slow), "step: 0.05"]
)
def test_runs_side_by_side_are_runs_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, solver: str) -> None:
    """With delays, lost samples, wandering biases, wheels at rest and at their limits; some begin too late."""
    apart = alone_in(monkeypatch)
    campaign = read_campaign(write(tmp_path, CAMPAIGN, SATELLITE.replace("accuracy: 1.0e-7", solver)))
    rows = require_rows_of_runs_alone(campaign, 6)

    assert len(set(apart)) == len(apart) < 3
    assert min(rows["clipped"]) > 0.0
    assert max(rows["speed"]) == pytest.approx(12.0)
    parts = [simulate_block(campaign, first, last) for first, last in ((0, 2), (2, 6))]
    for name in ("final_rate", "speed", "energy_defect"):
        assert np.concatenate([part[name] for part in parts]).tolist() == rows[name].tolist()


def test_runs_without_a_controller_or_sensors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    apart = alone_in(monkeypatch)
    coasting = re.sub(r"control: .*\n", "", CAMPAIGN).replace(
        "  control.delay: {choice: {values: [0.0, 0.07, 0.25]}}\n", ""
    )
    require_rows_of_runs_alone(read_campaign(write(tmp_path, coasting, SATELLITE)), 3)
    scene = re.sub(r"sensors:.*solver", "solver", SATELLITE, flags=re.DOTALL)
    ideal = re.sub(r"  sensors.imu.*\n", "", CAMPAIGN)
    require_rows_of_runs_alone(read_campaign(write(tmp_path, ideal, scene)), 3)
    assert not apart


@pytest.mark.parametrize(
    ("body", "alone"),
    [
        ("pass", False),
        # What a law reads a period later is of that time.
        (
            "kept.append(measured)\n        if calls > 3:\n            found['y'] = 1e-4 * kept[-3].wheel_speeds['x']",
            False,
        ),
        (
            "found['x'] = 0.1 * measured.sensors['imu'].angular_velocity[:, 0] + measured.wheel_speeds['y'] * 1e-5",
            False,
        ),
        # Read from the start or later, the runs are repeated with accelerometers.
        pytest.param("found['x'] = 1e-3 * measured.sensors['imu'].specific_force[:, 0]", False, marks=pytest.mark.slow),
        ("found['y'] = 1e-3 * (measured.sensors['imu'].specific_force[:, 1] if calls > 9 else rate[:, 1])", False),
        ("found['force'] = 0.001 * rate", True),
    ],
)
def test_laws_of_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str, alone: bool) -> None:
    """They may command some wheels at a time; if they ask for more than there is side by side, the runs go alone."""
    apart = alone_in(monkeypatch)
    (tmp_path / "own.py").write_text(LAW.replace("BODY", body), encoding="utf-8")
    text = re.sub(r"law: attitude_pd(.*) through: \[x, y, z\],", r"law: own.law\1", CAMPAIGN)
    require_rows_of_runs_alone(read_campaign(write(tmp_path, text, SATELLITE.replace("dropout: 0.2", "dropout: 0"))), 4)
    assert (sorted(apart) == [0, 1, 2, 3]) == alone


def test_a_run_whose_step_is_refused_is_a_row(tmp_path: Path) -> None:
    """A step of 0.05 s suits friction of 1e-7 N m s/rad on 1e-4 kg m^2, not of 0.1."""
    friction = "actuators.x.friction.viscous: {choice: {values: [1.0e-7, 0.1]}}"
    campaign = CAMPAIGN.replace("actuators.x.max_torque: {normal: {relative: 0.1}}", friction)
    scene = SATELLITE.replace("accuracy: 1.0e-7", "method: dop853, step: 0.05")
    rows = simulate_block(read_campaign(write(tmp_path, campaign, scene)), 0, 6)
    for viscous, error in zip(rows["actuators.x.friction.viscous"], rows["error"], strict=True):
        assert ("x is slowed by its viscous friction within 0.001 s" in error) == (viscous > 0.01)
    assert 0 < sum(map(bool, rows["error"])) < 6


def test_a_torque_that_a_wheel_rejects_alone_does_not_act_side_by_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """1e9 N m on 1e-4 kg m^2: the wheel keeps the torque before."""
    apart = alone_in(monkeypatch)
    body = "found['x'] = np.where((rate[:, 0] > 0.01) & (calls == 5), 1e9, found.get('x', 0.0))"
    (tmp_path / "own.py").write_text(LAW.replace("BODY", body), encoding="utf-8")
    text = re.sub(r"law: attitude_pd(.*) through: \[x, y, z\],", r"law: own.law\1", CAMPAIGN)
    text = re.sub(r"  actuators.x.max_torque.*\n", "", text)
    rows = require_rows_of_runs_alone(
        read_campaign(write(tmp_path, text, SATELLITE.replace("max_torque: 5.0e-4, ", "", 1))), 6
    )
    assert 0 < (rows["rejected"] > 0.0).sum() <= len(apart) < 6


@pytest.mark.parametrize(
    ("field", "wheels"),
    [
        ("dipole, moment_world: [1.0e+22, 0, -7.8e+22]", True),
        ("uniform, field_world: [2.0e-5, 0, 3.0e-5]", True),
        pytest.param("uniform, field_world: [2.0e-5, 0, 3.0e-5]", False, marks=pytest.mark.slow),
    ],
)
def test_magnetorquers_and_magnetometers_go_side_by_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, field: str, wheels: bool
) -> None:
    """Each run with a delay of its own, up to more than two periods; dipoles that are not commanded at every sample."""
    apart = alone_in(monkeypatch)
    entry = f"{{type: magnetic_field, model: {field}}}"
    devices = """\
  - {type: magnetorquer, name: rod_a, axis: [1, 1, 0], max_dipole: 20.0}
  - {type: magnetorquer, name: rod_b, axis: [0, 0, -2], max_dipole: 5.0}
sensors:
  - {type: magnetometer, name: mag, frame: skew, rate: 4.0, noise_density: 1.0e-7, random_walk: 1.0e-8,
     bias: [1.0e-6, 0, 0]}
"""
    scene = SATELLITE.replace("gradient: true}]", f"gradient: true}}, {entry}]").replace("sensors:\n", devices)
    body = """
        if calls % 3 != 1:
            found["rod_a"] = 2.0e7 * measured.sensors["mag"].magnetic_field[:, 1] * rate[:, 0]
        found["rod_b"] = 3.0e7 * measured.magnetic_field_world[:, 2] * rate[:, 1] * (calls % 2)
        found = {name: value for name, value in found.items() if name in measured.wheel_speeds or name[:3] == "rod"}
"""
    (tmp_path / "own.py").write_text(LAW.replace("        BODY\n", body), encoding="utf-8")
    text = re.sub(r"law: attitude_pd(.*) through: \[x, y, z\],", r"law: own.law\1", CAMPAIGN)
    text = text.replace("choice: {values: [0.0, 0.07, 0.25]}", "uniform: {low: 0.0, high: 0.45}")
    if not wheels:
        scene, text = without_wheels(scene, text)
    rows = require_rows_of_runs_alone(read_campaign(write(tmp_path, text, scene)), 6)
    still = simulate_block(
        read_campaign(write(tmp_path, text, scene.replace("max_dipole: 20.0", "max_dipole: 1.0e-9"))), 0, 6
    )
    assert len(apart) < 6
    assert (rows["final_rate"] != still["final_rate"]).all()


@pytest.mark.parametrize("wheels", [True, False])
def test_thrusters_and_accelerometers_go_side_by_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wheels: bool
) -> None:
    """Each run with delays and forces of its own; commands that are too short or too large are counted."""
    apart = alone_in(monkeypatch)
    devices = """\
  - {type: thruster, name: jet, frame: skew, force: 0.05, minimum_on: 0.02, delay: 0.01}
  - {type: thruster, name: valve, frame: skew, force: 0.02, command: level}
sensors:
"""
    scene = SATELLITE.replace("sensors:\n", devices)
    scene = scene.replace(
        "gyro:", "accelerometer: {bias: [0, 1.0e-3, 0], noise_density: 1.0e-3, random_walk: 1.0e-4},\n     gyro:"
    )
    body = """
        felt = measured.sensors["imu"].specific_force
        found["jet"] = np.where(rate[:, 0] > 0.0, np.abs(rate[:, 1]) * 10.0 + np.abs(felt[:, 0]), 0.0)
        if calls % 3:
            found["valve"] = 50.0 * rate[:, 2]
"""
    text = re.sub(r"law: attitude_pd(.*) through: \[x, y, z\],", r"law: own.law\1", CAMPAIGN)
    text = text.replace("choice: {values: [0.0, 0.07, 0.25]}", "uniform: {low: 0.0, high: 0.45}")
    text = text.replace("disperse:\n", "disperse:\n  actuators.jet.force: {uniform: {low: 0.04, high: 0.06}}\n")
    text = text.replace("disperse:\n", "disperse:\n  body.mass: {uniform: {low: 9.0, high: 11.0}}\n")
    if not wheels:
        scene, text = without_wheels(scene, text)
        body = "\n        found = {}" + body
    (tmp_path / "own.py").write_text(LAW.replace("        BODY\n", body), encoding="utf-8")
    rows = require_rows_of_runs_alone(read_campaign(write(tmp_path, text, scene)), 6)
    assert len(apart) < 3
    assert rows["clipped"].max() > 0.0
    assert rows["rejected"].max() > 0.0


def test_sun_sensors_go_side_by_side(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A law is called before the sun comes into view, which it does at other times in each run, and never in some."""
    apart = alone_in(monkeypatch)
    sun = "  - {type: sun_sensor, name: sun, frame: skew, rate: 4.0, direction_world: [1, 0, 1], noise: 1.0e-3, VIEW}\n"
    scene = SATELLITE.replace("sensors:\n", "sensors:\n" + sun).replace("dropout: 0.2", "dropout: 0")
    scene = scene.replace("[0.01, -0.02, 0.015]", "[0.01, -0.3, 0.015]")
    body = """
        seen = measured.sensors["sun"].direction[:, 2]
        found["x"] = np.where(np.isnan(seen), 0.0, 1.0e-4 * seen)
"""
    (tmp_path / "own.py").write_text(LAW.replace("        BODY\n", body), encoding="utf-8")
    text = re.sub(r"law: attitude_pd(.*) through: \[x, y, z\],", r"law: own.law\1", CAMPAIGN)
    text = text.replace("{normal: {deviation: 0.01}}", "{normal: {deviation: 0.1}}")
    rates = []
    for view in ("field_of_view: 0.9", "field_of_view: 1.0e-6"):
        rows = require_rows_of_runs_alone(read_campaign(write(tmp_path, text, scene.replace("VIEW", view))), 6)
        rates.append(rows["final_rate"])
    assert len(apart) < 4
    assert 0 < (rates[0] != rates[1]).sum() < 6


def test_a_law_that_fails_for_one_run_fails_that_run(tmp_path: Path) -> None:
    body = "if (rate[:, 0] > 0.01).any() and calls > 8:\n            raise ValueError('too fast')"
    (tmp_path / "own.py").write_text(LAW.replace("BODY", body), encoding="utf-8")
    text = re.sub(r"law: attitude_pd(.*) through: \[x, y, z\],", r"law: own.law\1", CAMPAIGN)
    campaign = read_campaign(write(tmp_path, text, SATELLITE))
    whole, single = simulate_block(campaign, 0, 6), [simulate_block(campaign, run, run + 1) for run in range(6)]
    assert whole["error"] == [row["error"][0] for row in single]
    assert 0 < sum(map(bool, whole["error"])) < 6
    assert whole["energy"].tolist() == pytest.approx([row["energy"][0] for row in single], rel=0.0, nan_ok=True)


def test_blocks_are_large_where_runs_go_side_by_side(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And small where kernels may be missing: each run then takes as long as alone."""
    campaign = read_campaign(write(tmp_path, CAMPAIGN.replace("runs: 6", "runs: 100000"), SATELLITE))
    assert _block(campaign, 2) == SIDE_BY_SIDE
    # The note that runs go one by one stood before a user's law, too, whose runs went side by side.
    assert not goes_alone(campaign)
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    assert _block(campaign, 2) < SIDE_BY_SIDE
    assert simulate_block(campaign, 0, 1)["error"] == [""]


def test_runs_with_wheels_are_watched_for_the_page(tmp_path: Path) -> None:
    campaign = read_campaign(write(tmp_path, CAMPAIGN, SATELLITE))
    seen: list[Samples] = []
    watch_runs(campaign, [1, 4], seen.append)

    assert [len(samples.wheel_speeds) for samples in seen] == [2] * 21
    speeds = np.abs([samples.wheel_speeds for samples in seen]).max(axis=(0, 2))
    assert speeds.tolist() == [simulate_alone(campaign, run)["speed"] for run in (1, 4)]


def test_runs_that_need_more_than_wheels_are_not_watched(tmp_path: Path) -> None:
    (tmp_path / "pushing.py").write_text(LAW.replace("BODY", "found['force'] = 0.0 * rate"))
    text = re.sub(r"law: attitude_pd(.*), through: .*", r"law: pushing.law\1}", CAMPAIGN)
    campaign = read_campaign(write(tmp_path, text, SATELLITE))
    with pytest.raises(ValueError, match="side by side"):
        watch_runs(campaign, [1, 4], lambda _: None)
