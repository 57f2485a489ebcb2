"""`simulate`: a scene under its commands, from its beginning to its end."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, cast

from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.wrench_command_arrays import Wrenches
from rb_dynamics.numerics.argument_checks import shown
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.run.posting import Batches, Commands, post_ahead, rejected_words
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.scene_remarks import command_remarks, scene_remarks
from rb_dynamics.run.simulation import Simulation, without_outputs
from rb_dynamics.run.sink import Sink
from rb_dynamics.run.stop_signals import interrupts_wait, uninterrupted
from rb_dynamics.scene import opened
from rb_dynamics.scene.model import Scene

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

# Commands of a list of which the period is looked at.
_FIRST = 100


@dataclass(frozen=True, slots=True)
class Run:
    """Result of `simulate`.

    Attributes:
        sample: at the end of the run.
        method: names of the methods that moved the body, joined by "+".
        steps: total number of steps.
        wall_time_s: wall time of the run, s.
        rejected: the reason for each rejected command; the run continued without them.
        clipped_on: number of commands reduced by the limits of their channel or actuator, by topic.
        remarks: warnings in full sentences, about limits that were nearly reached, steps that are too long, and
            commands that come too slowly.
    """

    sample: Sample
    method: str
    steps: int
    wall_time_s: float
    rejected: tuple[str, ...] = ()
    clipped_on: Mapping[str, int] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    @property
    def clipped(self) -> int:
        """Number of commands reduced by the limits of their channel or actuator."""
        return sum(self.clipped_on.values())


def simulate(
    scene: Scene | str | os.PathLike[str],
    commands: Iterable[Commands] = (),
    sinks: Sequence[Sink] = (),
    progress: Callable[[float], None] | None = None,
    facts: Mapping[str, str] | None = None,
) -> Run:
    """Run `scene` to the end of its duration; each of `commands` (topic, wrench) takes effect at its stamp.

    A command stamped before 0 counts as given at 0. `Wrenches` in place of a wrench is many commands, as arrays.

    Args:
        scene: the scene to simulate, or its file; its `duration` must be given.
        commands: for the scene's channels and actuators. Those after the end have no effect; rejected ones are named
            in the result, as in the node. A sequence may be in any order. Any other iterable is read during the run,
            `LOOK_AHEAD` commands ahead, and not kept.
        sinks: receive the events of the run.
        progress: called repeatedly with the fraction done.
        facts: additional facts for logs, such as the source of the commands.

    Raises:
        TypeError: an argument has the wrong type.
        SceneError: the file has no valid scene, or the scene has no duration.
        LogError: a log cannot be written.
        ConvergenceError: a step could not be solved; the log is complete up to there, with the warnings and the error.
        KeyboardInterrupt: Ctrl-C; the log is complete up to there, with the warnings.
        ValueError: `commands` is not a sequence, and a command came after the run had passed its stamp.
    """
    started = time.perf_counter()
    scene = opened(scene)
    if not (progress is None or callable(progress)):
        raise TypeError(f"progress is {shown(progress)}, expected a function of the fraction done, or None")
    run = Simulation(scene if sinks else without_outputs(scene), sinks, facts)
    if run.end_ns is None:
        raise SceneError(
            f"{scene.source}: duration: found nothing, expected the length of the run (s); add duration to the scene, "
            "or give --duration"
        )
    rejected = list[str]()

    def concluded(end: Sample, error: ConvergenceError | None = None) -> list[str]:
        """Return the remarks on the run so far; its sinks receive all warnings, and the error that ended it."""
        nonlocal rejected
        rejected += (
            f"{late.topic} at simulation time {late.time_ns / NANOSECONDS:.9f} s: {late.reason}"
            for late in run.taken_back
        )
        remarks = [*run.remarks, *command_remarks(_first_stamps(commands), scene, end)]
        if sinks:
            ended = [] if error is None else [f"the run ended by an error: {error}"]
            run.tell([*scene_remarks(scene), *remarks, *rejected_words(rejected), *ended])
        return remarks

    # Without a sink there is nothing that Ctrl-C could damage.
    with interrupts_wait() if sinks else contextlib.nullcontext():
        run.start()
        try:
            part = 0
            # Advancing in pieces changes no bits, see `Arc`.
            for known_ns in post_ahead(run, commands, rejected):
                while progress is not None and part < 100 and run.end_ns * (part + 1) // 100 <= known_ns:
                    part += 1
                    run.advance(run.end_ns * part // 100)
                    progress(part / 100.0)
                run.advance(known_ns)
        except (ConvergenceError, KeyboardInterrupt) as error:
            with uninterrupted():
                concluded(run.sample, error if isinstance(error, ConvergenceError) else None)
            raise
        else:
            end = run.sample
            remarks = concluded(end)
        finally:
            with uninterrupted():
                run.finish()
    wall_time_s = time.perf_counter() - started
    return Run(end, run.methods, run.steps, wall_time_s, tuple(rejected), run.clipped_on, tuple(remarks))


def _first_stamps(commands: object) -> list[tuple[str, int]]:
    """Return topic and stamp (ns) of the first commands that `simulate` is given; none of an iterator."""
    if hasattr(commands, "batches"):
        recorded = cast("Batches", commands)
        return [*recorded.first_stamps, *((topic, each.stamp_ns) for topic, each in recorded.setpoints)]
    if not isinstance(commands, Sequence):
        return []
    found: list[tuple[str, int]] = []
    for topic, each in commands[:_FIRST]:
        stamps_ns = (
            cast("npt.NDArray[np.int64]", each.stamp_ns)[:_FIRST].tolist()
            if isinstance(each, Wrenches)
            else [each.stamp_ns]
        )
        found += ((topic, int(stamp_ns)) for stamp_ns in stamps_ns)
    return found
