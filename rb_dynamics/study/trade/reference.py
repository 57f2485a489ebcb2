"""The reference: the motion on which two methods of different families agree, and how closely they agree."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.closed_form import EXACT
from rb_dynamics.run.sample import Sample
from rb_dynamics.scene.model import Solver
from rb_dynamics.study.trade.excerpt import SHORTEST, Excerpt
from rb_dynamics.study.trade.refinement import TIME_IS_UP, Refinement, refine
from rb_dynamics.study.trade.result import Reference, setting

_EPSILON = 2.0**-52

# From coarse to fine; the finest that a method can meet in the time counts.
_ACCURACIES = (1e-4, *(10.0**-k for k in range(6, 15)))

# One method of each family, in the order in which they are tried; dverk is of that of dop853, but wheels take no other.
_FAMILIES = ("exact", "taylor", "dop853", "dlm6", "rkmk54", "radau", "midpoint6", "dverk")


def find_reference(
    trial: Excerpt, deadlines: Sequence[float], after: Callable[[], None]
) -> tuple[Excerpt, Reference, Sample]:
    """Return the excerpt, its reference, and the last sample of the reference.

    If no two methods can run the excerpt by the first of `deadlines` (s), an eighth of it is tried until the next.

    Raises:
        ConvergenceError: there was no time for a shorter excerpt either.
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
    """Return the reference and its last sample: two families are refined to the finest accuracy that they can meet.

    Raises:
        ConvergenceError: fewer than two methods reached the end of the excerpt in the time.
    """
    found: dict[str, tuple[Solver, Sample]] = {}
    reasons = []
    tally = trial.clock.tally()

    def measure(solver: Solver, limit: float) -> tuple[float, str]:
        run = trial.run(solver, tally, limit)
        if run is None:
            return math.inf, TIME_IS_UP
        found[solver.method] = solver, run.sample
        return run.time, ""

    able = [name for name in _FAMILIES if METHODS[name].takes >= trial.scene.combined_effects.takes]
    if len(able) < 2:
        raise ConvergenceError(
            f"{trial.scene.source}: trade compares two methods, and only {able[0]} takes "
            f"{', '.join(trial.scene.combined_effects.varying)}; leave these out of the scene, or ask explain"
        )
    for name in able:
        if len(found) < 2:
            refinement = Refinement(name, settings_of(name, _ACCURACIES), growth=1.5)
            trial.warm_up(refinement.settings[0])
            # At most half of the time left, so that another method can be tried.
            refine([refinement], measure, 0.5 * (trial.clock() + end), trial.clock, after)
            reasons.append(f"{name}: {refinement.ended}")
    if len(found) < 2:
        raise ConvergenceError(
            f"{trial.scene.source}: no two methods could run the scene to make a reference; give "
            f"more time (--time) or correct the cause.  {'; '.join(reasons)}"
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
    """Return the settings of a method that chooses its own steps; a closed form has only one."""
    return [Solver(name)] if name == EXACT.name else [Solver(name, accuracy=accuracy) for accuracy in accuracies]


def _accuracy(solver: Solver) -> float | None:
    return None if solver.method == EXACT.name else solver.accuracy
