"""`trade`: measure speed against accuracy of all methods that can run a scene, on the scene itself, and recommend one.

Every method goes from coarse settings to fine ones, in turns, so that all get about the same time. Results are
compared with a reference on which two methods of different families agree.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from rb_dynamics.errors import SceneError
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import METHODS, remedy
from rb_dynamics.numerics.argument_checks import items, number, shown
from rb_dynamics.run.simulation import as_command
from rb_dynamics.scene import opened
from rb_dynamics.scene.model import DEFAULT_ACCURACY, Scene
from rb_dynamics.scene.plan import cannot_take
from rb_dynamics.study.explain import measured_length, probed
from rb_dynamics.study.stopwatch import Clock, Stopwatch
from rb_dynamics.study.trade.excerpt import accepted, trial_of
from rb_dynamics.study.trade.full_runs import FullRuns, enough
from rb_dynamics.study.trade.measurement import RunMeasurement, climbers_for
from rb_dynamics.study.trade.reference import find_reference
from rb_dynamics.study.trade.refinement import climb
from rb_dynamics.study.trade.result import (
    Recommendation,
    Reference,
    Trade,
    TradeRow,
    as_measured,
    recommend,
    with_front,
)

# Of the time there is: one run of the trial may take so much, and finding the reference, at the first attempt and at
# those that follow.
_PILOT, _REFERENCE = 1.0 / 60.0, (0.4, 0.5, 0.6)

# On top of it, relative to it: what compiling and loading kernels may take, and flying the whole scene where the trial
# is a part of it.
_KERNELS, _WHOLE = 1.0, 1.0 / 3.0


def trade(
    scene: Scene | str | os.PathLike[str],
    commands: Sequence[tuple[str, Wrench]] = (),
    *,
    target: float | None = None,
    budget: float | None = None,
    time_s: float = 30.0,
    methods: Sequence[str] | None = None,
    progress: Callable[[float], None] | None = None,
    clock: Clock = time.perf_counter,
    compiling: Callable[[str], None] | None = None,
) -> Trade:
    """Return how fast and how accurate each method that can run `scene` is on it.

    Args:
        scene: is not changed, or its file; its solver gives the target where none is asked for.
        commands: wrench commands of the scene's channels; without any, a channel is tried with a probe if no
            effect acts.
        target: error to be kept, in attitude (rad) and in position relative to the path.
        budget: real-time factor to be kept; then the most accurate row is recommended.
        time_s: about how long all of it may take, s; compiling kernels may take as long again, once. A third comes on
            top where that is not enough for the whole scene, over which what is recommended is flown then.
        methods: names of those to measure, "auto" among them; None for all. The reference is the same.
        progress: called now and then with the fraction done.
        clock: what is measured with, s.
        compiling: called before a kernel is compiled that is in no cache, with its name.

    Raises:
        TypeError: an argument is not of its type.
        ValueError: target, budget or time is not greater than 0.
        SceneError: the file says no valid scene, the scene has nothing to measure, or one of `methods` is unknown or
            cannot take the effects of the scene.
        ConvergenceError: no two methods can run the scene in the time.
    """
    scene = opened(scene)
    commands = list(map(as_command, items(commands, "commands", "(topic, wrench) pairs")))
    number(time_s, "time_s", "a finite number greater than 0 (s)", above=0.0)
    for name, wish in (("target", target), ("budget", budget)):
        if wish is not None:
            number(wish, name, "a finite number greater than 0, or None", above=0.0)
    names = None if methods is None else _asked_for(items(methods, "methods", "names of methods"), scene)
    length = measured_length(scene)
    stopwatch = Stopwatch(clock, _KERNELS * time_s, compiling)
    begin = stopwatch()

    def told() -> None:
        if progress is not None:
            progress(min(1.0, (stopwatch() - begin) / time_s))

    if target is None and budget is None:
        target = scene.solver.accuracy or DEFAULT_ACCURACY
    commands, remarks = probed(scene, commands, length)
    kept = accepted(scene, commands)
    if len(kept) < len(commands):
        remarks.append(f"{len(commands) - len(kept)} of {len(commands)} wrench commands were rejected")
    trial, reference, truth = find_reference(
        trial_of(scene, kept, _PILOT * time_s, stopwatch), [begin + share * time_s for share in _REFERENCE], told
    )
    if trial.seconds < trial.whole:
        remarks.append(
            f"measured over the first {trial.seconds:.6g} s of {trial.whole:g} s: the errors of rows are those after "
            "them, and more time (--time) measures more"
        )
    table = RunMeasurement(replace(trial, horizon=scene.duration), reference, truth, target)
    climbers = climbers_for(trial) if reference.is_useful else []
    if names is not None:
        remarks.append(f"measured as asked for: {', '.join(names)}; all other methods are left out")
        climbers = [climber for climber in climbers if climber.method in names]
    climb(climbers, table.measure, begin + time_s, stopwatch, told, table.foresee)
    rows = with_front([row for climber in climbers for row in table.rows.get(climber.method, ())])
    whole = FullRuns(trial, kept, rows, _WHOLE * time_s) if rows and trial.seconds < trial.whole else None
    if progress is not None:
        progress(1.0)
    return Trade(
        scene.source,
        trial.seconds,
        reference,
        rows,
        recommend(rows, target, budget, whole.judge if whole else as_measured),
        target,
        budget,
        {climber.method: climber.ended for climber in climbers},
        stopwatch.kernels,
        tuple(remarks),
        trial.whole,
        whole.checked_by if whole else None,
        enough(rows, target, trial, _WHOLE) if trial.seconds < trial.whole and target is not None else None,
    )


def _asked_for(names: Sequence[object], scene: Scene) -> list[str]:
    """Return `names` of methods, each once.

    Raises:
        SceneError: there are none, there is no such method, or it cannot take what acts.
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
