"""Quantities of the worked studies: each takes samples of N bodies and returns a number for each, (N,)."""

import numpy as np


def tilt(samples):
    """Return the angle between the angular velocity and body axis y, rad."""
    x, y, z = samples.angular_velocity_body.T
    return np.arctan2(np.sqrt(x * x + z * z), y)


def spin(samples):
    """Return the angular velocity about body axis y, rad/s."""
    return samples.angular_velocity_body[:, 1]


def off_nadir(samples):
    """Return the angle between body axis z, either way, and the vertical, rad."""
    x, y, z, w = samples.orientation_xyzw.T
    axis = (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))
    up = samples.position_world.T
    along = sum(a * b for a, b in zip(axis, up, strict=True))
    length = np.sqrt(sum(b * b for b in up))
    return np.arccos(np.minimum(np.abs(along) / length, 1.0))
