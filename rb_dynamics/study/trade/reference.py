"""The reference: the motion on which two methods of different families agree, and how closely they do."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.exact import EXACT
from rb_dynamics.run.sample import Sample
from rb_dynamics.scene.model import Solver
from rb_dynamics.study.trade.excerpt import SHORTEST, Excerpt
from rb_dynamics.study.trade.refinement import TIME_IS_UP, Climber, climb
from rb_dynamics.study.trade.result import Reference, setting

_EPSILON = 2.0**-52

# From coarse to fine: of those that a method can keep, and has the time for, the last one counts.
_ACCURACIES = (1e-4, *(10.0**-k for k in range(6, 15)))

# One of each family, in the order in which they are tried.
_FAMILIES = ("exact", "taylor", "dop853", "dlm6", "rkmk54", "radau", "midpoint6")


def find_reference(
    trial: Excerpt, deadlines: Sequence[float], after: Callable[[], None]
) -> tuple[Excerpt, Reference, Sample]:
    """Return the trial, its reference and the end of its motion.

    Where no two methods run the trial by the first of `deadlines` (s), an eighth of it is tried until the next.

    Raises:
        ConvergenceError: nor is there time for any shorter one.
    """
    for number, deadline in enumerate(deadlines, start=1):
        try:
            return trial, *_reference(trial, deadline, after)
        except ConvergenceError:
            seconds = float(f"{0.125 * trial.seconds:.3g}")
            if number == len(deadlines) or trial.clock() > deadlines[-1] or seconds < SHORTEST:
                raise
            trial = trial.part(seconds).look()
    raise ValueError("deadlines is empty, expected at least one")


def _reference(trial: Excerpt, end: float, after: Callable[[], None]) -> tuple[Reference, Sample]:
    """Return the reference and the end of its motion: two families go on to the finest that they can keep.

    Raises:
        ConvergenceError: not two of them came to the end of the trial in the time.
    """
    found: dict[str, tuple[Solver, Sample]] = {}
    reasons = []
    tally = trial.clock.tally()

    def measure(solver: Solver, limit: float) -> tuple[float, str]:
        flight = trial.fly(solver, tally, limit)
        if flight is None:
            return math.inf, TIME_IS_UP
        found[solver.method] = solver, flight.sample
        return flight.time, ""

    for name in _FAMILIES:
        if METHODS[name].takes >= trial.scene.combined_effects.takes and len(found) < 2:
            climber = Climber(name, settings_of(name, _ACCURACIES), growth=1.5)
            trial.warm_up(climber.settings[0])
            # No more than half of what is left, so that another one can be tried.
            climb([climber], measure, 0.5 * (trial.clock() + end), trial.clock, after)
            reasons.append(f"{name}: {climber.ended}")
    if len(found) < 2:
        raise ConvergenceError(
            f"{trial.scene.source}: no reference could be made, which takes two methods that can run the scene; give "
            f"more time (--time) or mend what they refuse. {'; '.join(reasons)}"
        )
    best = sorted(found.values(), key=lambda one: _accuracy(one[0]) or 0.0)
    (solver, truth), (other, check) = best
    apart = trial.differences(truth, check)
    turned = trial.rate * trial.seconds
    floors = (
        4.0 * _EPSILON * (1.0 + turned),
        4.0 * _EPSILON * trial.rate,
        4.0 * _EPSILON * (trial.farthest + trial.path),
    )
    attitude, rate, position = map(max, apart, floors)
    made, checked = (f"{one.method}, {setting(None, _accuracy(one))}" for one in (solver, other))
    return Reference(made, checked, attitude, rate, position, trial.error(attitude, position), trial.path), truth


def settings_of(name: str, accuracies: Sequence[float]) -> list[Solver]:
    """Return the settings of a method that finds its own steps; a closed form has only one."""
    return [Solver(name)] if name == EXACT.name else [Solver(name, accuracy=accuracy) for accuracy in accuracies]


def _accuracy(solver: Solver) -> float | None:
    return None if solver.method == EXACT.name else solver.accuracy
