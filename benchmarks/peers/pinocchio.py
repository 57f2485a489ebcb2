"""Pinocchio: the articulated-body algorithm on a free flyer, with a Munthe-Kaas RK4 of ours; it has no integrator.

Its velocities and wrenches are in body axes; the loop is in Python.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from peers.problem import Answer, Problem, Run, Way, steps

NAME = "Pinocchio"
PACKAGES = ("pin",)


def ways(problem: Problem) -> list[Way]:
    if problem.bodies > 1:
        return []
    return [Way("RK4 in Python", "steps", steps(problem, 0.2), _prepare(problem))]


def _prepare(problem: Problem) -> Callable[[float], Run]:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia(problem.mass, np.zeros(3), problem.inertia), pin.SE3.Identity())
    model.gravity.linear = np.array(problem.gravity)
    data = model.createData()
    q0 = np.concatenate((np.zeros(3), np.array(problem.orientation_xyzw) / np.linalg.norm(problem.orientation_xyzw)))
    turn = pin.Quaternion(q0[3:]).toRotationMatrix()
    v0 = np.concatenate((turn.T @ problem.linear_velocity_world, problem.angular_velocities[0]))
    held = list(
        zip(
            np.hstack((problem.force_body, problem.torque_body)),
            problem.force_world,
            problem.force_world.any(axis=1),
            strict=True,
        )
    )

    def prepare(count: float) -> Run:
        n, h = int(count), problem.hold / count
        aba, integrate, rotation = pin.aba, pin.integrate, pin.Quaternion

        def slope(q: np.ndarray, v: np.ndarray, wrench: np.ndarray, push: np.ndarray, pushed: bool) -> np.ndarray:
            if pushed:
                wrench = wrench.copy()
                wrench[:3] += rotation(q[3:]).conjugate() * push
            return aba(model, data, q, v, wrench)

        def step(q: np.ndarray, v: np.ndarray, *wrench: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            # dexpinv of the Lie group of rigid motions, cut off where order 4 is kept (Hairer et al., IV.8.2).
            a1 = slope(q, v, *wrench)
            v2 = v + 0.5 * h * a1
            k1 = h * v
            k2 = _kept(0.5 * k1, h * v2)
            a2 = slope(integrate(model, q, 0.5 * k1), v2, *wrench)
            v3 = v + 0.5 * h * a2
            k3 = _kept(0.5 * k2, h * v3)
            a3 = slope(integrate(model, q, 0.5 * k2), v3, *wrench)
            v4 = v + h * a3
            k4 = _kept(k3, h * v4)
            a4 = slope(integrate(model, q, k3), v4, *wrench)
            return integrate(model, q, (k1 + 2.0 * (k2 + k3) + k4) / 6.0), v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)

        def solve() -> Callable[[], Answer]:
            q, v = q0, v0
            for wrench in held:
                for _ in range(n):
                    q, v = step(q, v, *wrench)
            return lambda: Answer.of(q[3:], v[3:], q[:3])

        return solve

    return prepare


def _kept(u: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Return k + [u, k] / 2 + [u, [u, k]] / 12: the velocity of the exponent u of a motion exp(u) seen in the body."""
    first = _bracket(u, k)
    return k + 0.5 * first + _bracket(u, first) / 12.0


def _bracket(u: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Return the commutator of two motions, linear part first."""
    (a, b, c, x, y, z), (d, e, f, r, s, t) = u.tolist(), k.tolist()
    return np.array(
        (
            y * f - z * e + b * t - c * s,
            z * d - x * f + c * r - a * t,
            x * e - y * d + a * s - b * r,
            y * t - z * s,
            z * r - x * t,
            x * s - y * r,
        )
    )
