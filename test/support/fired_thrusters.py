"""Flights of a body that three thrusters push, as bags of another program; for tests and `calibrate_thrusters.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from foreign_bags import GEOMETRY, IMU, Row, header, imu, of, pose, write_bag

import rb_dynamics as rb

BEGIN = 1_700_000_000 * 10**9
FITTED = ("mass", "center_of_mass", "inertia")
SCENE = """
body:
  mass: 12
  center_of_mass: [0.02, -0.01, 0.03]
  inertia: {matrix: [[0.3, 0.02, -0.01], [0.02, 0.4, 0.03], [-0.01, 0.03, 0.5]]}
  frames:
    a: {position: [0.3, 0.1, 0], orientation: {x: 0, y: 0, z: 0.7071067811865476, w: 0.7071067811865476}}
    b: {position: [0, 0.3, 0.1], orientation: {x: 0, y: -0.7071067811865476, z: 0, w: 0.7071067811865476}}
    c: {position: [0.1, 0, 0.3], orientation: {x: 0, y: 0, z: 0, w: 1}}
initial: {angular_velocity_body: [0.1, -0.2, 0.15], linear_velocity_world: [0.1, 0, 0]}
actuators:
  - {type: thruster, name: jet_a, frame: a, force: 2, minimum_on: 0.02, delay: 0.015}
  - {type: thruster, name: jet_b, frame: b, force: 1.5, rise: 0.02, fall: 0.04, command: level}
  - {type: thruster, name: jet_c, frame: c, force: 1, rise: 0.01, fall: 0.01}
duration: 8
output_rate: 50
"""


def commands(rng: Any) -> list[tuple[str, rb.Setpoint]]:
    """Return pulses and levels, some replaced before their end, some shorter than may be."""
    times = np.sort(rng.uniform(0.2, 7.5, 30))
    found = []
    for at in times:
        jet = str(rng.choice(["a", "b", "c"]))
        value = float(rng.choice([0.0, 0.5, 1.0, 0.3])) if jet == "b" else float(rng.uniform(0.01, 0.4))
        found.append((f"jet_{jet}/command", rb.Setpoint(value, int(at * 1e9))))
    return found


def recorded(
    folder: Path, scene: rb.Scene, seed: int, noise: float = 1e-4, late: float = 0.0, ahead_ns: int = 0
) -> Path:
    """Fly the scene, and write what another program would: poses, a gyro and the commands, in a namespace.

    The commands are recorded by up to `late` s later than they act, each by another time. The clock of the log times is
    ahead of that of the stamps.
    """
    delays = (1e9 * late * np.random.default_rng([seed, 32]).random(100)).astype(np.int64).tolist()
    rng = np.random.default_rng([seed, 31])
    sent, memory = commands(rng), rb.MemorySink()
    rb.simulate(scene, sent, sinks=[memory])
    rows: list[Row] = [
        (f"/sat/{topic}", "std_msgs/msg/Float64", BEGIN + each.stamp_ns + delay, of("std_msgs/msg/Float64", each.value))
        for (topic, each), delay in zip(sent, delays, strict=False)
    ]
    for sample in memory.samples:
        stamp = BEGIN + sample.time_ns
        turn = np.append(0.5 * noise * rng.standard_normal(3), 1.0)
        x, y, z, w = sample.orientation_xyzw
        (dx, dy, dz, dw), place = turn / np.linalg.norm(turn), noise * rng.standard_normal(3) + sample.position_world
        q = (w * dx + x * dw + y * dz - z * dy, w * dy - x * dz + y * dw + z * dx, w * dz + x * dy - y * dx + z * dw,
             w * dw - x * dx - y * dy - z * dz)  # fmt: skip
        rows.append(
            ("/sat/pose", f"{GEOMETRY}PoseStamped", stamp, of("PoseStamped", header(stamp, "map"), pose((*place, *q))))
        )
        rate = noise * rng.standard_normal(3) + sample.angular_velocity_body
        rows.append(("/sat/imu", IMU, stamp, imu(stamp, (0, 0, 0, 1), rate, (0, 0, 0), (False, True, False))))
    logged = [(topic, type_name, at + ahead_ns, message) for topic, type_name, at, message in rows]
    return write_bag(folder, sorted(logged, key=lambda row: row[2]))


def rough() -> rb.Scene:
    """Return the scene of another body."""
    inertia = "matrix: [[0.3, 0.02, -0.01], [0.02, 0.4, 0.03], [-0.01, 0.03, 0.5]]"
    text = SCENE.replace("mass: 12", "mass: 9").replace("[0.02, -0.01, 0.03]", "[0, 0, 0]")
    return rb.parse_scene(text.replace(inertia, "diagonal: [0.4, 0.4, 0.4]"))


def contained(found: rb.Identification, scene: rb.Scene) -> list[bool]:
    """Return of mass, centre of mass, moments and products whether their interval contains the truth."""
    body = scene.body
    truth = {"mass": body.mass}
    for i, a in enumerate("xyz"):
        truth[f"center_of_mass.{a}"] = body.center_of_mass[i]
        truth |= {f"inertia.{a}{b}": body.inertia[i][j] for j, b in enumerate("xyz") if j >= i}
    within = []
    for number in found.parameters:
        if number.name in truth:
            assert number.interval is not None, number.name
            within.append(number.interval[0] <= truth[number.name] <= number.interval[1])
    return within
