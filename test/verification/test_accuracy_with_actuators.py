"""The accuracy asked for holds under stiff friction and short pulses: attitude, rates and speeds against scipy."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import rb_dynamics as rb

INERTIA = np.array([[0.05, 0.001, 0.0], [0.001, 0.12, 0.002], [0.0, 0.002, 0.14]])
OMEGA, ARM, FORCE = np.array([0.02, -0.03, 0.04]), np.array([0.1, 0.2, 0.05]), np.array([0.0, 0.5, 0.0])
SECONDS, PULSE = 4, 0.002
SCENE = f"""
body:
  mass: 10
  inertia: {{matrix: {INERTIA.tolist()}}}
  frames:
    jet: {{position: {ARM.tolist()}, orientation: {{x: 0, y: 0, z: 0.7071067811865476, w: 0.7071067811865476}}}}
initial: {{angular_velocity_body: {OMEGA.tolist()}}}
wrenches: []
duration: {SECONDS}
output_rate: 1
solver: SOLVER
actuators:
  - {{type: thruster, name: jet, frame: jet, force: 0.5, delay: 0.002}}
"""


class Wheel(NamedTuple):
    """A wheel, and the torque of its motor in each second: larger than its Coulomb friction."""

    axis: tuple[float, float, float]
    inertia: float
    viscous: float
    coulomb: float
    torques: tuple[float, ...]


# Friction slows them within 1 ms and 0.5 ms; the second passes rest with each torque of another sign.
STIFF = (
    Wheel((0.6, 0.8, 0.0), 1e-4, 0.1, 0.0, (1e-2, -3e-2, 5e-3, 1e-2)),
    Wheel((0.0, 0.0, 1.0), 2e-4, 0.4, 2e-4, (-2e-2, 1e-2, 4e-2, -4e-2)),
)
FREE = (Wheel((0.6, 0.8, 0.0), 1e-4, 0.0, 0.0, (1e-4,) * SECONDS),)


@cache
def reference(wheels: tuple[Wheel, ...]) -> tuple[Any, Any, Any]:
    """Return attitude (matrix), rate and wheel speeds, by momenta in body axes, from edge to edge and rest to rest."""
    count = len(wheels)
    axes = np.array([wheel.axis for wheel in wheels]).reshape(-1, 3)
    j, viscous, coulomb = np.array([wheel[1:4] for wheel in wheels]).reshape(-1, 3).T
    core = np.linalg.inv(INERTIA - np.einsum("k,ki,kj->ij", j, axes, axes))

    def motion(state: Any) -> tuple[Any, Any]:
        omega = core @ (state[:3] - state[3 : 3 + count] @ axes)
        return omega, state[3 : 3 + count] / j - axes @ omega

    def rates(_: float, state: Any, sides: Any, motor: Any, torque: Any) -> Any:
        omega, speed = motion(state)
        turned = state[3 + count :].reshape(3, 3) @ np.cross(np.eye(3), omega)
        return np.concatenate(
            [np.cross(state[:3], omega) + torque, motor - coulomb * sides - viscous * speed, turned.ravel()]
        )

    def passes(_: float, state: Any, sides: Any, *__: Any) -> float:
        return float(np.where(coulomb > 0.0, sides * motion(state)[1], 1.0).min(initial=1.0))

    passes.terminal, passes.direction = True, -1  # type: ignore[attr-defined]
    state = np.concatenate([INERTIA @ OMEGA, j * (axes @ OMEGA), np.eye(3).ravel()])
    for second in range(SECONDS):
        motor, time = np.array([wheel.torques[second] for wheel in wheels]), float(second)
        for end, pushed in ((second + 0.002, 0.0), (second + 0.002 + PULSE, 1.0), (second + 1.0, 0.0)):
            held = motor, pushed * np.cross(ARM, FORCE)
            while time < end:
                speed = motion(state)[1]
                sides = np.sign(np.where(np.abs(speed) < 1e-9, motor, speed))
                found = solve_ivp(
                    rates, (time, end), state, "DOP853", events=passes, args=(sides, *held), rtol=1e-13, atol=1e-16
                )
                time, state = found.t[-1], found.y[:, -1]
    return state[3 + count :].reshape(3, 3), *motion(state)


@pytest.mark.parametrize(
    ("wheels", "solver"),
    [
        (STIFF, "{accuracy: 1.0e-9}"),
        pytest.param(STIFF, "{method: dverk, accuracy: 1.0e-9}", marks=pytest.mark.slow),
        (FREE, "{accuracy: 1.0e-9}"),
        (FREE, "{step: 1.0}"),
        ((), "{accuracy: 1.0e-9}"),
        ((), "{step: 1.0}"),
        ((), "{method: dop853, step: 1.0}"),
    ],
)
def test_stiff_friction_and_pulses_of_2_ms_each_second_keep_it(wheels: tuple[Wheel, ...], solver: str) -> None:
    """Also under steps of 1 s, in which the body turns by 0.05 rad."""
    text = SCENE.replace("SOLVER", solver) + "".join(
        f"  - {{type: reaction_wheel, name: w{k}, axis: {list(wheel.axis)}, inertia: {wheel.inertia},\n"
        f"     friction: {{viscous: {wheel.viscous}, coulomb: {wheel.coulomb}}}}}\n"
        for k, wheel in enumerate(wheels)
    )
    commands = [
        *((f"w{k}/command", rb.Setpoint(u, s * 10**9)) for k, w in enumerate(wheels) for s, u in enumerate(w.torques)),
        *(("jet/command", rb.Setpoint(PULSE, s * 10**9)) for s in range(SECONDS)),
    ]
    run = rb.simulate(rb.parse_scene(text), commands)
    attitude, omega, speeds = reference(wheels)
    turned = Rotation.from_quat(run.sample.orientation_xyzw).inv() * Rotation.from_matrix(attitude)
    assert turned.magnitude() < 1e-9
    assert run.sample.angular_velocity_body == pytest.approx(omega, abs=1e-9, rel=0.0)
    assert (run.sample.wheel_speeds or ()) == pytest.approx(speeds, abs=1e-8, rel=0.0)
