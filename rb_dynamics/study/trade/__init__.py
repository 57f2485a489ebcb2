"""`trade`: measure speed and accuracy of every method that can run a scene, on that scene, and recommend one.

Settings are refined in turns, so that all methods get about the same time. Errors are differences from a reference on
which two methods of different families agree.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from rb_dynamics.errors import SceneError
from rb_dynamics.motion import METHODS, remedy
from rb_dynamics.numerics.argument_checks import items, number, shown
from rb_dynamics.run.plan import cannot_take
from rb_dynamics.run.posting import Command, each_command
from rb_dynamics.scene import opened
from rb_dynamics.scene.model import DEFAULT_ACCURACY, Scene
from rb_dynamics.study.explain import fixed_costs, measured_length, probed
from rb_dynamics.study.stopwatch import Clock, Stopwatch
from rb_dynamics.study.trade.excerpt import accepted, trial_of
from rb_dynamics.study.trade.full_runs import FullRuns, enough
from rb_dynamics.study.trade.reference import find_reference
from rb_dynamics.study.trade.refinement import refine
from rb_dynamics.study.trade.result import (
    Recommendation,
    Reference,
    Trade,
    TradeRow,
    as_measured,
    recommend,
    with_front,
)
from rb_dynamics.study.trade.work_precision import WorkPrecision, refinements_for

# Shares of `time_s`: the longest run of the excerpt, and the deadlines of the attempts to find a reference.
_PILOT, _REFERENCE = 1.0 / 60.0, (0.4, 0.5, 0.6)

# Beyond `time_s`, relative to it: compiling and loading kernels, and running the whole scene if the excerpt is shorter.
_KERNELS, _WHOLE = 1.0, 1.0 / 3.0


def trade(
    scene: Scene | str | os.PathLike[str],
    commands: Sequence[Command] = (),
    *,
    target: float | None = None,
    budget: float | None = None,
    time_s: float = 30.0,
    methods: Sequence[str] | None = None,
    progress: Callable[[float], None] | None = None,
    clock: Clock = time.perf_counter,
    compiling: Callable[[str], None] | None = None,
) -> Trade:
    """Return the speed and accuracy of each method that can run `scene`.

    Args:
        scene: or its file; not changed. Its solver gives the target if neither `target` nor `budget` is given.
        commands: wrench commands of the scene's channels; without any, and if no effect acts, a probe is used.
        target: largest error allowed, in attitude (rad) and in position relative to the path.
        budget: real-time factor required; the most accurate row that reaches it is recommended.
        time_s: approximate total time, s. Compiling kernels may take as long again, once; checking the recommendation
            over the whole scene, if the excerpt is shorter, a third of it more.
        methods: names of those to measure, which may include "auto"; None for all. The reference is the same.
        progress: called repeatedly with the fraction done.
        clock: used for all measurements, s.
        compiling: called with the name of a kernel before it is compiled (not when it is loaded from the cache).

    Raises:
        TypeError: an argument has the wrong type.
        ValueError: target, budget or time_s is not greater than 0.
        SceneError: the scene is not valid or has nothing to measure, or one of `methods` is unknown or does not support
            the effects of the scene.
        ConvergenceError: no two methods can run the scene in the time available.
    """
    scene = opened(scene)
    commands = [*each_command(items(commands, "commands", "(topic, wrench) pairs"))]
    number(time_s, "time_s", "a finite number greater than 0 (s)", above=0.0)
    for name, wish in (("target", target), ("budget", budget)):
        if wish is not None:
            number(wish, name, "a finite number greater than 0, or None", above=0.0)
    names = None if methods is None else _asked_for(items(methods, "methods", "names of methods"), scene)
    length = measured_length(scene)
    stopwatch = Stopwatch(clock, _KERNELS * time_s, compiling)
    begin = stopwatch()

    def report_progress() -> None:
        if progress is not None:
            progress(min(1.0, (stopwatch() - begin) / time_s))

    if target is None and budget is None:
        target = scene.solver.accuracy or DEFAULT_ACCURACY
    commands, remarks = probed(scene, commands, length)
    accepted_commands = accepted(scene, commands)
    if len(accepted_commands) < len(commands):
        remarks.append(f"{len(commands) - len(accepted_commands)} of {len(commands)} commands were rejected")
    trial, reference, truth = find_reference(
        trial_of(scene, accepted_commands, _PILOT * time_s, stopwatch),
        [begin + share * time_s for share in _REFERENCE],
        report_progress,
    )
    if trial.seconds < trial.whole:
        remarks.append(
            f"measured over the first {trial.seconds:.6g} s of {trial.whole:g} s, for which the errors "
            "in the table hold; more time (--time) measures a longer part"
        )
    if trial.path == 0.0 and trial.rate == 0.0:
        remarks.append(
            "the body does not move, so every setting is exact, and these errors say nothing of another motion; give "
            "it a velocity, a rate, or a load that moves it"
        )
    table = WorkPrecision(replace(trial, horizon=scene.duration), reference, truth, target)
    refinements = refinements_for(trial) if reference.is_useful else []
    if names is not None:
        remarks.append(f"measured only {', '.join(names)}, as requested")
        refinements = [refinement for refinement in refinements if refinement.method in names]
    refine(refinements, table.measure, begin + time_s, stopwatch, report_progress, table.foresee)
    rows = with_front([row for refinement in refinements for row in table.rows.get(refinement.method, ())])
    needed = enough(rows, target, trial, _WHOLE) if trial.seconds < trial.whole and target is not None else None
    whole = FullRuns(trial, accepted_commands, rows, _WHOLE * time_s) if rows and trial.seconds < trial.whole else None
    if progress is not None:
        progress(1.0)
    taken = recommend(rows, target, budget, whole.judge if whole else as_measured, trial.seconds)
    if taken is not None:
        chosen = replace(scene, solver=taken.row.as_solver)
        remarks += fixed_costs(chosen, accepted_commands, stopwatch, taken.row.time_per_s * trial.whole)
    return Trade(
        scene.source,
        trial.seconds,
        reference,
        rows,
        taken,
        target,
        budget,
        {refinement.method: refinement.ended for refinement in refinements},
        stopwatch.kernels,
        tuple(remarks),
        trial.whole,
        whole.checked_by if whole else None,
        # What has been spent in vain is not enough.
        needed if needed is not None and needed > time_s else None,
    )


def _asked_for(names: Sequence[object], scene: Scene) -> list[str]:
    """Return the `names` of methods without duplicates.

    Raises:
        SceneError: there are none, one is unknown, or one does not support the load of the scene.
    """
    found: list[str] = []
    for name in names:
        if name != "auto" and name not in METHODS:
            known = ("auto", *METHODS)
            mend = remedy(name, known, "write some of them")
            raise SceneError(f"methods has {shown(name)}, expected names out of {', '.join(known)}; {mend}")
        if name != "auto" and METHODS[str(name)].takes < scene.combined_effects.takes:
            raise SceneError(cannot_take(scene, METHODS[str(name)], scene.combined_effects.takes))
        if name not in found:
            found.append(str(name))
    if not found:
        raise SceneError("methods is empty, expected names of methods, or None for all; name one")
    return found


__all__ = ["Recommendation", "Reference", "TradeRow", "Trade", "trade"]
