"""The Allan deviation of every sensor's messages, less a truth in closed form, against the noise that was asked for.

The bounds are four standard deviations of the estimate, from the number of differences and their correlation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rb_dynamics as rb

RATE, SECONDS, SPIN, ARM = 10.0, 1000.0, 0.2, np.array([0.3, 0.1, 0.2])
FIELD, SUN = np.array([2.0e-5, 1.0e-5, -4.0e-5]), np.array([0.6, 0.0, 0.8])
SCENE = f"""
body:
  mass: 3
  inertia: {{diagonal: [1, 2, 3]}}
  frames: {{side: {{position: {ARM.tolist()}, orientation: {{x: 0, y: 0, z: 0, w: 1}}}}}}
initial: {{angular_velocity_body: [0, 0, {SPIN}]}}
wrenches: []
effects: [{{type: magnetic_field, model: uniform, field_world: {FIELD.tolist()}}}]
sensors:
  - {{type: imu, name: imu, frame: side, rate: {RATE}, gyro: {{noise_density: 2.0e-4, random_walk: 1.0e-4}},
     accelerometer: {{noise_density: 3.0e-3, random_walk: 3.0e-3}}}}
  - {{type: magnetometer, name: mag, rate: {RATE}, noise_density: 4.0e-8, random_walk: 3.0e-8}}
  - {{type: star_tracker, name: tracker, rate: {RATE}, noise: 1.0e-4}}
  - {{type: sun_sensor, name: sun, rate: {RATE}, direction_world: {SUN.tolist()}, noise: 2.0e-3}}
  - {{type: pose, name: mocap, frame: side, rate: {RATE}, position_noise: 1.0e-3, orientation_noise: 3.0e-3}}
seed: 7
duration: {SECONDS}
output_rate: 0.01
"""


@pytest.fixture(scope="module")
def messages() -> Mapping[str, np.ndarray]:
    """What each sensor gave, one row for each sample."""
    sink = rb.MemorySink()
    rb.simulate(rb.parse_scene(SCENE), sinks=[sink])
    rows: dict[str, list[tuple[float, ...]]] = {}
    for each in sink.measurements:
        rows.setdefault(each.topic, []).append(each.numbers)
    return {name: np.array(found) for name, found in rows.items()}


def errors_of(quantity: str, messages: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return measured less true of a body that spins about z, one column for each axis."""
    turns = Rotation.from_rotvec(np.outer(SPIN / RATE * np.arange(round(RATE * SECONDS) + 1), [0.0, 0.0, 1.0]))
    if quantity == "gyro":
        return np.asarray(messages["imu"][:, 13:16] - [0.0, 0.0, SPIN])
    if quantity == "accelerometer":
        return np.asarray(messages["imu"][:, 25:28] + SPIN**2 * ARM * [1.0, 1.0, 0.0])
    if quantity == "magnetometer":
        return np.asarray(messages["mag"][:, :3] - turns.inv().apply(FIELD))
    if quantity == "position":
        return np.asarray(messages["mocap"][:, :3] - turns.apply(ARM))
    if quantity == "sun":
        # About the two axes across its direction.
        true = turns.inv().apply(SUN)
        across = turns.inv().apply([-SUN[2], 0.0, SUN[0]])
        found = messages["sun"][:, :3]
        return np.column_stack([(found * each).sum(axis=1) for each in (across, np.cross(true, across))])
    attitude = messages["tracker"][:, :4] if quantity == "tracker" else messages["mocap"][:, 3:7]
    return np.asarray((turns.inv() * Rotation.from_quat(attitude)).as_rotvec())


@pytest.mark.parametrize(
    ("quantity", "density", "walk"),
    [
        ("gyro", 2.0e-4, 1.0e-4),
        ("accelerometer", 3.0e-3, 3.0e-3),
        ("magnetometer", 4.0e-8, 3.0e-8),
        # So much in each sample.
        ("tracker", 1.0e-4 / math.sqrt(RATE), 0.0),
        ("sun", 2.0e-3 / math.sqrt(RATE), 0.0),
        ("position", 1.0e-3 / math.sqrt(RATE), 0.0),
        ("orientation", 3.0e-3 / math.sqrt(RATE), 0.0),
    ],
)
def test_is_that_of_the_noise_asked_for(
    quantity: str, density: float, walk: float, messages: Mapping[str, np.ndarray]
) -> None:
    """Its square is N^2 / tau + K^2 tau / 3, as estimated from means over tau that do not overlap."""
    errors = errors_of(quantity, messages)
    for count in (1, 5, 30, 100):
        tau = count / RATE
        means = errors[: len(errors) // count * count].reshape(-1, count, errors.shape[1]).mean(axis=1)
        found = 0.5 * float(np.mean(np.diff(means, axis=0) ** 2))
        # The walk goes in steps, from sample to sample.
        white, wandering = density**2 / tau, walk**2 * tau / 3.0 * (1.0 + 0.5 / count**2)
        # A difference of means and the next have the correlation -1/2 of white noise, and 1/4 of a walk.
        correlation = (0.25 * wandering - 0.5 * white) / (white + wandering)
        spread = math.sqrt(2.0 * (1.0 + 2.0 * correlation**2) / (len(means) - 1) / errors.shape[1])
        assert found / (white + wandering) == pytest.approx(1.0, abs=4.0 * spread)
