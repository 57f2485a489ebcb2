"""Detumble, slew and hold: wheels turn the satellite, magnetorquers take the momentum out of the wheels.

The same function flies the campaign and, in `examples/spacecraft.py`, the node.
"""

import numpy as np

AXES = "xyz"
WHEEL_INERTIA = 3.0e-5  # kg m^2
TURNED, FAST = 0.5, 0.08  # rad, rad/s: the error that is followed at most, the rate above which only the rate counts


def law(parameters):
    """Return the controller of a campaign; parameters are arrays (N,), the target (N, 4)."""
    gains = [parameters[name][:, None] for name in ("stiffness", "damping", "unloading")]

    def command(measured):
        speeds = np.stack([measured.wheel_speeds[f"wheel_{axis}"] for axis in AXES], axis=-1)
        field = measured.sensors["mag"].magnetic_field
        attitude, rate = measured.orientation_xyzw, measured.angular_velocity_body
        return commands(attitude, rate, field, speeds, parameters["target"], *gains)

    return command


def commands(attitude, rate, field, speeds, target, stiffness, damping, unloading):
    """Return torques of the wheels (N m) and dipoles of the rods (A m^2), each (N,), by name."""
    error = rotation_from(target, attitude)
    size = np.sqrt(dot(error, error))[:, None]
    followed = error * np.minimum(1.0, TURNED / np.maximum(size, TURNED))
    tumbling = np.sqrt(dot(rate, rate))[:, None] > FAST
    # The torque on a wheel is the opposite of that on the body.
    wheels = damping * rate + np.where(tumbling, 0.0, stiffness * followed)
    # m x B is the part across B of -unloading * momentum.
    rods = -unloading * WHEEL_INERTIA * np.cross(field, speeds) / dot(field, field)[:, None]
    return {
        **{f"wheel_{axis}": wheels[:, i] for i, axis in enumerate(AXES)},
        **{f"rod_{axis}": rods[:, i] for i, axis in enumerate(AXES)},
    }


def rotation_from(target, attitude):
    """Return twice the vector part of the shorter rotation from `target` to `attitude`, body axes."""
    a, b, c, d = target.T
    x, y, z, w = attitude.T
    vector = (
        d * x - a * w - b * z + c * y,
        d * y + a * z - b * w - c * x,
        d * z - a * y + b * x - c * w,
    )
    sign = np.where(d * w + a * x + b * y + c * z < 0.0, -2.0, 2.0)
    return np.stack([sign * part for part in vector], axis=-1)


def dot(a, b):
    """Return the product of each pair of vectors, (N,)."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]
