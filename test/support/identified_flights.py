"""Flights of random bodies with noisy sensors, as `identify` takes them, and the scenes that it starts from."""

from __future__ import annotations

from typing import Any

import numpy as np

from rb_dynamics import RigidBody, State, parse_scene
from rb_dynamics.analysis.identification.flights import ATTITUDE, POSITION, RATES, Flight, Stream, WrenchSeries
from rb_dynamics.analysis.identification.rotations import products, quaternions
from rb_dynamics.run.ensemble import driven_motion
from rb_dynamics.scene.model import Scene

HOLD = 25
"""Samples for which a wrench is held."""

# Pushes in body axes, and a rotor.
GYROSTAT = """
body: {mass: 2, inertia: {diagonal: [0.05, 0.09, 0.11]}}
initial: {angular_velocity_body: [1.5, -2, 1]}
effects:
  - type: scheduled_wrench
    frame_id: body
    schedule:
      - {time: 0, torque: [0.1, -0.05, 0.08], force: [1, 0, 2]}
      - {time: 0.5, torque: [-0.1, 0.1, 0.05], force: [-2, 1, 0]}
      - {time: 1.2, torque: [0.02, 0.08, -0.15], force: [0, 3, -1]}
  - {type: rotor, axis_body: [2, -1, 2], axial_inertia: 1e-4, spin_rate: 300}
duration: 2
output_rate: 50
"""


def random_body(random: Any, center: float = 0.0) -> RigidBody:
    """Return a cloud of eight points of some shape."""
    points = random.standard_normal((8, 3)) * random.uniform(0.1, 0.4, 3)
    points -= points.mean(axis=0)
    second = 2.0 * points.T @ points / 8
    inertia = np.trace(second) * np.eye(3) - second
    return RigidBody.from_matrix(2.0, inertia.tolist(), (center * random.standard_normal(3)).tolist())


def flown(
    body: RigidBody,
    random: Any,
    *,
    seconds: float = 3.0,
    rate: float = 100.0,
    torque: float = 0.0,
    force: float = 0.0,
    spin: Any = None,
    gyro: float = 5e-3,
    pose: float | None = None,
    bias: Any = 0.0,
    recorded_torque: float = 1.0,
    unrecorded: Any = 0.0,
) -> Flight:
    """Return the flight of `body`: `torque` (rad/s^2) and `force` (m/s^2) are the size of what is commanded.

    A gyro measures always, a pose where `pose` (rad, m) is its noise. `unrecorded` (rad/s^2, of each sample) acts, too.
    """
    count = round(seconds * rate)
    times = np.rint(np.arange(count + 1) * 1e9 / rate).astype(np.int64)
    pushes = -(-count // HOLD)
    torques = np.repeat(random.standard_normal((pushes, 3)) * torque * max(body.principal_moments), HOLD, 0)[:count]
    forces = np.repeat(random.standard_normal((pushes, 3)) * force * body.mass, HOLD, 0)[:count]
    omega = 2.0 * random.standard_normal(3) if spin is None else np.array(spin, dtype=np.float64)
    state = State(angular_velocity_body=tuple(omega.tolist()))
    acting = torques + unrecorded * max(body.principal_moments)
    motion = driven_motion(body, state, times[1:], method="rkmk4", step=0.005, torque_body=acting, force_body=forces)
    rates = np.vstack([omega, np.asarray(motion.angular_velocity_body)])
    noisy = rates + bias + gyro * random.standard_normal(rates.shape)
    streams = [Stream("imu", RATES, times, noisy, gyro=True)]
    if pose is not None:
        attitude = np.vstack([[0.0, 0.0, 0.0, 1.0], np.asarray(motion.orientation_xyzw)])
        position = np.vstack([np.zeros(3), np.asarray(motion.position_world)])
        turned = products(attitude, quaternions(pose * random.standard_normal(rates.shape)))
        streams += [
            Stream("pose", ATTITUDE, times, turned),
            Stream("pose", POSITION, times, position + pose * random.standard_normal(rates.shape)),
        ]
    held = np.hstack([forces, recorded_torque * torques, np.zeros((count, 9))])
    channels = (WrenchSeries("wrench", times[:-1], held),) if torque or force else ()
    return Flight("flight", tuple(streams), channels)


def guess(body: RigidBody, moments: Any = (1.0, 1.0, 1.0), scale: float = 1.0) -> Scene:
    """Return a scene whose mass is wrong by a half and whose inertia is near a ball's, both times `scale`."""
    size = float(np.trace(np.array(body.inertia))) / 3.0
    diagonal = [0.8 * scale * size * moment for moment in moments]
    return parse_scene(f"body: {{mass: {1.5 * scale * body.mass}, inertia: {{diagonal: {diagonal}}}}}\n")
