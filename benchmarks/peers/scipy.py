"""scipy's `solve_ivp`: DOP853 and LSODA on the equations of motion in numpy, an ensemble in one vector."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from peers.problem import Answer, Problem, Run, Way

NAME = "scipy"
PACKAGES = ("scipy", "numpy")

METHODS = ("DOP853", "LSODA")


def ways(problem: Problem) -> list[Way]:
    # LSODA's Jacobian is dense, with 13 numbers per body: unsuitable for thousands of bodies at once.
    methods = METHODS if problem.bodies == 1 else METHODS[:1]
    return [Way(method, "tolerance", 1e-5, _prepare(problem, method)) for method in methods]


def _prepare(problem: Problem, method: str) -> Callable[[float], Run]:
    inertia, inverse = problem.inertia, np.linalg.inv(problem.inertia)
    n = problem.bodies
    gravity = np.array(problem.gravity)

    def slope(_: float, y: np.ndarray, force: np.ndarray, torque: np.ndarray, push: np.ndarray) -> np.ndarray:
        q, w, _x, v = np.split(y.reshape(13, n), (4, 7, 10))
        L = inertia @ w
        gyroscopic = (w[1] * L[2] - w[2] * L[1], w[2] * L[0] - w[0] * L[2], w[0] * L[1] - w[1] * L[0])
        (x, y, z, s), (a, b, c) = q, 0.5 * w
        f, g, h = force
        tx, ty, tz = 2.0 * (y * h - z * g), 2.0 * (z * f - x * h), 2.0 * (x * g - y * f)
        return np.concatenate(
            (
                (s * a + y * c - z * b, s * b + z * a - x * c, s * c + x * b - y * a, -x * a - y * b - z * c),
                inverse @ (torque[:, None] - gyroscopic),
                v,
                (
                    (f + s * tx + y * tz - z * ty + push[0]) / problem.mass + gravity[0],
                    (g + s * ty + z * tx - x * tz + push[1]) / problem.mass + gravity[1],
                    (h + s * tz + x * ty - y * tx + push[2]) / problem.mass + gravity[2],
                ),
            )
        ).ravel()

    start = np.empty((13, n))
    start[:4] = np.array(problem.orientation_xyzw)[:, None]
    start[4:7], start[7:10] = problem.angular_velocities.T, 0.0
    start[10:] = np.array(problem.linear_velocity_world)[:, None]

    def prepare(tolerance: float) -> Run:
        accuracy = {"rtol": max(tolerance, 3e-14), "atol": tolerance}

        def solve() -> Callable[[], Answer]:
            y = start.ravel()
            for k in range(problem.holds):
                wrench = problem.force_body[k], problem.torque_body[k], problem.force_world[k]
                y = solve_ivp(slope, (0.0, problem.hold), y, method, (problem.hold,), args=wrench, **accuracy).y[:, -1]
            end = y.reshape(13, n)
            return lambda: Answer.of(end[:4].T, end[4:7].T, end[7:10].T)

        return solve

    return prepare
