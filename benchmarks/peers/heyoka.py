"""heyoka: Taylor's method, compiled for these equations; one call per command, with the wrench as parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import heyoka as hy
import numpy as np

from peers.problem import Answer, Problem, Run, Way

NAME = "heyoka"
PACKAGES = ("heyoka",)
ORBITS = True

BATCH = 4


def ways(problem: Problem) -> list[Way]:
    if problem.bodies > 1:
        return [Way("batches", "tolerance", 1e-6, _ensemble(problem))]
    return [Way("", "tolerance", 1e-6, _one(problem))]


def _system(problem: Problem) -> list[tuple[hy.expression, hy.expression]]:
    """Return the equations; the wrench that is held is a parameter."""
    names = ("x", "y", "z", "s", "p", "q", "r", "X", "Y", "Z", "U", "V", "W")
    symbols = hy.make_vars(*names)
    x, y, z, s, *w = symbols[:7]
    v = symbols[10:]
    # Absent parts cost nothing.
    force, torque, push = ([hy.par[i] for i in at] if len(at) else [hy.expression(0.0)] * 3 for at in _places(problem))
    inertia, inverse = problem.inertia, np.linalg.inv(problem.inertia)

    def times(matrix: np.ndarray, vector: list[hy.expression]) -> list[hy.expression]:
        return [
            sum((m * c for m, c in zip(row, vector, strict=True) if m != 0.0), hy.expression(0.0)) for row in matrix
        ]

    L = times(inertia, w)
    if problem.orbit:
        L = [momentum + held for momentum, held in zip(L, problem.orbit.rotor, strict=True)]
        force, torque, push = _in_orbit(problem, symbols)
    gyroscopic = cross(w, L)
    spin = times(inverse, [t - g for t, g in zip(torque, gyroscopic, strict=True)])
    a, b, c = (0.5 * rate for rate in w)
    forces = turned_by((x, y, z, s), force)
    accelerations = [
        (turned + pushed) / (problem.mass * _unit(problem)) + weight
        for turned, pushed, weight in zip(forces, push, problem.gravity, strict=True)
    ]
    turn = (s * a + y * c - z * b, s * b + z * a - x * c, s * c + x * b - y * a, -x * a - y * b - z * c)
    return list(zip(symbols, (*turn, *spin, *v, *accelerations), strict=True))


def _in_orbit(problem: Problem, symbols: list[hy.expression]) -> tuple[list[hy.expression], ...]:
    """Return force and torque in body axes and force in world axes."""
    mu, inertia, (c, k) = problem.orbit.gravitational_parameter, problem.inertia, problem.orbit.drag
    (x, y, z, s, *w), unit = symbols[:7], _unit(problem)
    place, v = ([unit * coordinate for coordinate in part] for part in (symbols[7:10], symbols[10:]))
    r = sum(coordinate**2 for coordinate in place) ** 0.5
    n = [coordinate / r for coordinate in turned_by((-x, -y, -z, s), place)]
    pulled = [sum(float(m) * part for m, part in zip(row, n, strict=True)) for row in inertia]
    both = sum(a * b for a, b in zip(n, pulled, strict=True))
    # MacCullagh's second term, and its force.
    along = [float(np.trace(inertia)) * a - 5.0 * both * a + 2.0 * b for a, b in zip(n, pulled, strict=True)]
    force = [-1.5 * mu / r**4 * part for part in along]
    torque = [3.0 * mu / r**3 * part - k * rate for part, rate in zip(cross(n, pulled), w, strict=True)]
    push = [-mu * problem.mass / r**3 * a - c * b for a, b in zip(place, v, strict=True)]
    return force, torque, push


def cross(a: Sequence[hy.expression], b: Sequence[hy.expression]) -> list[hy.expression]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def turned_by(orientation: Sequence[hy.expression], vector: Sequence[hy.expression]) -> list[hy.expression]:
    *axis, s = orientation
    twice = [2.0 * part for part in cross(axis, vector)]
    return [a + s * b + c for a, b, c in zip(vector, twice, cross(axis, twice), strict=True)]


def _unit(problem: Problem) -> float:
    """Return the unit of length (m): in orbit the radius, as the tolerance is relative to the largest number."""
    return float(np.linalg.norm(problem.position_world)) if problem.orbit else 1.0


def _starts(problem: Problem) -> np.ndarray:
    n = problem.bodies
    place = np.concatenate((problem.position_world, problem.linear_velocity_world)) / _unit(problem)
    fixed = np.concatenate((problem.orientation_xyzw, np.zeros(3), place))
    found = np.tile(fixed, (n, 1))
    found[:, 4:7] = problem.angular_velocities
    return found


def _places(problem: Problem) -> list[range]:
    """Return the indices of force and torque in body axes and of force in world axes among the parameters."""
    found, first = [], 0
    for part in (problem.force_body, problem.torque_body, problem.force_world):
        found.append(range(first, first + 3 * bool(part.any())))
        first = found[-1].stop
    return found


def _wrenches(problem: Problem) -> np.ndarray:
    """Return the parameters of each hold."""
    parts = (problem.force_body, problem.torque_body, problem.force_world)
    return np.hstack([part for part in parts if part.any()] or [np.empty((problem.holds, 0))])


def _one(problem: Problem) -> Callable[[float], Run]:
    wrenches, (start,) = _wrenches(problem), _starts(problem)
    ends = [(k + 1) * problem.hold for k in range(problem.holds)]

    def prepare(tolerance: float) -> Run:
        integrator = hy.taylor_adaptive(_system(problem), start, pars=wrenches[0], tol=tolerance, high_accuracy=True)
        state, parameters = integrator.state, integrator.pars

        def solve() -> Callable[[], Answer]:
            integrator.time = 0.0
            state[:] = start
            for wrench, end in zip(wrenches, ends, strict=True):
                parameters[:] = wrench
                integrator.propagate_until(end)
            found = state.copy()
            return lambda: Answer.of(found[:4], found[4:7], _unit(problem) * found[7:10])

        return solve

    return prepare


def _ensemble(problem: Problem) -> Callable[[float], Run]:
    wrench, starts = _wrenches(problem)[0], _starts(problem)
    batches = starts.reshape(-1, BATCH, 13).transpose(0, 2, 1).copy()
    parameters = np.repeat(wrench[:, None], BATCH, axis=1)

    def prepare(tolerance: float) -> Run:
        integrator = hy.taylor_adaptive_batch(
            _system(problem), batches[0], pars=parameters, tol=max(tolerance, 2.3e-16)
        )

        def place(one: hy.taylor_adaptive_batch_dbl, number: int) -> hy.taylor_adaptive_batch_dbl:
            one.set_time(0.0)
            one.state[:] = batches[number]
            return one

        def solve() -> Callable[[], Answer]:
            found = hy.ensemble_propagate_until_batch(integrator, problem.duration, len(batches), place)
            ends = np.concatenate([one.state.T for one, *_ in found])
            return lambda: Answer.of(ends[:, :4], ends[:, 4:7], ends[:, 7:10])

        return solve

    return prepare
