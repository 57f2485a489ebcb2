"""Reference end states of a problem: the closed form, or two methods of this package that agree."""

from __future__ import annotations

import numpy as np

import rb_dynamics as rb
from peers.problem import Answer, Problem, attitude_error, steps
from peers.translate import answer, body_of, effects_of, held_of, numbers_of, states_of
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.arc import Arc
from rb_dynamics.motion.phase_state import PhaseState, inertia_of
from rb_dynamics.motion.step_control import FixedStep
from rb_dynamics.numerics.nanoseconds import NANOSECONDS

# Two families, which share no formula except for the books, with the minimum number of steps in a hold: the first with
# few, as each adds rounding. None of the ways compared takes the same steps.
METHODS_THAT_AGREE = (("strang6", 1), ("dlm6", 2))
METHODS_IN_ORBIT = ("dverk", "dop853")


def reference(problem: Problem) -> Answer:
    """Return the answer with an error of at most a tenth of the target.

    Raises:
        ArithmeticError: the two methods do not agree.
    """
    if problem.is_free:
        return _closed(problem)
    if problem.orbit:
        one, other = (_in_orbit(problem, name) for name in METHODS_IN_ORBIT)
    else:
        one, other = (_stepped(problem, name, least) for name, least in METHODS_THAT_AGREE)
    apart = attitude_error(one, other)
    if not apart < 0.1 * problem.wanted:
        raise ArithmeticError(f"{problem.name}: the references are {apart:.1e} rad apart, expected {problem.wanted:g}")
    return one


def _closed(problem: Problem) -> Answer:
    body, t = body_of(problem), problem.duration
    ends = [rb.free_motion(body, state, t) for state in states_of(problem)]
    fall = 0.5 * t * t * np.array(problem.gravity)
    return Answer.of(
        [e.orientation_xyzw for e in ends],
        [e.angular_velocity_body for e in ends],
        [e.position_world + fall for e in ends],
    )


def _in_orbit(problem: Problem, name: str) -> Answer:
    (state,) = states_of(problem)
    solver = rb.Solver(name, step=1.0)
    scene = rb.Scene(
        body_of(problem), rb.WrenchFrames(), state, (), solver, problem.duration, effects=effects_of(problem)
    )
    end = rb.simulate(scene).sample
    return Answer.of(end.orientation_xyzw, end.angular_velocity_body, end.position_world)


def _stepped(problem: Problem, name: str, least: int) -> Answer:
    body, hold = body_of(problem), round(problem.hold * NANOSECONDS)
    step = FixedStep(problem.hold / max(least, steps(problem, 0.03)))
    rows = []
    for numbers in numbers_of(problem).tolist():
        phase = PhaseState(tuple(numbers[:4]), tuple(numbers[4:7]), tuple(numbers[7:21]), tuple(numbers[21:]))
        for k, held in enumerate(held_of(problem)):
            arc = Arc(METHODS[name], inertia_of(body), held, step, k * hold, phase)
            phase = arc.at((k + 1) * hold)
        rows.append((*phase.orientation, *phase.angular_velocity, *phase.high, *phase.low))
    return answer(problem, np.array(rows))
