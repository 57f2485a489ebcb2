"""Every effect on a general body, against independently written equations solved by scipy.

Off-diagonal inertia, centre of mass off the origin, tilted start. The reference works in body axes with the inertia
matrix, uses no principal axes and shares no code with the package.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from rb_dynamics.run.sample import Sample
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene.read import parse_scene

Array = NDArray[np.float64]
# effect(t, position, velocity, body to world, angular velocity): force (world), torque, rotor momentum, its rate (body)
Acting = Callable[[float, Array, Array, Array, Array], tuple[Array, Array, Array, Array]]

MASS, CENTER = 2.5, np.array([0.1, -0.2, 0.3])
INERTIA = np.array([[2.1, 0.1, -0.2], [0.1, 1.7, 0.3], [-0.2, 0.3, 2.9]])
START = {"x": [5.0, 0.0, 0.0], "v": [0.0, 1.0, 0.2], "w": [0.4, -0.2, 0.7], "q": [0.1, 0.2, -0.3, 0.9273618495495704]}
ZERO = np.zeros(3)
TIME = 5.0


def rotation(q: Array) -> Array:
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def gravity(mu: float, center: Sequence[float]) -> Acting:
    def act(t: float, x: Array, v: Array, r: Array, w: Array) -> tuple[Array, Array, Array, Array]:
        away = x - np.array(center)
        distance = np.linalg.norm(away)
        n, inertia = away / distance, r @ INERTIA @ r.T
        force = -mu * MASS * n / distance**2
        force = force - 1.5 * mu / distance**4 * ((np.trace(INERTIA) - 5 * n @ inertia @ n) * n + 2 * inertia @ n)
        return force, 3 * mu / distance**3 * r.T @ np.cross(n, inertia @ n), ZERO, ZERO

    return act


def drag(power: int, translation: Sequence[float], turning: Sequence[float], medium: Sequence[float]) -> Acting:
    def act(t: float, x: Array, v: Array, r: Array, w: Array) -> tuple[Array, Array, Array, Array]:
        wind = v - np.array(medium)
        push = -(np.linalg.norm(wind) ** power) * r @ (np.array(translation) * (r.T @ wind))
        return push, -(np.linalg.norm(w) ** power) * np.array(turning) * w, ZERO, ZERO

    return act


def rotor(axis: Sequence[float], inertia: float, times: Sequence[float], rates: Sequence[float]) -> Acting:
    unit = np.array(axis) / np.linalg.norm(axis)

    def act(t: float, x: Array, v: Array, r: Array, w: Array) -> tuple[Array, Array, Array, Array]:
        i = int(np.searchsorted(times, t))
        slope = 0.0 if i in (0, len(times)) else (rates[i] - rates[i - 1]) / (times[i] - times[i - 1])
        return ZERO, ZERO, inertia * np.interp(t, times, rates) * unit, inertia * slope * unit

    return act


def reference(effects: Sequence[Acting], edges: Sequence[float]) -> dict[str, Array]:
    inverse, r = np.linalg.inv(INERTIA), rotation(np.array(START["q"]))
    w = np.array(START["w"])
    y = np.concatenate([START["x"] + r @ CENTER, START["v"] + r @ np.cross(w, CENTER), START["q"], w])
    times = [0.0, *edges, TIME]
    for begin, end in pairwise(times):

        def slope(t: float, y: Array, begin: float = begin, end: float = end) -> Array:
            t = min(max(t, begin + 1e-13), end - 1e-13)
            x, v, (a, b, c, d), w = y[:3], y[3:6], y[6:10], y[10:]
            force, torque, momentum = ZERO, ZERO, INERTIA @ w
            for effect in effects:
                f, n, h, h_dot = effect(t, x, v, rotation(y[6:10]), w)
                force, torque, momentum = force + f, torque + n - h_dot, momentum + h
            p, q, s = w
            turn = 0.5 * np.array([d * p + b * s - c * q, d * q + c * p - a * s, d * s + a * q - b * p, -w @ y[6:9]])
            return np.concatenate([v, force / MASS, turn, inverse @ (torque - np.cross(w, momentum))])

        solved: Any = solve_ivp(slope, (begin, end), y, method="DOP853", rtol=3e-14, atol=1e-15)
        assert solved.success
        y = solved.y[:, -1]
    r, w = rotation(y[6:10]), y[10:]
    return {"x": y[:3] - r @ CENTER, "v": y[3:6] - r @ np.cross(w, CENTER), "r": r, "w": w}


def scene(effects: str, method: str = "auto", accuracy: float = 1e-10) -> str:
    x, y, z, w = START["q"]
    return f"""
body: {{mass: {MASS}, center_of_mass: {CENTER.tolist()}, inertia: {{matrix: {INERTIA.tolist()}}}}}
initial:
  position_world: {START["x"]}
  linear_velocity_world: {START["v"]}
  angular_velocity_body: {START["w"]}
  orientation: {{x: {x!r}, y: {y!r}, z: {z!r}, w: {w!r}}}
wrenches: []
duration: {TIME}
output_rate: 1
solver: {{method: {method}, accuracy: {accuracy!r}}}
effects: [{effects}]
"""


def assert_close(found: Sample, expected: dict[str, Array], bound: float) -> None:
    turned = rotation(np.array(found.orientation_xyzw))
    assert np.abs(turned - expected["r"]).max() <= bound
    assert np.abs(np.array(found.position_world) - expected["x"]).max() <= 10 * bound
    assert np.abs(np.array(found.linear_velocity_world) - expected["v"]).max() <= 10 * bound
    assert np.abs(np.array(found.angular_velocity_body) - expected["w"]).max() <= bound


GRAVITY = "{type: central_gravity, gravitational_parameter: 2, center_world: [1, -1, 0.5], gravity_gradient: true}"
WIND = "translation: [0.2, 0.5, 0], rotation: [0.3, 0, 0.9], medium_velocity_world: [1, 2, 3]"
FIRST = (
    "{type: rotor, axis_body: [1, 1, 0], axial_inertia: 0.05, "
    "spin_rate: [{time: 0.5, rate: 5}, {time: 0.9000000000000001, rate: 30}, {time: 1.5, rate: -10}]}"
)
SECOND = (
    "{type: rotor, axis_body: [0, 1, -3], axial_inertia: 0.02, "
    "spin_rate: [{time: 0.25, rate: 0}, {time: 3.3333333333333335, rate: 100}]}"
)
ROTORS = [
    rotor([1, 1, 0], 0.05, [0.5, 0.9, 1.5], [5, 30, -10]),
    rotor([0, 1, -3], 0.02, [0.25, 3.333333333], [0, 100]),
]
KNOTS = (0.25, 0.5, 0.9, 1.5, 3.333333333)
CASES = {
    "gravity": (GRAVITY, [gravity(2.0, [1, -1, 0.5])], ()),
    "linear drag": (f"{{type: linear_drag, {WIND}}}", [drag(0, [0.2, 0.5, 0], [0.3, 0, 0.9], [1, 2, 3])], ()),
    "quadratic drag": (f"{{type: quadratic_drag, {WIND}}}", [drag(1, [0.2, 0.5, 0], [0.3, 0, 0.9], [1, 2, 3])], ()),
    "two rotors": (f"{FIRST}, {SECOND}", ROTORS, KNOTS),
    "rotor and drag": (
        f"{FIRST}, {{type: linear_drag, {WIND}}}",
        [ROTORS[0], drag(0, [0.2, 0.5, 0], [0.3, 0, 0.9], [1, 2, 3])],
        KNOTS[1:4],
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_auto_moves_the_body_as_the_other_equations_say(name: str) -> None:
    text, effects, edges = CASES[name]
    assert_close(simulate(parse_scene(scene(text))).sample, reference(effects, edges), 2e-10)


@pytest.mark.parametrize(
    "method",
    [
        "dop853",
        "rkmk54",
        "rk4",
        "radau",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("rkmk4", "cf4", "midpoint6", "midpoint4")),
    ],
)
def test_so_does_every_family_with_all_effects_at_once(method: str) -> None:
    text = ", ".join([GRAVITY, f"{{type: quadratic_drag, {WIND}}}", FIRST, SECOND])
    effects = [gravity(2.0, [1, -1, 0.5]), drag(1, [0.2, 0.5, 0], [0.3, 0, 0.9], [1, 2, 3]), *ROTORS]
    found = simulate(parse_scene(scene(text, method, 1e-7))).sample
    assert_close(found, reference(effects, KNOTS), 1e-7)
    assert abs(found.energy_defect) < 1e-6
    assert np.linalg.norm(found.angular_momentum_defect_world) < 1e-6


def test_the_momentum_of_a_free_gyrostat_is_kept_itself() -> None:
    """Compares |L| itself, since the rotor's part cancels in its defect; knots are not at whole nanoseconds."""
    start, end = (
        simulate(parse_scene(scene(f"{FIRST}, {SECOND}"), overrides={"duration": time})).sample for time in (1e-9, TIME)
    )
    drift = np.array(end.angular_momentum_world) - np.array(start.angular_momentum_world)
    assert np.linalg.norm(drift) < 1e-9
