"""Imbalance of wheels: against other equations; books, replay and pieces beside all else; what is not an imbalance."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import rb_dynamics as rb
from rb_dynamics.loads.wheel_imbalance import across
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study.replay import replay

TWO = """
body:
  mass: 10
  center_of_mass: [0.01, -0.02, 0.03]
  inertia: {matrix: [[0.05, 0.001, 0], [0.001, 0.12, 0.002], [0, 0.002, 0.14]]}
  frames: {jet: {position: [0, 0.1, 0], orientation: {x: 0, y: 0, z: 0, w: 1}}}
initial: {angular_velocity_body: [0.1, -0.2, 0.3], linear_velocity_world: [0.1, 0, 0]}
wrenches: [{topic: wrench, lag: 0.05}]
actuators:
  - {type: reaction_wheel, name: a, axis: [1, 2, 0], inertia: 1.0e-3, speed: 40, friction: {viscous: 3.0e-5},
     imbalance: {static: 1.0e-5, dynamic: 1.0e-6, phase: 0.4}, position: [0.1, 0.05, -0.1]}
  - {type: reaction_wheel, name: b, axis: [0, 1, 1], inertia: 2.0e-3, friction: {coulomb: 1.0e-5}, speed: -200,
     imbalance: {dynamic: 3.0e-8}}
  - {type: reaction_wheel, name: c, axis: [1, 0, 0], inertia: 1.0e-4, command: speed, max_torque: 0.01, max_speed: 90,
     friction: {coulomb: 1.0e-5}}
  - {type: thruster, name: jet, frame: jet, force: 0.01}
duration: 0.5
output_rate: 20
solver: {accuracy: 1.0e-10}
"""
COMMANDS = [
    ("a/command", rb.Setpoint(1e-2)),
    ("b/command", rb.Setpoint(-5e-4)),
    ("c/command", rb.Setpoint(60.0, 100_000_000)),
    ("c/command", rb.Setpoint(-20.0, 300_000_000)),
    ("jet/command", rb.Setpoint(0.002, 200_000_000)),
    ("wrench", rb.Wrench((0.1, 0.0, 0.0), (0.0, 0.01, 0.0), stamp_ns=250_000_000)),
]


def test_unbalanced_wheels_follow_other_equations() -> None:
    """Hamilton's way: momenta in the body, with the attitude as a matrix, by another integrator."""
    inertia = np.array([[0.05, 0.001, 0.0], [0.001, 0.12, 0.002], [0.0, 0.002, 0.14]])
    axes = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 1.0]]) / np.sqrt([[5.0], [2.0]])
    j, coulomb, viscous, motor = np.array([1e-3, 2e-3]), np.array([0.0, 1e-5]), np.array([3e-5, 0.0]), [1e-2, -5e-4]
    center, places = np.array([0.01, -0.02, 0.03]), np.array([[0.1, 0.05, -0.1], [0.0, 0.0, 0.0]])
    static, dynamic = np.array([1e-5, 0.0]), np.array([1e-6, 3e-8])
    core = inertia - np.einsum("k,ki,kj->ij", j, axes, axes)
    # Both axes are nearest to y, the first of equal ones.
    first = np.array([0.0, 0.0, 1.0]) - axes[:, 2:] * axes
    first /= np.linalg.norm(first, axis=1)[:, None]
    second = np.cross(axes, first)

    def rates(_: float, state: Any) -> Any:
        whole, spin, turn = state[:3], state[3:5], state[5:14].reshape(3, 3)
        angle, velocity = state[14:16, None], state[19:]
        omega = np.linalg.solve(core, whole - spin @ axes)
        speed = spin / j - axes @ omega
        way = np.cos(angle) * first + np.sin(angle) * second
        forces = (static * speed**2)[:, None] * way
        torque = ((dynamic * speed**2)[:, None] * way + np.cross(places - center, forces)).sum(axis=0)
        drive = motor - coulomb * np.sign(speed) - viscous * speed
        turning = (turn @ np.cross(np.eye(3), omega)).ravel()
        pushed = turn @ forces.sum(axis=0) / 10.0
        return np.concatenate([np.cross(whole, omega) + torque, drive, turning, speed, velocity, pushed])

    omega, speed = np.array([0.1, -0.2, 0.3]), np.array([40.0, -200.0])
    start = [inertia @ omega + (j * speed) @ axes, j * (speed + axes @ omega), np.eye(3).ravel(), [0.4, 0.0]]
    start += [center, np.array([0.1, 0.0, 0.0]) + np.cross(omega, center)]
    options: Any = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-15, "max_step": 5e-3}
    found = solve_ivp(rates, (0.0, 0.5), np.concatenate(start), **options).y[:, -1]
    ended = np.linalg.solve(core, found[:3] - found[3:5] @ axes)
    attitude = Rotation.from_matrix(found[5:14].reshape(3, 3))

    text = TWO[: TWO.index("  - {type: reaction_wheel, name: c")] + TWO[TWO.index("duration") :]
    sink = rb.MemorySink()
    rb.simulate(rb.parse_scene(text), COMMANDS[:2], [sink])

    assert (Rotation.from_quat(sink.orientation_xyzw[-1]).inv() * attitude).magnitude() < 1e-11
    assert sink.angular_velocity_body[-1] == pytest.approx(ended, abs=1e-11)
    assert sink.wheel_speeds[-1] == pytest.approx(found[3:5] / j - axes @ ended, abs=1e-10)
    assert sink.position_world[-1] == pytest.approx(found[16:19] - attitude.apply(center), abs=1e-12)
    assert np.abs(sink.angular_velocity_body[:, 0] - 0.1).max() > 1e-3, "the wheels shake the body"


def test_books_replay_and_pieces_beside_friction_limits_and_a_thruster(tmp_path: Path) -> None:
    path, sink, scene = tmp_path / "run.mcap", rb.MemorySink(), rb.parse_scene(TWO)
    run = rb.simulate(scene, COMMANDS, [sink, McapSink(path)])
    # Of 47 J and 0.6 kg m^2/s.
    assert np.abs(sink.energy_defect).max() < 1e-13
    assert np.abs(sink.angular_momentum_defect_world).max() < 1e-14
    assert np.abs(sink.linear_momentum_defect_world).max() < 1e-14
    assert replay(path).identical
    assert rb.inspect(path).passed
    pieces = rb.Simulation(scene)
    for topic, command in COMMANDS:
        if isinstance(command, rb.Setpoint):
            pieces.actuate(topic, command.value, command.stamp_ns)
        else:
            pieces.post(topic, command, command.stamp_ns)
    pieces.start()
    for k in range(0, 500_000_001, 6_250_000):
        pieces.advance(k)
    assert pieces.sample == run.sample


def test_a_state_from_outside_keeps_the_books_and_the_angles() -> None:
    scene, sink = rb.parse_scene(TWO), rb.MemorySink()
    run = rb.Simulation(scene, [sink])
    run.start()
    run.advance(200_000_000)
    state = rb.State(200_000_000, (1.0, 0.0, 0.0), (0.6, 0.0, 0.0, 0.8), (0.0, 0.0, 0.0), (0.0, 0.5, 0.0))
    run.set_state(rb.run.state_change.StateChange.to(state, scene.body))
    run.advance(500_000_000)
    assert np.abs(sink.energy_defect).max() < 1e-13
    assert np.abs(sink.angular_momentum_defect_world).max() < 1e-14


@pytest.mark.parametrize("how", ["friction: {coulomb: 1.0e-4}", "command: speed, max_torque: 0.01"])
def test_a_wheel_at_rest_shakes_nothing(how: str) -> None:
    """What the speed of a held wheel rounds to moved a body that only turns, and no step was short enough for that."""
    scene = rb.parse_scene(f"""
    body: {{mass: 10, inertia: {{diagonal: [0.05, 0.12, 0.14]}}}}
    initial: {{angular_velocity_body: [0.1, 0.2, 0.3]}}
    actuators:
      - {{type: reaction_wheel, name: a, axis: [0, 0, 1], inertia: 1.0e-4, {how},
         imbalance: {{static: 1.0e-6, dynamic: 1.0e-8}}, position: [0.05, 0, 0.02]}}
    duration: 1
    """)
    assert rb.simulate(scene).sample.position_world == (0.0, 0.0, 0.0)


def test_no_imbalance_has_the_bits_of_a_wheel_without_the_key() -> None:
    none = TWO.replace("imbalance: {static: 1.0e-5, dynamic: 1.0e-6, phase: 0.4}, ", "imbalance: {phase: 0.4}, ")
    none = none.replace("imbalance: {dynamic: 3.0e-8}", "imbalance: {}")
    plain = none.replace("imbalance: {phase: 0.4}, position: [0.1, 0.05, -0.1]", "speed: 40")
    plain = plain.replace(",\n     imbalance: {}", "").replace("speed: 40, friction", "friction")
    assert "imbalance" not in plain
    samples = [rb.simulate(rb.parse_scene(text), COMMANDS).sample for text in (none, plain)]
    assert samples[0] == samples[1]


@pytest.mark.parametrize(
    ("axis", "first"),
    [((2, 0, 0), (0, 1, 0)), ((0, -1, 0), (0, 0, 1)), ((0, 0, 3), (1, 0, 0)), ((1, 0.1, 0), (-0.1, 1, 0))],
)
def test_the_direction_of_phase_0(axis: rb.Vector, first: rb.Vector) -> None:
    found = across(axis)
    unit = np.array(axis) / np.linalg.norm(axis)
    assert found[0] == pytest.approx(np.array(first) / np.linalg.norm(first), abs=1e-15)
    assert found[1] == pytest.approx(np.cross(unit, found[0]), abs=1e-15)


@pytest.mark.parametrize(
    ("change", "to", "said"),
    [
        (", position: [0.1, 0.05, -0.1]", "", "position"),
        ("static: 1.0e-5", "static: -1.0e-5", "imbalance.static"),
        ("dynamic: 3.0e-8", "dynamics: 3.0e-8", "did you mean dynamic"),
        ("position: [0.1, 0.05, -0.1]", "position: [0.1, 0.05]", "position"),
    ],
)
def test_what_is_no_imbalance_is_one_clear_error(change: str, to: str, said: str) -> None:
    assert change in TWO
    with pytest.raises(rb.SceneError, match="expected") as error:
        rb.parse_scene(TWO.replace(change, to))
    assert said in str(error.value)
    assert len(str(error.value).splitlines()) <= 2
