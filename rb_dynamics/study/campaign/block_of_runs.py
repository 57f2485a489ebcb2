"""Run a block of runs and return their rows.

A row depends only on the campaign and the number of the run: if a run cannot be solved, it is repeated alone, and the
others without it. Must not write files or depend on other blocks.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NamedTuple

from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.numerics.nanoseconds import sample_ns
from rb_dynamics.run.plan import check_method
from rb_dynamics.run.sample import too_long
from rb_dynamics.run.sample_arrays import Samples
from rb_dynamics.scene.model import Scene
from rb_dynamics.study.campaign.block_propagation import (
    Alone,
    Bodies,
    Commands,
    InTurn,
    New,
    SideBySide,
    go_side_by_side,
    step_ns,
    turn_of,
)
from rb_dynamics.study.campaign.control import ControlLoop, check_values, delay_ns
from rb_dynamics.study.campaign.control_inputs import OnboardValues
from rb_dynamics.study.campaign.metrics import MetricAccumulator
from rb_dynamics.study.campaign.model import Campaign
from rb_dynamics.study.campaign.sampling import inputs
from rb_dynamics.study.campaign.scenes import scenes_of
from rb_dynamics.study.campaign.user_functions import FunctionError
from rb_dynamics.study.campaign.wheel_bodies import NotTogetherError, WithWheels, alike

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers
    from rb_dynamics.run.sink import Sink

Columns = dict[str, Any]
"""Rows of a block, by column name: arrays (n,), and a list of texts for `error`."""


class _Run(NamedTuple):
    number: int
    values: Mapping[str, float]
    scene: Scene


def simulate_block(
    campaign: Campaign,
    first: int,
    last: int,
    threads: int | None = None,
    tell: Callable[[float], None] | None = None,
) -> Columns:
    """Return the rows of the runs from `first` up to, not including, `last`.

    `tell` is called at observations with the number of runs done, of those under way the part.

    Raises:
        SceneError: a user function cannot be loaded, or lacks what it needs on this machine; or the method does not
            support the base scene.
    """
    import numpy as np

    names, scenes = [each.name for each in campaign.inputs], scenes_of(campaign)
    check_method(scenes.base)
    table = inputs(campaign, first, last)
    errors: dict[int, str] = {}
    runs = []
    for number, row in zip(range(first, last), table.tolist(), strict=True):
        values = dict(zip(names, row, strict=True))
        try:
            check_values(values)
            scene = scenes.scene(values, number)
            # A lag or a ramp may be dispersed, and a method may only do without.
            check_method(scene)
            runs.append(_Run(number, values, scene))
        except SceneError as error:
            errors[number] = str(error)
    metrics = {metric.name: np.full(last - first, math.nan) for metric in campaign.metrics}
    done = 0
    for group in _groups(campaign, runs):

        def watch(samples: Samples, group: list[_Run] = group, done: int = done) -> None:
            if tell is not None:
                tell(done + len(group) * float(samples.time_ns) / (group[0].scene.end_ns or 1))

        for part, found, failed in _fly(campaign, group, threads, watch):
            errors |= {part[place].number: why for place, why in failed.items()}
            flown = [place for place in range(len(part)) if place not in failed]
            places = [part[place].number - first for place in flown]
            for name, column in found.items():
                metrics[name][places] = column[flown]
        done += len(group)
    return {
        "run": np.arange(first, last, dtype=np.int64),
        "seed": np.full(last - first, campaign.seed, dtype=np.int64),
        **{name: table[:, k] for k, name in enumerate(names)},
        **metrics,
        "passed": _passed(campaign, metrics, errors, first),
        "error": [errors.get(number, "") for number in range(first, last)],
    }


def simulate_alone(
    campaign: Campaign,
    number: int,
    sinks: Sequence[Sink] = (),
    watch: Callable[[Samples], None] | None = None,
    warnings: Sequence[str] = (),
) -> dict[str, float]:
    """Execute one run, with its outputs and `warnings` known before to `sinks`; return its metrics by name.

    Raises:
        SceneError: the scene is not valid with its inputs.
        ConvergenceError: a step cannot be solved.
        FunctionError: a user function raised, or the law returned no finite command.
        LogError: a log cannot be written.
    """
    values = values_of(campaign, number)
    check_values(values)
    # A log, and the page made from it, names the scene by its source.
    name = f"{campaign.source}, run {number}, seed {campaign.seed}"
    run = _Run(number, values, replace(scenes_of(campaign).whole(values, number), source=name))
    bodies, metrics = Alone(run.scene, sinks, campaign.control is not None), MetricAccumulator(campaign, 1)
    try:
        failed = _advance(campaign, bodies, [run], metrics, watch)
        bodies.tell(warnings)
    finally:
        bodies.finish()
    if failed:
        raise FunctionError(failed[0])
    return {name: float(column[0]) for name, column in metrics.results().items()}


def watch_runs(campaign: Campaign, numbers: Sequence[int], watch: Callable[[Samples], None]) -> None:
    """Execute these runs side by side; `watch` is called with all of them at each observation.

    Raises:
        ValueError: they cannot run side by side.
        SceneError: the scene is not valid with the inputs of one.
        ConvergenceError: a step of one of them cannot be solved.
        FunctionError: a user function raised.
    """
    runs = []
    for number in numbers:
        values = values_of(campaign, number)
        runs.append(_Run(number, values, scenes_of(campaign).scene(values, number)))
    scenes, metrics = [run.scene for run in runs], MetricAccumulator(campaign, len(runs))
    apart = ValueError("these runs cannot go side by side; execute each of them alone")
    if _together(campaign, runs):
        _advance(campaign, SideBySide(scenes, None), runs, metrics, watch)
        return
    shared = {alike(scene, campaign.control) for scene in scenes}
    if len(shared) > 1 or None in shared:
        raise apart
    try:
        bodies = WithWheels(scenes, campaign.control is not None)
        _advance(campaign, bodies, runs, metrics, watch)
        bodies.require_all()
    except NotTogetherError as error:
        raise apart from error
    if bodies.apart.any():
        raise apart


def values_of(campaign: Campaign, number: int) -> dict[str, float]:
    """Return the inputs of one run by name."""
    row = inputs(campaign, number, number + 1)[0].tolist()
    return {each.name: value for each, value in zip(campaign.inputs, row, strict=True)}


def _passed(
    campaign: Campaign, metrics: Mapping[str, Numbers], errors: Mapping[int, str], first: int
) -> npt.NDArray[np.bool_]:
    """Return which runs were completed and meet every requirement; NaN meets none, unless `allows_never`."""
    import numpy as np

    count = len(next(iter(metrics.values())))
    good = np.array([number not in errors for number in range(first, first + count)], dtype=np.bool_)
    by_name = {metric.name: metric for metric in campaign.metrics}
    for each in campaign.requirements:
        values = metrics[each.metric]
        within = (values < each.below) & (values > each.above)
        good &= within | np.isnan(values) if each.allows_never(by_name[each.metric]) else within
    return good


def _groups(campaign: Campaign, runs: list[_Run]) -> list[list[_Run]]:
    """Return groups of runs that can go side by side or in turn; each of the others is a group of its own."""
    together = [run for run in runs if _on_grid(campaign, run)]
    if together and _together(campaign, together):
        return [together, *([run] for run in runs if not _on_grid(campaign, run))]
    found: dict[object, list[_Run]] = {}
    shared: dict[int, object] = {}
    for run in runs:
        # Scenes with the very actuators of the base scene differ from it in numbers of body and initial state alone.
        same = id(run.scene.actuators or run)
        if same not in shared:
            shared[same] = _shared(campaign, run)
        found.setdefault(shared[same] or run.number, []).append(run)
    return list(found.values())


def _shared(campaign: Campaign, run: _Run) -> object:
    """Return what runs share that are executed together; None for one that is executed alone."""
    return alike(run.scene, campaign.control) or turn_of(run.scene, campaign.control is not None)


def _together(campaign: Campaign, runs: Sequence[_Run]) -> bool:
    """Return whether these runs can go side by side."""
    is_driven = campaign.control is not None
    return go_side_by_side([run.scene for run in runs], is_driven) and all(_on_grid(campaign, run) for run in runs)


def _on_grid(campaign: Campaign, run: _Run) -> bool:
    """Return whether the commands of a run coincide with steps: in a block, no body can restart its step on its own."""
    step = step_ns(run.scene)
    return campaign.control is None or step is None or delay_ns(campaign.control, run.values) % step == 0


_Part = tuple[list[_Run], Mapping[str, "Numbers"], Mapping[int, str]]
"""Runs, their metrics, and why some of them failed, by index."""


def _fly(
    campaign: Campaign, runs: list[_Run], threads: int | None, watch: Callable[[Samples], None] | None = None
) -> list[_Part]:
    """Execute `runs`; if one of them stops all, split them, and go on without `watch`."""
    if alike(runs[0].scene, campaign.control):
        return _fly_with_wheels(campaign, runs, threads, watch)
    metrics = MetricAccumulator(campaign, len(runs))
    try:
        failed = _advance(campaign, _bodies(campaign, runs, threads), runs, metrics, watch)
    except (ConvergenceError, FunctionError) as error:
        if len(runs) == 1:
            return [(runs, {}, {0: str(error).removeprefix("body 0: ")})]
        half = len(runs) // 2
        return _fly(campaign, runs[:half], threads) + _fly(campaign, runs[half:], threads)
    return [(runs, metrics.results(), failed)]


def _fly_with_wheels(
    campaign: Campaign,
    runs: list[_Run],
    threads: int | None,
    watch: Callable[[Samples], None] | None = None,
    *,
    forces: bool = False,
) -> list[_Part]:
    """Execute runs with wheels side by side, and those alone that cannot be executed so; `forces`: see `WithWheels`."""
    metrics, bodies = MetricAccumulator(campaign, len(runs)), None
    try:
        bodies = WithWheels([run.scene for run in runs], campaign.control is not None, threads, forces=forces)
        failed = _advance(campaign, bodies, runs, metrics, watch)
        bodies.require_all()
    except (NotTogetherError, FunctionError, ConvergenceError) as error:
        if bodies is not None and bodies.may_feel:
            return _fly_with_wheels(campaign, runs, threads, watch, forces=True)
        if len(runs) > 1 and isinstance(error, FunctionError) and bodies is not None and not bodies.lacking:
            half = len(runs) // 2
            parts = runs[:half], runs[half:]
            return [each for part in parts for each in _fly_with_wheels(campaign, part, threads, forces=forces)]
        return [_fly_alone(campaign, run) for run in runs]
    apart = bodies.apart
    places = {place: k for k, place in enumerate((~apart).nonzero()[0].tolist())}
    together = [runs[place] for place in places]
    found = {name: column[~apart] for name, column in metrics.results().items()}
    alone = [_fly_alone(campaign, runs[place]) for place in apart.nonzero()[0].tolist()]
    return [(together, found, {places[at]: why for at, why in failed.items() if at in places}), *alone]


def _fly_alone(campaign: Campaign, run: _Run) -> _Part:
    metrics = MetricAccumulator(campaign, 1)
    try:
        failed = _advance(campaign, Alone(run.scene, driven=campaign.control is not None), [run], metrics)
    except (ConvergenceError, FunctionError) as error:
        return [run], {}, {0: str(error)}
    return [run], metrics.results(), failed


def _bodies(campaign: Campaign, runs: Sequence[_Run], threads: int | None) -> Bodies:
    scenes, driven = [run.scene for run in runs], campaign.control is not None
    if _together(campaign, runs):
        return SideBySide(scenes, threads)
    if turn_of(scenes[0], driven):
        return InTurn(scenes, campaign.observe_ns)
    return Alone(scenes[0], driven=driven)


def _advance(
    campaign: Campaign,
    bodies: Bodies | WithWheels,
    runs: Sequence[_Run],
    metrics: MetricAccumulator,
    watch: Callable[[Samples], None] | None = None,
) -> Mapping[int, str]:
    """Advance the bodies from edge to edge (controller sample, command, observation) to the end of their scene.

    Return why some failed, by index; ends early if all did.
    """
    scene = runs[0].scene
    end_ns = scene.end_ns or 0
    loop = _closed(campaign, runs, bodies)
    looks = sampled = next_look_ns = next_sample_ns = 0
    ruined: Mapping[int, str] = {}
    while True:
        sampling = loop is not None and next_sample_ns < end_ns
        time_ns = min(next_look_ns, end_ns)
        if loop is not None:
            time_ns = min(time_ns, loop.next_command_ns(end_ns), next_sample_ns if sampling else end_ns)
        bodies.advance_to(time_ns)
        if len(bodies.failed) == len(runs):
            return bodies.failed
        looking, sampling = time_ns in (next_look_ns, end_ns), sampling and time_ns == next_sample_ns
        if looking or sampling:
            samples = bodies.samples()
            if looking:
                metrics.add(samples, is_last=time_ns >= end_ns)
                if watch is not None:
                    watch(samples)
                looks += 1
                next_look_ns = sample_ns(looks, campaign.observe_ns)
            if sampling and loop is not None:
                loop.sample(time_ns, samples, bodies.onboard())
                sampled += 1
                next_sample_ns = sample_ns(sampled, loop.period_ns)
            ruined = _ruined(runs, samples) if time_ns >= end_ns else {}
            # Of samples that nobody has any more, nothing need be computed.
            del samples
        if time_ns >= end_ns or (loop is not None and len(loop.failed) == len(runs)):
            return {**ruined, **(bodies.failed if loop is None else loop.end())}
        if loop is not None and not isinstance(bodies, WithWheels) and (held := loop.commanded(time_ns)) is not None:
            bodies.hold(*held)


def _ruined(runs: Sequence[_Run], samples: Samples) -> Mapping[int, str]:
    """Return which motions fixed steps are too long for, at the end, and why, by index."""
    if all(run.scene.solver.step is None for run in runs):
        return {}
    energies = (samples.kinetic_energy.tolist(), samples.work.tolist(), samples.energy_defect.tolist())
    found = enumerate(zip(runs, *energies, strict=True))
    each = {place: too_long(run.scene.solver.step, run.scene.body, *numbers) for place, (run, *numbers) in found}
    return {place: why for place, why in each.items() if why}


class _Closed:
    """Controllers, and the commands that wait for their delay."""

    def __init__(
        self, loop: ControlLoop, period_ns: Fraction, delays_ns: Sequence[int], bodies: WithWheels | None
    ) -> None:
        """Control `bodies`; those without wheels are told of each command at its time."""
        import numpy as np

        self.period_ns, self.failed = period_ns, loop.failed
        self._loop, self._bodies, self._delays_ns = loop, bodies, np.array(delays_ns)
        self._groups = [(delay, np.array(delays_ns) == delay) for delay in sorted(set(delays_ns))]
        self._waiting: list[tuple[int, int, int]] = []
        self._commands: dict[int, Commands] = {}
        self._held: dict[str, Numbers] = {}
        self._count = 0

    def end(self) -> Mapping[int, str]:
        """Return why runs failed, by index."""
        self._loop.end()
        return self.failed

    def sample(self, time_ns: int, samples: Samples, onboard: OnboardValues) -> None:
        """Evaluate the law; its commands wait for the delay."""
        commands = self._loop.commands(samples, onboard)
        if not commands:
            return
        if self._bodies is not None:
            self._bodies.hold(commands, time_ns + self._delays_ns)
            return
        self._commands[self._count] = commands
        for group, (delay, _) in enumerate(self._groups):
            heapq.heappush(self._waiting, (time_ns + delay, self._count, group))
        self._count += 1

    def next_command_ns(self, end_ns: int) -> int:
        """Return when the next command takes effect, `end_ns` if none waits."""
        return self._waiting[0][0] if self._waiting else end_ns

    def commanded(self, time_ns: int) -> tuple[Commands, New] | None:
        """Return all commands that hold from now on, and which of them are new, for which runs; None if none is."""
        import numpy as np

        new: dict[str, npt.NDArray[np.bool_]] = {}
        while self._waiting and self._waiting[0][0] == time_ns:
            _, number, group = heapq.heappop(self._waiting)
            of_group = self._groups[group][1]
            for name, values in self._commands[number].items():
                if of_group.all():
                    self._held[name] = values
                else:
                    to = of_group.reshape(-1, *[1] * (values.ndim - 1))
                    self._held[name] = np.where(to, values, self._held.get(name, 0.0))
                new[name] = new.get(name, False) | of_group
            if group == len(self._groups) - 1:
                # The longest delay has passed.
                del self._commands[number]
        return (self._held, new) if new else None


def _closed(campaign: Campaign, runs: Sequence[_Run], bodies: Bodies | WithWheels) -> _Closed | None:
    import numpy as np

    control = campaign.control
    if control is None:
        return None
    values = {each.name: np.array([run.values[each.name] for run in runs]) for each in campaign.inputs}
    loop = ControlLoop(campaign, control, [run.number for run in runs], values, [run.scene.body for run in runs])
    delays_ns = [delay_ns(control, run.values) for run in runs]
    return _Closed(loop, control.period_ns, delays_ns, bodies if isinstance(bodies, WithWheels) else None)
