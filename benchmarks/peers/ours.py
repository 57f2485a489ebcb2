"""rb_dynamics: the closed form, ensembles and `driven_motion` in one call, and `simulate`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

import rb_dynamics as rb
from peers.problem import Answer, Problem, Run, Way, steps, threads_named
from peers.translate import body_of, effects_of, states_of
from rb_dynamics.numerics.compilation import available

NAME = "rb_dynamics"
PACKAGES = ("numpy", "numba") if available() else ("numpy",)
ORBITS = True

# One of each family, of the orders 4, 6, 6, 8 and 12.
METHODS = ("rk4", "dlm6", "dverk", "dop853", "taylor")


def ways(problem: Problem) -> list[Way]:
    if problem.bodies > 1:
        return [Way(f"Ensemble, {name}", "steps", steps(problem, 0.5), _ensemble(problem, name)) for name in METHODS]
    found = [Way("simulate, auto", "tolerance", 1e-6, _simulate(problem))]
    if problem.orbit:
        return found
    if problem.is_free and not any(problem.gravity):
        return [Way("free_motion", "", 1.0, _free(problem)), *found]
    if problem.is_free:
        return [Way("driven_motion, exact", "", 1.0, _driven(problem, "exact")), *found]
    return [
        *(Way(f"driven_motion, {name}", "steps", steps(problem, 0.5), _driven(problem, name)) for name in METHODS),
        *found,
    ]


def _free(problem: Problem) -> Callable[[float], Run]:
    def prepare(_: float) -> Run:
        body, (state,) = body_of(problem), states_of(problem)

        def solve() -> Callable[[], Answer]:
            end = rb.free_motion(body, state, problem.duration)
            return lambda: Answer.of(end.orientation_xyzw, end.angular_velocity_body, end.position_world)

        return solve

    return prepare


def _driven(problem: Problem, method: str) -> Callable[[float], Run]:
    def prepare(count: float) -> Run:
        body, (state,) = body_of(problem), states_of(problem)
        times_ns = round(1e9 * problem.hold) * np.arange(1, problem.holds + 1)
        step = None if method == "exact" else problem.hold / count
        wrenches = _wrenches(problem)

        def solve() -> Callable[[], Answer]:
            # No peer keeps intermediate states.
            found = rb.driven_motion(body, state, times_ns, method=method, step=step, last_only=True, **wrenches)
            return lambda: Answer.of(found.orientation_xyzw[0], found.angular_velocity_body[0], found.position_world[0])

        return solve

    return prepare


def _wrenches(problem: Problem) -> dict[str, np.ndarray]:
    """Return the held wrenches; uniform gravity is a force in world axes."""
    return {
        "force_body": problem.force_body,
        "torque_body": problem.torque_body,
        "force_world": problem.force_world + problem.mass * np.array(problem.gravity),
    }


def _ensemble(problem: Problem, method: str) -> Callable[[float], Run]:
    held = {name: wrench[0] for name, wrench in _wrenches(problem).items()}

    def prepare(count: float) -> Run:
        body, states = body_of(problem), states_of(problem)
        fresh = [rb.Ensemble(body, states, method, problem.duration / count)]

        def solve() -> Callable[[], Answer]:
            ensemble = fresh.pop()
            ensemble.hold(**held)
            ensemble.advance(problem.duration)

            def read() -> Answer:
                fresh.append(rb.Ensemble(body, states, method, problem.duration / count))
                end = ensemble.samples()
                return Answer.of(end.orientation_xyzw, end.angular_velocity_body, end.position_world)

            return read

        return solve

    return prepare


def _simulate(problem: Problem) -> Callable[[float], Run]:
    """Run `simulate` as in the README: a scene and commands, with the default method and steps."""
    commands = _commands(problem)
    (state,) = states_of(problem)

    def prepare(tolerance: float) -> Run:
        scene = rb.Scene(
            body_of(problem),
            rb.WrenchFrames(),
            state,
            (rb.Channel("thrusters"), rb.Channel("environment")),
            rb.Solver("auto", accuracy=tolerance),
            problem.duration,
            effects=effects_of(problem),
        )

        def solve() -> Callable[[], Answer]:
            end = rb.simulate(scene, commands).sample
            return lambda: Answer.of(end.orientation_xyzw, end.angular_velocity_body, end.position_world)

        return solve

    return prepare


def _commands(problem: Problem) -> list[tuple[str, rb.Wrenches]]:
    """Return the commands; absent parts cost nothing, as with the peers."""
    times = round(problem.hold * 1e9) * np.arange(problem.holds)
    found = []
    if problem.force_body.any() or problem.torque_body.any():
        found.append(("thrusters", rb.Wrenches(problem.force_body, problem.torque_body, "body", times)))
    if problem.force_world.any():
        found.append(("environment", rb.Wrenches(problem.force_world, frame_id="world", stamp_ns=times)))
    return found


def kernels(problem: Problem, h: float, n: int) -> dict[str, Callable[[], Callable[[], np.ndarray]]]:
    """Return functions for n rk4 steps of h s of all bodies of `problem`; each returns a reader of the result."""
    body, states, wrenches = body_of(problem), states_of(problem), _wrenches(problem)

    def booked(found: rb.Samples) -> np.ndarray:
        n = problem.bodies
        fields = ("orientation_xyzw", "angular_velocity_body", "impulse_world", "torque_impulse_world", "work")
        return np.hstack([getattr(found, name).reshape(n, -1) for name in fields])

    if problem.bodies == 1:
        times_ns = np.array([round(1e9 * h * n)])

        def one() -> Callable[[], np.ndarray]:
            found = rb.driven_motion(body, states[0], times_ns, method="rk4", step=h, **wrenches)
            return lambda: booked(found)

        return {"rk4": one}
    held = {name: wrench[0] for name, wrench in wrenches.items()}

    def fresh(threads: int) -> rb.Ensemble:
        ensemble = rb.Ensemble(body, states, "rk4", h, threads)
        ensemble.hold(**held)
        return ensemble

    prepared = {threads: [fresh(threads)] for threads in (1, 2)}

    def many(threads: int) -> Callable[[], np.ndarray]:
        ensemble = prepared[threads].pop()
        ensemble.advance(h * n)

        def read() -> np.ndarray:
            prepared[threads].append(fresh(threads))
            return booked(ensemble.samples())

        return read

    return {f"rk4, {threads_named(threads)}": partial(many, threads) for threads in (1, 2)}
