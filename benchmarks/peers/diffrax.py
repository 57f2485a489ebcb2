"""diffrax: Dopri8 with its step control, compiled by JAX in double precision; ensembles by `vmap`."""

from __future__ import annotations

from collections.abc import Callable

import diffrax
import jax
import numpy as np
from jax import numpy as jnp

from peers.problem import Answer, Problem, Run, Way, steps

NAME = "diffrax"
PACKAGES = ("diffrax", "jax")

jax.config.update("jax_enable_x64", True)


def ways(problem: Problem) -> list[Way]:
    if problem.holds > 1:
        return [Way("Dopri8, equal steps", "steps", steps(problem, 0.3), _held(problem))]
    return [Way("Dopri8", "tolerance", 1e-6, _adaptive(problem))]


def _slope(problem: Problem) -> Callable[..., jax.Array]:
    inertia, inverse = jnp.array(problem.inertia), jnp.array(np.linalg.inv(problem.inertia))
    gravity = jnp.array(problem.gravity)

    def slope(_: jax.Array, state: jax.Array, wrench: jax.Array) -> jax.Array:
        q, w, v = state[:4], state[4:7], state[10:]
        force, torque, push = wrench[:3], wrench[3:6], wrench[6:]
        turned = force + 2.0 * jnp.cross(q[:3], jnp.cross(q[:3], force) + q[3] * force)
        turn = 0.5 * jnp.append(q[3] * w + jnp.cross(q[:3], w), -q[:3] @ w)
        spin = inverse @ (torque - jnp.cross(w, inertia @ w))
        return jnp.concatenate((turn, spin, v, (turned + push) / problem.mass + gravity))

    return slope


def _starts(problem: Problem) -> jax.Array:
    fixed = np.concatenate((problem.orientation_xyzw, np.zeros(6), problem.linear_velocity_world))
    found = np.tile(fixed, (problem.bodies, 1))
    found[:, 4:7] = problem.angular_velocities
    return jnp.array(found)


def _wrenches(problem: Problem) -> jax.Array:
    return jnp.array(np.hstack((problem.force_body, problem.torque_body, problem.force_world)))


def _adaptive(problem: Problem) -> Callable[[float], Run]:
    term, starts, wrench = diffrax.ODETerm(_slope(problem)), _starts(problem), _wrenches(problem)[0]

    def prepare(tolerance: float) -> Run:
        def one(state: jax.Array) -> jax.Array:
            control = diffrax.PIDController(rtol=tolerance, atol=tolerance)
            return diffrax.diffeqsolve(
                term, diffrax.Dopri8(), 0.0, problem.duration, None, state, wrench,
                stepsize_controller=control, max_steps=None, adjoint=diffrax.ForwardMode(),
            ).ys[-1]  # fmt: skip

        return _run(jax.jit(jax.vmap(one) if problem.bodies > 1 else lambda all_of_them: one(all_of_them[0])), starts)

    return prepare


def _held(problem: Problem) -> Callable[[float], Run]:
    term, (start,), wrenches = diffrax.ODETerm(_slope(problem)), _starts(problem), _wrenches(problem)
    solver = diffrax.Dopri8()

    def prepare(count: float) -> Run:
        n, h = int(count), problem.hold / count

        def hold(state: jax.Array, wrench: jax.Array) -> tuple[jax.Array, None]:
            def step(_: int, y: jax.Array) -> jax.Array:
                begun = solver.init(term, 0.0, h, y, wrench)
                return solver.step(term, 0.0, h, y, wrench, begun, made_jump=False)[0]

            return jax.lax.fori_loop(0, n, step, state), None

        return _run(jax.jit(lambda state: jax.lax.scan(hold, state, wrenches)[0]), start)

    return prepare


def _run(compiled: Callable[[jax.Array], jax.Array], start: jax.Array) -> Run:
    def solve() -> Callable[[], Answer]:
        ends = np.atleast_2d(compiled(start).block_until_ready())
        return lambda: Answer.of(ends[:, :4], ends[:, 4:7], ends[:, 7:10])

    return solve
