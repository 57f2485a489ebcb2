"""A satellite whose wheels keep it pointed at the Earth for an orbit."""

from __future__ import annotations

import math

import numpy as np

from rb_dynamics import Simulation, parse_scene
from rb_dynamics.numerics import rotation
from rb_dynamics.run.sample import Sample

MU, RADIUS = 3.986004418e14, 6.878e6
RATE = math.sqrt(MU / RADIUS**3)
MOMENTS = np.array([0.05, 0.12, 0.14])
# The orbital frame at the start, turned by 0.27 rad.
START = rotation.multiply((-0.5, -0.5, 0.5, 0.5), rotation.exp((0.1, -0.2, 0.15)))
SCENE = f"""
body: {{mass: 10, inertia: {{diagonal: {MOMENTS.tolist()}}}}}
initial:
  position_world: [{RADIUS}, 0, 0]
  linear_velocity_world: [0, {RATE * RADIUS!r}, 0]
  orientation: {{{", ".join(f"{name}: {each!r}" for name, each in zip("xyzw", START, strict=True))}}}
  angular_velocity_body: [0.001, -0.002, 0.001]
wrenches: []
output_rate: 0.25
effects: [{{type: central_gravity, gravitational_parameter: {MU!r}, gravity_gradient: true}}]
actuators:
  - {{type: reaction_wheel, name: x, axis: [1, 0, 0], inertia: 1.0e-4, command: torque, speed: 50.0}}
  - {{type: reaction_wheel, name: y, axis: [0, 1, 0], inertia: 1.0e-4, command: torque, speed: -60.0}}
  - {{type: reaction_wheel, name: z, axis: [0, 0, 1], inertia: 1.0e-4, command: torque, speed: 70.0}}
solver: {{method: dop853, accuracy: 1.0e-9}}
"""


def off_nadir(sample: Sample) -> tuple[np.ndarray, np.ndarray]:
    """Return the turn from the orbital frame to the body, and its rate, in body axes: z to the Earth, y against h."""
    r, v = np.array(sample.position_world), np.array(sample.linear_velocity_world)
    normal = np.cross(r, v)
    z, y = -r / np.linalg.norm(r), -normal / np.linalg.norm(normal)
    orbital = rotation.from_matrix(np.array([np.cross(y, z), y, z]).T.tolist())
    *error, scalar = rotation.multiply(rotation.conjugate(orbital), sample.orientation_xyzw)
    turning = rotation.rotate_inverse(sample.orientation_xyzw, tuple(normal / (r @ r)))
    return math.copysign(2.0, scalar) * np.array(error), np.array(sample.angular_velocity_body) - turning


def test_wheels_hold_the_nadir_over_an_orbit() -> None:
    """By a proportional and differential torque every 4 s against the turn of the momentum."""
    run = Simulation(parse_scene(SCENE))
    errors, begin = [], run.sample
    for second in range(0, round(2.0 * math.pi / RATE), 4):
        run.advance(second * 10**9)
        now = run.sample
        error, rate = off_nadir(now)
        errors.append(float(np.linalg.norm(error)))
        momentum = MOMENTS * now.angular_velocity_body + 1e-4 * np.array(now.wheel_speeds)
        torque = -MOMENTS * (0.01 * error + 0.14 * rate) + np.cross(now.angular_velocity_body, momentum)
        for name, value in zip("xyz", (-torque).tolist(), strict=True):
            run.actuate(f"{name}/command", value, second * 10**9)
    assert errors[0] > 0.1
    assert max(errors[150:]) < 1e-4
    end = run.sample
    assert abs(end.energy_defect - begin.energy_defect) < 1e-12 * end.kinetic_energy
