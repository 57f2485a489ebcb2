"""Reaction wheels: against other equations and closed forms, at rest and at their limits; books, log and replay."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

import rb_dynamics as rb
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.loads.actuator import Setpoint
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study.replay import replay

PI = Fraction(math.pi) + Fraction(1.2246467991473532e-16)
BODY = """
body: {mass: 10, inertia: {matrix: [[0.05, 0.001, 0], [0.001, 0.12, 0.002], [0, 0.002, 0.14]]}}
initial: {angular_velocity_body: [0.1, -0.2, 0.3]}
"""
THREE = f"""{BODY}
wrenches: [{{topic: wrench}}]
actuators:
  - {{type: reaction_wheel, name: wheel_x, axis: [1, 0, 0], inertia: 1.0e-4, command: torque, max_torque: 5.0e-3,
     max_speed: 600.0, friction: {{coulomb: 1.0e-5, viscous: 1.0e-7}}, speed: 50.0}}
  - {{type: reaction_wheel, name: wheel_y, axis: [0, 1, 0.2], inertia: 2.0e-4, max_speed: 100.0,
     friction: {{coulomb: 1.0e-4}}}}
  - {{type: reaction_wheel, name: wheel_z, axis: [0, 0, 1], inertia: 2.0e-4, command: speed, max_torque: 5.0e-3,
     max_speed: 100.0, friction: {{coulomb: 1.0e-4, viscous: 1.0e-6}}}}
duration: 40
output_rate: 4
"""
COMMANDS = [
    ("wheel_z/command", Setpoint(30.0, 500_000_000)),
    ("wheel_x/command", Setpoint(-1e-3, 1_000_000_000)),
    ("wheel_y/command", Setpoint(0.5e-4, 2_000_000_000)),
    ("wheel_y/command", Setpoint(2e-3, 3_000_000_000)),
    ("wheel_x/command", Setpoint(0.0, 12_000_000_000)),
    ("wheel_z/command", Setpoint(-10.0, 15_000_000_000)),
    ("wheel_y/command", Setpoint(-2e-3, 23_000_000_000)),
]


def flown(text: str, commands: object = (), **overrides: object) -> rb.MemorySink:
    sink = rb.MemorySink()
    rb.simulate(rb.parse_scene(text, overrides=overrides), commands, [sink])  # type: ignore[arg-type]
    return sink


def require_books(sink: rb.MemorySink, energy: float, momentum: float) -> None:
    """Check that T, L, the work of motors and the heat of friction close, by their defects and against each other."""
    assert np.abs(sink.energy_defect).max() < energy
    assert np.abs(sink.angular_momentum_defect_world).max() < momentum
    done = sink.motor_work - sink.friction_heat
    assert np.abs(sink.work - done).max() < energy, "nothing but motors and friction does work"
    assert np.abs(sink.kinetic_energy - sink.kinetic_energy[0] - done).max() < energy
    assert np.abs(sink.angular_momentum_world - sink.angular_momentum_world[0]).max() < momentum
    assert (np.diff(sink.friction_heat) >= 0.0).all()


def test_wheels_with_friction_follow_other_equations() -> None:
    """Hamilton's way: momenta in the body, with the attitude as a matrix, by another integrator."""
    text = f"""{BODY}
wrenches: []
actuators:
  - {{type: reaction_wheel, name: a, axis: [1, 2, 0], inertia: 1.0e-3, speed: 40,
     friction: {{coulomb: 2.0e-5, viscous: 3.0e-5}}}}
  - {{type: reaction_wheel, name: b, axis: [0, 1, 1], inertia: 2.0e-3, friction: {{coulomb: 1.0e-5}}, speed: -20}}
duration: 20
output_rate: 1
solver: {{accuracy: 1.0e-11}}
"""
    inertia = np.array([[0.05, 0.001, 0.0], [0.001, 0.12, 0.002], [0.0, 0.002, 0.14]])
    axes = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 1.0]]) / np.sqrt([[5.0], [2.0]])
    j, coulomb, viscous, motor = np.array([1e-3, 2e-3]), np.array([2e-5, 1e-5]), np.array([3e-5, 0.0]), [1e-3, -5e-4]
    core = inertia - np.einsum("k,ki,kj->ij", j, axes, axes)

    def rates(_: float, state: Any) -> Any:
        whole, spin, turn = state[:3], state[3:5], state[5:].reshape(3, 3)
        omega = np.linalg.solve(core, whole - spin @ axes)
        speed = spin / j - axes @ omega
        torque = motor - coulomb * np.sign(speed) - viscous * speed
        hat = np.cross(np.eye(3), omega)
        return np.concatenate([np.cross(whole, omega), torque, (turn @ hat).ravel()])

    omega = np.array([0.1, -0.2, 0.3])
    speed = np.array([40.0, -20.0])
    whole = inertia @ omega + (j * speed) @ axes
    start = np.concatenate([whole, j * (speed + axes @ omega), np.eye(3).ravel()])
    found = solve_ivp(rates, (0.0, 20.0), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    sink = flown(text, [("a/command", Setpoint(1e-3)), ("b/command", Setpoint(-5e-4))])
    ended = np.linalg.solve(core, found[:3] - found[3:5] @ axes)
    assert sink.wheel_speeds[-1] == pytest.approx(found[3:5] / j - axes @ ended, abs=1e-8)
    assert sink.angular_velocity_body[-1] == pytest.approx(ended, abs=1e-10)
    turned = Rotation.from_quat(sink.orientation_xyzw[-1]).inv() * Rotation.from_matrix(found[5:].reshape(3, 3))
    assert turned.magnitude() < 1e-9
    require_books(sink, 1e-11, 1e-10)


def test_a_free_wheel_on_the_axis_of_symmetry_nutates_in_closed_form() -> None:
    """I1 = I2: the rate across turns in the body by ((I3 - I1) w3 + J W) / I1 (Hughes, section 6.6)."""
    text = """
body: {mass: 1, inertia: {diagonal: [0.3, 0.3, 0.2]}}
initial: {angular_velocity_body: [0.05, 0, 0.1]}
wrenches: []
actuators: [{type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 0.01, speed: 100}]
duration: 10
output_rate: 1
solver: {accuracy: 1.0e-11}
"""
    sink = flown(text)
    angle = ((0.2 - 0.3) * 0.1 + 0.01 * 100.0) / 0.3 * sink.time_ns * 1e-9
    expected = np.column_stack([0.05 * np.cos(angle), 0.05 * np.sin(angle), np.full(len(angle), 0.1)])
    assert sink.angular_velocity_body == pytest.approx(expected, abs=1e-10)
    assert sink.wheel_speeds[:, 0] == pytest.approx(100.0, abs=1e-10)
    require_books(sink, 1e-12, 1e-12)


def test_a_wheel_passes_rest_between_two_nanoseconds() -> None:
    """About one axis, in fractions: 400 passages, and some at which friction holds it until the next command."""
    coulomb, j, whole = 0.02, 1e-3, 0.05
    text = f"""
body: {{mass: 5, inertia: {{diagonal: [{whole}, 0.06, 0.07]}}}}
actuators:
  - {{type: reaction_wheel, name: w, axis: [1, 0, 0], inertia: {j}, speed: 1.0, friction: {{coulomb: {coulomb}}}}}
duration: 230
"""
    torques = [(-1) ** k * -0.05 if k % 10 != 9 else 0.01 for k in range(460)]
    commands = [("w/command", Setpoint(torque, k * 500_000_000)) for k, torque in enumerate(torques)]
    sink = flown(text, commands, output_rate=1.0)

    spin, friction = Fraction(j), Fraction(coulomb)
    speed, rate, angle, passages, holds = Fraction(1), Fraction(0), Fraction(0), 0, 0
    for torque in map(Fraction, torques):
        left = Fraction(1, 2)
        while left:
            side = speed if speed else torque
            on_wheel = torque - friction if side > 0 else torque + friction
            if not speed and abs(torque) <= friction:
                on_wheel, holds = Fraction(0), holds + 1
            slowing = -on_wheel / (Fraction(whole) - spin)
            change = on_wheel / spin - slowing
            time = min(left, -speed / change) if speed * change < 0 else left
            passages += time < left
            speed, left = speed + change * time, left - time
            angle += (rate + slowing * time / 2) * time
            rate += slowing * time
    assert passages >= 400
    assert holds >= 20
    assert sink.wheel_speeds[-1, 0] == pytest.approx(float(speed), abs=1e-10)
    assert sink.angular_velocity_body[-1, 0] == pytest.approx(float(rate), abs=1e-13)
    turned = Rotation.from_quat(sink.orientation_xyzw[-1]) * Rotation.from_rotvec([-float(angle % (2 * PI)), 0.0, 0.0])
    assert turned.magnitude() < 2e-12
    require_books(sink, 1e-12, 1e-14)


@pytest.mark.slow
def test_wheels_that_pass_rest_follow_an_integrator_that_locates_it() -> None:
    """Two wheels of a body that tumbles, each reversed every half second."""
    text = f"""{BODY}
wrenches: []
actuators:
  - {{type: reaction_wheel, name: a, axis: [1, 2, 0], inertia: 1.0e-3, friction: {{coulomb: 0.02}}, speed: 1}}
  - {{type: reaction_wheel, name: b, axis: [0, 1, 1], inertia: 2.0e-3, friction: {{coulomb: 0.03}}, speed: -1}}
duration: 50
solver: {{accuracy: 1.0e-11}}
"""
    inertia = np.array([[0.05, 0.001, 0.0], [0.001, 0.12, 0.002], [0.0, 0.002, 0.14]])
    axes = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 1.0]]) / np.sqrt([[5.0], [2.0]])
    j, coulomb, size = np.array([1e-3, 2e-3]), np.array([0.02, 0.03]), np.array([-0.05, 0.06])
    core = inertia - np.einsum("k,ki,kj->ij", j, axes, axes)

    def speeds(state: Any) -> Any:
        return state[3:5] / j - axes @ np.linalg.solve(core, state[:3] - state[3:5] @ axes)

    def rates(_: float, state: Any, motor: Any, sides: Any) -> Any:
        omega = np.linalg.solve(core, state[:3] - state[3:5] @ axes)
        turned = state[5:].reshape(3, 3) @ np.cross(np.eye(3), omega)
        return np.concatenate([np.cross(state[:3], omega), motor - coulomb * sides, turned.ravel()])

    events = [lambda _, state, motor, sides, k=k: sides[k] * speeds(state)[k] for k in (0, 1)]
    for event in events:
        event.terminal, event.direction = True, -1  # type: ignore[attr-defined]
    omega, speed, sides, passages = np.array([0.1, -0.2, 0.3]), np.array([1.0, -1.0]), np.array([1.0, -1.0]), 0
    state = np.concatenate([inertia @ omega + (j * speed) @ axes, j * (speed + axes @ omega), np.eye(3).ravel()])
    for k in range(100):
        time, end = 0.5 * k, 0.5 * (k + 1)
        while time < end:
            found = solve_ivp(
                rates,
                (time, end),
                state,
                "DOP853",
                events=events,
                args=((-1) ** k * size, sides),
                rtol=1e-13,
                atol=1e-15,
            )
            time, state = found.t[-1], found.y[:, -1]
            for wheel, at in enumerate(found.t_events):
                if len(at):
                    sides[wheel], passages = -sides[wheel], passages + 1
    assert passages > 180
    commands = [
        (f"{name}/command", Setpoint((-1) ** k * torque, k * 500_000_000))
        for k in range(100)
        for name, torque in zip("ab", size.tolist(), strict=True)
    ]
    sink = flown(text, commands)
    turned = Rotation.from_quat(sink.orientation_xyzw[-1]).inv() * Rotation.from_matrix(state[5:].reshape(3, 3))
    assert turned.magnitude() < 1e-11
    assert sink.wheel_speeds[-1] == pytest.approx(speeds(state), abs=1e-11)
    require_books(sink, 1e-11, 1e-13)


@cache
def released_and_caught(
    omega: Any, axis: Any, speed: float, coulomb: float, limit: float, seconds: float
) -> tuple[Any, float, int]:
    """Return rate and attitude (quaternion) of a body with one wheel, its speed, and how often that was held or let go.

    By another integrator, with the speeds as states, and steps so short that no point is passed twice in one.
    """
    inertia, j, axis = np.diag([1.0, 1.7, 2.1]), 0.05, np.array(axis) / np.linalg.norm(axis)

    def turning(state: Any, sign: float, held: bool) -> tuple[Any, float]:
        core = inertia if held else inertia - j * np.outer(axis, axis)
        torque = 0.0 if held else -coulomb * sign
        whole = inertia @ state[:3] + j * state[3] * axis
        spin_up = np.linalg.solve(core, np.cross(whole, state[:3]) - torque * axis)
        return spin_up, 0.0 if held else torque / j - axis @ spin_up

    def rates(_: float, state: Any, sign: float, held: bool) -> Any:
        (x, y, z), (a, b, c, d) = state[:3], state[4:]
        spin_up, faster = turning(state, sign, held)
        turned = [d * x + b * z - c * y, d * y + c * x - a * z, d * z + a * y - b * x, -a * x - b * y - c * z]
        return np.concatenate([spin_up, [faster], 0.5 * np.array(turned)])

    def within(_: float, state: Any, sign: float, held: bool) -> float:
        if not held:
            return min(sign * state[3] if coulomb else math.inf, limit - sign * state[3])
        needed = j * axis @ turning(state, sign, held)[0]
        return coulomb - abs(needed) if state[3] == 0.0 else -coulomb - sign * needed

    within.terminal, within.direction = True, -1  # type: ignore[attr-defined]
    state, time, sign, events = np.array([*omega, speed, 0.0, 0.0, 0.0, 1.0]), 0.0, 1.0, 0
    held = speed == 0.0
    while time < seconds:
        found = solve_ivp(
            rates,
            (time, seconds),
            state,
            "DOP853",
            events=within,
            args=(sign, held),
            rtol=1e-12,
            atol=1e-14,
            max_step=2e-3,
        )
        time, state, events = found.t[-1], found.y[:, -1], events + len(found.t_events[0])
        if time < seconds:
            if not held:
                state[3] = 0.0 if abs(state[3]) < 1e-9 else sign * limit
            elif state[3] == 0.0:
                sign = -math.copysign(1.0, axis @ turning(state, sign, held)[0])
            held = not held
    return state, state[3], events


@pytest.mark.parametrize("solver", ["{accuracy: 1.0e-6}", "{accuracy: 1.0e-9}", "{method: dop853, step: 0.15}"])
@pytest.mark.parametrize(
    ("omega", "axis", "speed", "coulomb", "limit", "seconds"),
    [
        ((0.385, -0.98, 0.88), (0.0356, -0.506, 0.594), 0.2305, 0.0145, math.inf, 3.2),
        ((1.5, 0.2, 0.8), (1, 2, 2), 0.9, 0.02, math.inf, 3.0),
        ((-0.4, -0.4, 2.0), (1, 2, 2), 0.4, 0.0, 0.4663, 3.0),
        ((-0.7, 0.1, -1.3), (1, 2, 2), 0.0, 0.02298, math.inf, 3.0),
    ],
    ids=["rest", "deeper", "max_speed", "breakaway"],
)
def test_a_wheel_that_reaches_a_point_and_comes_back_within_a_step(
    omega: Any, axis: Any, speed: float, coulomb: float, limit: float, seconds: float, solver: str
) -> None:
    fastest = f", max_speed: {limit}" if limit < math.inf else ""
    text = f"""
body: {{mass: 1, inertia: {{diagonal: [1, 1.7, 2.1]}}}}
initial: {{angular_velocity_body: {list(omega)}}}
wrenches: []
actuators:
  - {{type: reaction_wheel, name: wheel, axis: {list(axis)}, inertia: 0.05, speed: {speed},
     friction: {{coulomb: {coulomb}}}{fastest}}}
duration: {seconds}
output_rate: 0
solver: {solver}
"""
    state, ended, events = released_and_caught(omega, axis, speed, coulomb, limit, seconds)
    assert events == 2
    sample = rb.simulate(rb.parse_scene(text)).sample
    accuracy = 1e-6 if "1.0e-6" in solver else 1e-9
    turned = Rotation.from_quat(sample.orientation_xyzw).inv() * Rotation.from_quat(state[4:])
    assert turned.magnitude() < accuracy
    assert sample.wheel_speeds == pytest.approx((ended,), abs=accuracy)


def test_friction_brings_a_wheel_to_rest_and_holds_it() -> None:
    """About one axis: J_r W' = -c - v W with the reduced inertia, to rest at a time in closed form; then it stays."""
    text = """
body: {mass: 1, inertia: {diagonal: [0.3, 0.3, 0.2]}}
wrenches: [{topic: wrench}]
actuators:
  - {type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 0.01, speed: 10,
     friction: {coulomb: 2.0e-3, viscous: 1.0e-3}}
duration: 30
output_rate: 10
"""
    push = rb.Wrench(torque=(0.0, 0.0, 0.05), stamp_ns=25_000_000_000)
    sink = flown(text, [("wrench", push)])
    reduced = 0.01 * (1.0 - 0.01 / 0.2)
    seconds, speed = sink.time_ns * 1e-9, sink.wheel_speeds[:, 0]
    falling = 12.0 * np.exp(-1e-3 / reduced * seconds) - 2.0
    stops = reduced / 1e-3 * math.log(6.0)
    assert 5.0 < stops < 25.0
    assert speed[seconds < stops] == pytest.approx(falling[seconds < stops], abs=1e-8)
    assert np.abs(speed[(seconds > stops) & (seconds <= 25.0)]).max() < 1e-8
    # 0.05 N m on body and wheel: the wheel needs 0.01 / 0.2 of it, more than the friction at rest gives.
    assert speed[-1] < -0.01
    assert sink.angular_velocity_body[-1, 2] > 0.5
    assert np.abs(sink.energy_defect).max() < 1e-11


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("command", "value"), [("torque", 0.005), ("speed", 10.0)])
def test_a_body_drives_a_wheel_beyond_its_largest_speed(command: str, value: float, sign: float) -> None:
    """About one axis, N = I w' + J W' and J (W' + w') = u - c: at the limit the motor gives `max_torque` at most."""
    text = f"""
body: {{mass: 1, inertia: {{diagonal: [1, 1, 1]}}}}
wrenches: [{{topic: wrench}}]
actuators:
  - {{type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 0.1, command: {command}, max_torque: 0.01,
     max_speed: 10, speed: {10.0 * sign}, friction: {{coulomb: 1.0e-3}}}}
duration: 12
output_rate: 1
"""
    # What motor and friction can hold together, then more, then nothing.
    pushes = [(0, -0.1), (1, -1.0), (2, 0.0)]
    wrenches = [("wrench", rb.Wrench((0.0, 0.0, 0.0), (0.0, 0.0, sign * n), stamp_ns=at * 10**9)) for at, n in pushes]
    sink = flown(text, [("wheel/command", Setpoint(sign * value)), *wrenches])
    # I w' = N - J W', so that (I - J) W' = I (u - c) / J - N.
    braking = (-0.011 / 0.1 - np.array([-1.0, 0.0])) / 0.9
    beyond = 10.0 + braking[0] + braking[1] * np.arange(11)
    expected = [10.0, *np.maximum(beyond, 10.0)]
    assert sign * sink.wheel_speeds[:, 0] == pytest.approx(np.array([10.0, *expected]), abs=1e-9)
    assert np.abs(sink.energy_defect).max() < 1e-13
    assert np.abs(sink.angular_momentum_defect_world).max() < 1e-14


def test_limits_commanded_speeds_and_reversals_close_their_books() -> None:
    sink = flown(THREE, COMMANDS)
    x, y, z = sink.wheel_speeds.T
    seconds = sink.time_ns * 1e-9
    assert np.abs(y[seconds <= 3.0]).max() < 1e-8, "a torque less than the friction turns no wheel"
    assert y[(seconds > 14.0) & (seconds < 23.0)] == pytest.approx(100.0, abs=1e-6)
    assert z[(seconds > 3.0) & (seconds <= 15.0)] == pytest.approx(30.0, abs=1e-6)
    assert z[seconds > 18.0] == pytest.approx(-10.0, abs=1e-6)
    assert x.max() == pytest.approx(50.0)
    assert x.min() < -50.0
    require_books(sink, 1e-13, 1e-11)


def test_replay_pieces_and_output_rates_have_the_same_bits(tmp_path: Path) -> None:
    path, scene = tmp_path / "run.mcap", rb.parse_scene(THREE, overrides={"duration": 16.0})
    run = rb.simulate(scene, COMMANDS, [McapSink(path)])
    assert replay(path).identical
    assert rb.inspect(path).passed
    (wheels, *_) = [each for each in open_source(path).messages() if each.channel.topic == "/wheels"][-1:]
    _, _, names, _, speeds, _ = cdr.decode("sensor_msgs/msg/JointState", wheels.data)
    assert names == [("wheel_x",), ("wheel_y",), ("wheel_z",)]
    assert tuple(speed for ((speed,),) in speeds) == run.sample.wheel_speeds
    fine = rb.parse_scene(THREE, overrides={"duration": 16.0, "output_rate": 37.0})
    assert rb.simulate(fine, COMMANDS, [rb.MemorySink()]).sample == run.sample
    pieces = rb.Simulation(scene)
    for topic, setpoint in COMMANDS:
        pieces.actuate(topic, setpoint.value, setpoint.stamp_ns)
    pieces.start()
    for k in range(161):
        pieces.advance(k * 100_000_000 + k)
    pieces.advance(16 * 10**9)
    assert pieces.sample == run.sample


def test_a_state_from_outside_keeps_the_speeds_of_wheels_and_the_books() -> None:
    scene, sink = rb.parse_scene(THREE, overrides={"duration": 4.0}), rb.MemorySink()
    run = rb.Simulation(scene, [sink])
    run.start()
    run.advance(2 * 10**9)
    speeds = run.sample.wheel_speeds
    state = rb.State(2 * 10**9, (1.0, 0.0, 0.0), (0.6, 0.0, 0.0, 0.8), (0.0, 0.0, 0.0), (0.0, 0.5, 0.0))
    run.set_state(rb.run.state_change.StateChange.to(state, scene.body))
    run.advance(2 * 10**9 + 1)
    assert run.look().wheel_speeds == pytest.approx(speeds, abs=1e-6)
    run.advance(4 * 10**9)
    assert np.abs(sink.energy_defect).max() < 1e-13
    assert np.abs(sink.angular_momentum_defect_world).max() < 1e-12


def test_gravity_gradient_and_a_thruster_beside_wheels_close_their_books() -> None:
    text = """
body:
  mass: 10
  inertia: {diagonal: [0.05, 0.12, 0.14]}
  frames: {jet: {position: [0, 0.1, 0], orientation: {x: 0, y: 0, z: 0, w: 1}}}
initial: {position_world: [7.0e+6, 0, 0], linear_velocity_world: [0, 7.5e+3, 0], angular_velocity_body: [0, 0, 0.01]}
wrenches: []
effects:
  - {type: central_gravity, gravitational_parameter: 3.986004418e+14, gravity_gradient: true}
  - {type: magnetic_field, model: dipole, moment_world: [0, 0, -7.8e+22]}
actuators:
  - {type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 1.0e-4, friction: {coulomb: 1.0e-6}, speed: 20}
  - {type: thruster, name: jet, frame: jet, force: 0.01}
  - {type: magnetorquer, name: rod, axis: [1, 0, 0], max_dipole: 1}
duration: 20
output_rate: 1
"""
    commands = [("jet/command", Setpoint(0.002, 10**9 * k)) for k in range(1, 9)]
    sink = flown(text, [*commands, ("rod/command", Setpoint(0.5)), ("wheel/command", Setpoint(1e-5, 10**9))])
    assert np.abs(sink.angular_momentum_defect_world).max() < 1e-12
    assert np.abs(sink.energy_defect).max() < 1e-15 * sink.kinetic_energy[0] * 10


@pytest.mark.parametrize(
    ("change", "to"),
    [
        ("inertia: 1.0e-4", "inertia: 0.06"),
        ("axis: [1, 0, 0]", "axis: [0, 0, 0]"),
        ("command: torque", "command: level"),
        ("speed: 50.0", "speed: 700.0"),
        ("coulomb: 1.0e-5", "coulomb: -1.0e-5"),
        ("coulomb: 1.0e-5", "coulomb: 1.0e+10"),
        ("viscous: 1.0e-7", "viscous: 1.0e+5"),
        ("{coulomb: 1.0e-5, viscous", "{coulob: 1.0e-5, viscous"),
        ("command: speed, max_torque: 5.0e-3,", "command: speed,"),
        ("duration: 40", "duration: 40\nsolver: {method: rk4}"),
    ],
)
def test_what_is_no_wheel_is_one_clear_error(change: str, to: str) -> None:
    assert change in THREE
    with pytest.raises(rb.SceneError, match="expected") as error:
        rb.Simulation(rb.parse_scene(THREE.replace(change, to)))
    assert len(str(error.value).splitlines()) <= 2


@pytest.mark.parametrize(("limit", "remedy"), [(math.inf, "give max_torque"), (1e20, "a smaller max_torque")])
def test_a_torque_beyond_all_time_names_the_limit_that_would_help(limit: float, remedy: str) -> None:
    wheel = rb.ReactionWheel(name="w", axis=(0.0, 0.0, 1.0), inertia=1e-3, max_torque=limit)
    with pytest.raises(
        rb.WrenchError, match=rf"expected at most 1e\+09 N m: .*; correct what commands it, or {remedy}$"
    ):
        wheel.accept(1e15)


def test_wheels_that_hold_more_inertia_than_the_body_about_some_direction_are_refused() -> None:
    """Against the smallest eigenvalue of what the body has without them, by another library: in Python and as a scene.

    Also one wheel beside a principal axis, and a wheel beside a rotor.
    """
    random, tensor = np.random.default_rng(4), np.array([[0.05, 0.001, 0.0], [0.001, 0.12, 0.002], [0.0, 0.002, 0.14]])
    for axes in (random.normal(size=(1, 3)), random.normal(size=(2, 3)), random.normal(size=(4, 3))):
        shares = random.uniform(0.5, 1.0, len(axes))
        units = axes / np.linalg.norm(axes, axis=1, keepdims=True)
        whole = float(eigh(np.einsum("k,ki,kj", shares, units, units), tensor)[0][-1])
        for most, fits in ((0.9999, True), (1.0, False), (1.01, False)):
            wheels = [
                rb.ReactionWheel(name=f"w{k}", axis=tuple(axis), inertia=float(share) / whole * most)
                for k, (axis, share) in enumerate(zip(axes, shares, strict=True))
            ]
            scene = rb.parse_scene(BODY + "wrenches: []")
            rotor = rb.Rotor(wheels[0].axis, wheels[0].inertia, ((0.0, 1.0),))
            text = [
                f"{{type: reaction_wheel, name: {w.name}, axis: {list(w.axis)}, inertia: {w.inertia}}}" for w in wheels
            ]
            listed = f"{BODY}wrenches: []\nactuators: [{', '.join(text)}]"
            if fits:
                replace(scene, actuators=wheels)
                rb.parse_scene(listed)
                continue
            names = " and ".join(wheel.name for wheel in wheels)
            with pytest.raises(rb.SceneError, match=f"inertia of {names} is "):
                replace(scene, actuators=wheels)
            with pytest.raises(rb.SceneError, match=f":(5|6): actuators.*inertia of {names} is "):
                rb.parse_scene(listed)
            if len(wheels) > 1:
                with pytest.raises(rb.SceneError, match="and a rotor is "):
                    replace(scene, effects=[rotor], actuators=wheels[1:])


@pytest.mark.parametrize(
    ("command", "speed", "values"),
    [
        ("torque", 0.0, (0.03, 0.0)),
        ("speed", 0.0, (-0.03, 0.0)),
        ("speed", 50.0, (0.03, 0.0)),
        ("speed", 50.0, (40.0, 50.0)),
    ],
)
def test_what_was_decided_at_one_time_counts_for_nothing_in_what_comes_then(
    command: str, speed: float, values: tuple[float, float]
) -> None:
    """Commands while time stands act as at once: a wheel that one would have let go is at rest for the next."""
    text = f"""
body: {{mass: 2, inertia: {{diagonal: [0.1, 0.2, 0.25]}}}}
initial: {{angular_velocity_body: [0.31, -0.27, 0.13]}}
wrenches: []
actuators:
  - {{type: reaction_wheel, name: a, axis: [1, 2, 3], inertia: 3.0e-3, command: {command}, max_torque: 0.05,
     max_speed: 50.0, friction: {{coulomb: 1.0e-3, viscous: 1.0e-5}}, speed: {speed}}}
  - {{type: reaction_wheel, name: b, axis: [0, 1, 0], inertia: 2.0e-3, friction: {{coulomb: 1.0e-3}}, speed: 3.0}}
duration: 5
output_rate: 10
"""
    found = []
    for one_by_one in (False, True):
        run = rb.Simulation(rb.parse_scene(text))
        run.start()
        run.advance(1_234_567_891)
        for value in values:
            run.actuate("a/command", value, 1_234_567_891)
            if one_by_one:
                run.advance(1_234_567_891)
        run.advance(5_000_000_000)
        found.append((run.sample, run.steps))
    assert found[0] == found[1]


def test_a_wheel_of_a_body_that_swings_from_rest_to_rest_in_a_step_switches() -> None:
    """The rates are zero at both ends of the step; midway the wheel would pass its limit.

    The angle is from scipy's DOP853 with events (`max_speed` reached, and left when the body no longer speeds the wheel
    up). Half as long steps err by 5e-7, and where the limit is overlooked the step errs by 1e-2.
    """
    swing = 0.05
    rate = math.sqrt(1.0 / 0.5)
    half = round(math.pi / rate, 9)
    text = f"""\
body: {{mass: 1, inertia: {{diagonal: [1, 1, 1]}}}}
initial: {{orientation: {{x: {math.sin(swing / 2)!r}, y: 0, z: 0, w: {math.cos(swing / 2)!r}}}}}
wrenches: []
effects:
- {{type: uniform_gravity, acceleration_world: [0, 0, -10]}}
- {{type: buoyancy, volume: 1, density: 1, acceleration_world: [0, 0, -10], center_body: [0, 0, 0.1]}}
actuators:
- {{type: reaction_wheel, name: a, axis: [1, 0, 0], inertia: 0.5, speed: 10, max_speed: {10 + 0.5 * swing * rate!r}}}
solver: {{method: dop853, step: {half!r}}}
duration: {3 * half!r}
"""
    found = rb.simulate(rb.parse_scene(text)).sample
    angle = 2.0 * math.atan2(found.orientation_xyzw[0], found.orientation_xyzw[3])
    assert angle == pytest.approx(-0.0386849806, abs=3e-4)
    assert found.wheel_speeds[0] == pytest.approx(9.99093858585, abs=3e-4)
