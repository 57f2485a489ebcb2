"""Convert a problem to the types of rb_dynamics and the arrays of its kernels; shared by `ours.py` and `c.py`."""

from __future__ import annotations

import numpy as np

import rb_dynamics as rb
from peers.problem import Answer, Problem
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.kernel_layout import constant_numbers, phase_numbers, phase_of
from rb_dynamics.motion.phase_state import PhaseState, in_principal_axes, inertia_of


def body_of(problem: Problem) -> rb.RigidBody:
    return rb.RigidBody.from_matrix(problem.mass, problem.inertia.tolist())


def states_of(problem: Problem) -> list[rb.State]:
    """Return the initial state of each body."""
    position = problem.position_world
    velocity, attitude = problem.linear_velocity_world, problem.orientation_xyzw
    return [rb.State(0, position, attitude, velocity, tuple(w)) for w in problem.angular_velocities.tolist()]


def effects_of(problem: Problem) -> tuple[rb.Effect, ...]:
    """Return gravity and what acts in orbit."""
    if problem.orbit is None:
        return (rb.UniformGravity(problem.gravity),) if any(problem.gravity) else ()
    effects: list[rb.Effect] = [rb.CentralGravity(problem.orbit.gravitational_parameter, gravity_gradient=True)]
    if any(problem.orbit.drag):
        translation, rotation = ((c, c, c) for c in problem.orbit.drag)
        effects.append(rb.LinearDrag(translation, rotation))
    if any(problem.orbit.rotor):
        effects.append(rb.Rotor(problem.orbit.rotor, 1.0, ((0.0, float(np.linalg.norm(problem.orbit.rotor))),)))
    return tuple(effects)


def constants_of(problem: Problem) -> np.ndarray:
    """Return the 16 constants under the first wrench; gravity is a force in world axes."""
    return np.array(constant_numbers(inertia_of(body_of(problem)), held_of(problem)[0]))


def held_of(problem: Problem) -> list[HeldWrench]:
    """Return the wrenches in principal axes."""
    body, weight = body_of(problem), problem.mass * np.array(problem.gravity)
    rows = zip(
        problem.force_body.tolist(), problem.torque_body.tolist(), (problem.force_world + weight).tolist(), strict=True
    )
    return [in_principal_axes(body, HeldWrench(tuple(f), tuple(t), tuple(w))) for f, t, w in rows]


def numbers_of(problem: Problem) -> np.ndarray:
    """Return the initial states as the kernels have them: (n, 35)."""
    body = body_of(problem)
    return np.array([phase_numbers(PhaseState.of(body, state)) for state in states_of(problem)])


def answer(problem: Problem, numbers: np.ndarray) -> Answer:
    """Return the answer in rows of 35 numbers."""
    body = body_of(problem)
    states = [phase_of(tuple(row)).state(body, 0) for row in numbers.tolist()]
    return Answer.of(
        [s.orientation_xyzw for s in states],
        [s.angular_velocity_body for s in states],
        [s.position_world for s in states],
    )


def booked(problem: Problem, numbers: np.ndarray) -> np.ndarray:
    """Return attitude, angular velocity, impulse, torque impulse and work of each body: (n, 14)."""
    found, sums = answer(problem, numbers), numbers[:, 7:21] + numbers[:, 21:]
    return np.hstack((found.orientation_xyzw, found.angular_velocity_body, sums[:, 6:13]))
