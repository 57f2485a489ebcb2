"""`explain`: what a scene models and leaves out, which solver runs it, what that costs and how wrong it is.

The decisions are those of `scene/plan.py` and the loads. Cost and error are measured by running the scene itself
for a bounded time, and once more by another method.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

from rb_dynamics.body.plausibility import Symmetry, symmetry
from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.effect_types import EFFECTS
from rb_dynamics.loads.load import Takes
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.caching import clear_caches
from rb_dynamics.motion.exact import EXACT
from rb_dynamics.motion.fixed_step_kernel import Tally, counted_by
from rb_dynamics.numerics.argument_checks import items, number
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import angle_between
from rb_dynamics.numerics.vector import norm, scale, subtract
from rb_dynamics.run.simulation import Simulation, as_command, post_all, without_outputs
from rb_dynamics.scene import opened
from rb_dynamics.scene.model import DEFAULT_ACCURACY, Scene, Solver
from rb_dynamics.scene.plan import OPEN_END_HORIZON
from rb_dynamics.study.stopwatch import Stopwatch

_EPSILON = 2.0**-52

# The trial is over long before.
_PROBES = 1000

# A short trial (s) is timed this often, and the best counts; one that was ended for its time, once more.
_SHORT, _REPEATS = 0.05, 3

# Fewer steps are no measure: the first ones are shorter, and look up more.
_LEAST_STEPS = 16

# A trial begins with so small a part of the run, as a power of 1/2: what a second of it costs is not known.
_SMALLEST_PART = 32

# To have something to compare with nobody waits for a kernel to be compiled.
_LOADING_ALONE = 1e300

# What is run before the stopwatch, to import and tabulate what a run needs.
_WARM_UP_NS = 1000

NOT_MODELLED = (
    "contact, collision, friction",
    "joints, several bodies that act on each other",
    "flexible parts, slosh, cables",
    "mass that leaves: propellant, staging",
    "atmosphere models, aerodynamic tables, solar pressure, magnetic field",
    "harmonics, third bodies, ephemerides",
    "a moving or rotating world frame",
    "sensors, cameras",
    "actuators",
    "relativity, radiation of momentum",
)
"""What no scene can say, as docs/limits.md has it, which says what to take instead."""

_FREE_ROTATION = {
    Symmetry.SPHERE: "uniform rotation, as the three moments are equal",
    Symmetry.OBLATE: "trigonometric functions, as two moments are equal",
    Symmetry.PROLATE: "trigonometric functions, as two moments are equal",
    Symmetry.TRIAXIAL: "Jacobi's elliptic functions",
}


@dataclass(frozen=True)
class Explanation:
    """What there is to say about a scene before it is run.

    Attributes:
        modelled: each thing that is modelled, and how.
        left_out: each thing that is not, and why: of what this scene could say, and behind it what no scene can.
        solver: what runs it, with its setting.
        methods: names of the methods that moved the body in the trial.
        trial_s: simulated seconds of the trial with all outputs, on which steps and cost stand.
        steps_per_s: steps for each simulated second.
        cost_per_s: seconds of computing for each simulated second of a whole run with all its outputs, on this machine;
            writing them, and compiling and loading kernels, comes on top.
        bare_cost_per_s: the same without outputs: where nobody is told, only the end is computed.
        compiled: whether kernels have a part in it.
        attitude_error: after `error_s`, rad; against a run by another method, or the bound of the closed form; None
            where nothing tells it.
        position_error: likewise, m.
        error_s: simulated seconds after which the errors are those, s; less than `whole_s` where there was no time to
            get to the end.
        whole_s: length of the scene, s.
        error_basis: what the errors were found by.
        remarks: what else a user should know.
    """

    modelled: tuple[str, ...]
    left_out: tuple[str, ...]
    solver: str
    methods: str
    trial_s: float
    steps_per_s: float
    cost_per_s: float
    bare_cost_per_s: float
    compiled: bool
    attitude_error: float | None
    position_error: float | None
    error_s: float
    whole_s: float
    error_basis: str
    remarks: tuple[str, ...]

    def as_dict(self) -> dict[str, object]:
        """Return the fields by name."""
        return asdict(self)

    def as_text(self) -> str:
        """Return it for a person."""
        whole = f"after all {self.whole_s:g} s"
        when = whole if self.error_s == self.whole_s else f"after {self.error_s:g} s of {self.whole_s:g} s only"
        attitude, position = (
            "not known" if error is None else f"{error:.2g} {unit} {when}"
            for error, unit in ((self.attitude_error, "rad"), (self.position_error, "m"))
        )
        lines = [
            "modelled",
            *(f"  {item}" for item in self.modelled),
            "left out",
            *(f"  {item}" for item in self.left_out),
            "solver",
            f"  {self.solver}",
            f"cost, measured over {self.trial_s:g} s of this scene, and error",
            f"  moved by            {self.methods}{', compiled' if self.compiled else ''}",
            f"  steps               {self.steps_per_s:.4g} per simulated s",
            f"  computing           {_speed(self.bare_cost_per_s)}: for its end alone, as simulate without a log",
            f"  with all outputs    {_speed(self.cost_per_s)}: as with a log, to which its writing comes",
            f"  attitude error      {attitude}",
            f"  position error      {position}",
            f"  ({self.error_basis})",
            *(f"note: {remark}" for remark in self.remarks),
        ]
        return "\n".join(lines)


def _speed(cost: float) -> str:
    """Return a cost (s per s) for a person."""
    return f"{cost:.2g} s per simulated s, {1.0 / cost if cost > 0.0 else math.inf:.2g} x real time"


def explain(
    scene: Scene | str | os.PathLike[str], commands: Sequence[tuple[str, Wrench]] = (), budget: float = 2.0
) -> Explanation:
    """Return what `scene` models, leaves out and costs.

    Args:
        scene: is not changed; or its file.
        commands: wrench commands of the scene's channels; without any, a channel is tried with a probe if no
            effect acts.
        budget: about how long the trial may compute, s, and as long again a run by another method, which tells the
            error; a trial that it ends is run once more, as the machine may be busy.

    Raises:
        TypeError: an argument is not of its type.
        ValueError: the budget is not greater than 0.
        SceneError: the file says no valid scene, the solver makes no sense for it, or there is no motion to measure.
        ConvergenceError: the scene cannot be run as it asks to be.
    """
    scene = opened(scene)
    commands = list(map(as_command, items(commands, "commands", "(topic, wrench) pairs")))
    number(budget, "budget", "a finite number greater than 0 (s)", above=0.0)
    length = measured_length(scene)
    commands, remarks = probed(scene, commands, length)
    if rejected := post_all(Simulation(scene), commands):
        remarks.append(f"{len(rejected)} of {len(commands)} wrench commands were rejected; the first: {rejected[0]}")
    if scene.duration is None and scene.output_rate > 0.0:
        # What has no end of its own is looked at where the trial ends.
        scene = replace(scene, output_rate=max(scene.output_rate, 1.0 / length))
    stopwatch = Stopwatch()
    bare, bare_cost, bare_tally = _measured(scene, commands, length, 0.5 * budget, stopwatch, with_outputs=False)
    run, cost, tally = _measured(scene, commands, length, budget, stopwatch)
    reached = run.time_ns / NANOSECONDS
    if reached < length:
        remarks.append(f"cost: measured over the first {reached:g} s of {length:g} s, for which the trial had time")
    is_compiled = bool(tally.used)
    # No output changes the motion: without them there is more often time for all of it.
    with counted_by(bare_tally):
        attitude, position, error_s, basis = _errors(without_outputs(scene), commands, bare, length, budget, stopwatch)
    if stopwatch.kernels:
        remarks.append(
            f"kernels compiled or loaded: {len(stopwatch.kernels)}, in {math.fsum(stopwatch.kernels.values()):.2g} s, "
            "which the cost does not hold"
        )
    return Explanation(
        _modelled(scene),
        _left_out(scene),
        run.plan.description,
        run.methods,
        reached,
        run.steps / reached,
        cost,
        bare_cost,
        is_compiled,
        attitude,
        position,
        error_s,
        length,
        basis,
        tuple(remarks),
    )


def measured_length(scene: Scene) -> float:
    """Return how long (s) a run of `scene` is taken to be.

    Raises:
        SceneError: it is over at once.
    """
    if scene.duration is None:
        return OPEN_END_HORIZON
    if scene.end_ns == 0:
        raise SceneError(
            f"{scene.source}: duration: found {scene.duration:g}, expected a motion to measure; give a longer one"
        )
    return scene.duration


def _modelled(scene: Scene) -> tuple[str, ...]:
    body = scene.body
    kind = symmetry(body)
    if body.is_particle:
        items = ["body: a particle, three degrees of freedom"]
    else:
        items = [f"body: rigid ({kind.value}), six degrees of freedom"]
        if scene.combined_effects.takes == Takes.HELD and scene.solver.method in ("auto", EXACT.name):
            items.append(f"rotation without torque: in closed form, {_FREE_ROTATION[kind]}")
            items.append("rotation about one principal axis: one angle, in closed form")
    items += [f"wrench channel {channel.topic}: held until its next command" for channel in scene.channels]
    held = {effect.kind for effect in scene.effects if effect.takes == Takes.HELD}
    items += [
        f"effect {effect.kind}: "
        + ("held like a wrench" if effect.kind in held else "evaluated inside every step")
        + (", with its potential energy" if effect.potential(body) is not None else "")
        for effect in scene.effects
    ]
    return tuple(items)


def _left_out(scene: Scene) -> tuple[str, ...]:
    body = scene.body
    items = []
    if body.is_particle:
        items.append("attitude and rotation: the body has no inertia")
    if not scene.channels:
        items.append("wrench commands: the scene has no channels")
    listed = {effect.kind for effect in scene.effects}
    absent = [kind for kind in EFFECTS.own if kind not in listed]
    if absent:
        items.append(f"{', '.join(absent)}: not listed in effects")
    return (*items, *(f"{thing}: in no scene" for thing in NOT_MODELLED))


def probed(
    scene: Scene, commands: Sequence[tuple[str, Wrench]], length: float
) -> tuple[Sequence[tuple[str, Wrench]], list[str]]:
    """Return `commands` to try `scene` with for `length` s, and remarks about them.

    Where there are none, the scene has a channel for them, and nothing else acts, they are a probe: a force of the
    body's weight and a torque that turns it at about 1 rad/s after 1 s, reversed every second, for a thousand seconds.
    """
    if commands or scene.effects or not scene.channels:
        return commands, []
    remark = (
        "the channels were tried with a probe: a force of the body's weight and a torque that turns it at about "
        "1 rad/s after 1 s, reversed every second; with --wrench BAG the commands of a bag are tried instead"
    )
    return _probe(scene, length), [remark]


def _probe(scene: Scene, length: float) -> list[tuple[str, Wrench]]:
    topic, body = scene.channels[0].topic, scene.body
    moment, weight = max(body.principal_moments), 9.80665 * body.mass
    commands = []
    for k in range(min(math.ceil(length), _PROBES)):
        size = (0.5 if k == 0 else 1.0) * (-1.0) ** k
        force, torque = scale(size * weight, (0.6, 0.0, 0.8)), scale(size * moment, (0.36, 0.48, 0.8))
        commands.append((topic, Wrench(force, torque, stamp_ns=k * NANOSECONDS)))
    return commands


def _measured(
    scene: Scene,
    commands: Sequence[tuple[str, Wrench]],
    length: float,
    budget: float,
    stopwatch: Stopwatch,
    with_outputs: bool = True,
) -> tuple[Simulation, float, Tally]:
    """Return a run that has gone on for as long as the budget lasted, its cost (s per s), and what decided on kernels.

    It goes as a run of `length` s would, which is longer: what is not worth a kernel here may be there.
    """
    scene = scene if with_outputs else without_outputs(scene)
    with counted_by(stopwatch.tally(worth=math.inf)):
        _start(scene, commands).advance(_WARM_UP_NS)
    tally = stopwatch.tally()
    with counted_by(tally):
        run, reached, wall = _timed(scene, commands, length, budget, stopwatch, with_outputs)
    again = _REPEATS - 1 if wall < _SHORT else int(reached < length)
    if reached < length and tally.asked:
        # A longer run has what is not worth it here: what was timed is not a part of it.
        tally, wall, again = stopwatch.tally(length / reached), math.inf, again + 1
    with counted_by(tally):
        for _ in range(again):
            wall = min(wall, _timed(scene, commands, reached, math.inf, stopwatch, with_outputs)[2])
    return run, wall / reached, tally


def _timed(
    scene: Scene,
    commands: Sequence[tuple[str, Wrench]],
    length: float,
    budget: float,
    stopwatch: Stopwatch,
    with_outputs: bool,
) -> tuple[Simulation, float, float]:
    """Return a run that has gone on for as long as the budget lasted, how far (s), and how long that took.

    It has taken some steps, if the time was enough for them, and with outputs, it has reached one.
    """
    end = round(length * NANOSECONDS)
    # No trial may find there what another one has computed.
    clear_caches()
    begin = stopwatch()
    run = _start(scene, commands)
    least = run.next_output_ns() if with_outputs else 0
    part = max(1, end >> _SMALLEST_PART)
    while True:
        run.advance(min(part, end))
        wall = stopwatch() - begin
        # In closed form there may be a million outputs, and no second step.
        enough = run.steps >= _LEAST_STEPS or wall > budget
        if part >= end or (wall > 0.5 * budget and part >= least and enough):
            return run, min(part, end) / NANOSECONDS, wall
        # So that the last part takes no more than the budget, and few are enough for a short run.
        part *= 2 if 32.0 * wall > budget else 16


def _start(scene: Scene, commands: Sequence[tuple[str, Wrench]]) -> Simulation:
    run = Simulation(scene)
    post_all(run, commands)
    run.start()
    return run


def _errors(
    scene: Scene,
    commands: Sequence[tuple[str, Wrench]],
    run: Simulation,
    length: float,
    budget: float,
    stopwatch: Stopwatch,
) -> tuple[float | None, float | None, float, str]:
    """Return the errors of attitude and position, after how long (s) they are those, and what they were found by.

    That is `length`, or as far as a run with another method gets in the budget; `run`, a part of the same, goes on to
    there. Steps that are shorter would be no proof: where commands bound them, they are the same.
    """
    end = run.look()
    if run.moving == (EXACT.name,):
        return (
            *_closed_form_bounds(scene, run, length),
            end.time_ns / NANOSECONDS,
            "bounds of the closed form: round-off",
        )
    finest = min(scene.solver.accuracy or DEFAULT_ACCURACY, DEFAULT_ACCURACY)
    for name, accuracy in _others(scene, run.moving, finest):
        solver = Solver(name, accuracy=accuracy)
        try:
            with counted_by(stopwatch.tally(worth=_LOADING_ALONE)):
                check = _timed(replace(scene, solver=solver), commands, length, budget, stopwatch, False)[0]
            truth = check.look()
            if run.look().time_ns > truth.time_ns:
                run = _start(scene, commands)
            run.advance(truth.time_ns)
            end, course = run.look(), run.course()
        except ConvergenceError:
            continue
        if end.time_ns != truth.time_ns:
            continue
        # Not less than what the numbers can tell, or one that is as rough as what it is compared with.
        far = norm(end.position_world) + course.travelled
        trust = 0.0 if accuracy <= finest else accuracy
        floors = 4.0 * _EPSILON * (1.0 + course.turned), 4.0 * _EPSILON * far
        attitude = angle_between(end.orientation_xyzw, truth.orientation_xyzw)
        position = norm(subtract(end.position_world, truth.position_world))
        return (
            max(attitude, trust, floors[0]),
            max(position, trust * course.travelled, floors[1]),
            end.time_ns / NANOSECONDS,
            f"difference from a run by {name} with accuracy {accuracy:.3g}",
        )
    return None, None, length, "no other method could run it, so that there was nothing to compare with"


def _closed_form_bounds(scene: Scene, run: Simulation, length: float) -> tuple[float, float]:
    """Return what rounding may have come to: each arc rounds its turn, and what the next one starts with."""
    start, end, course = scene.initial, run.look(), run.course()
    attitude = _EPSILON * (100.0 * (course.arcs + course.turned) + 4.0 * course.rates * length)
    far = norm(start.position_world) + norm(end.position_world) + course.travelled + course.speeds * length
    return attitude, 4.0 * _EPSILON * far + norm(scene.body.center_of_mass) * attitude


# What runs are compared with: methods of different families, in the order in which they are taken.
_FAMILIES = ("taylor", "dop853", "dlm6", "rkmk54", "radau")


def _others(scene: Scene, used: Sequence[str], accuracy: float) -> list[tuple[str, float]]:
    """Return what to compare a run by the methods `used` with: another one, finer than `accuracy`, or as it may be."""
    able = [name for name in _FAMILIES if name not in used and METHODS[name].takes >= scene.combined_effects.takes]
    return [(name, factor * accuracy) for factor in (0.01, 0.1, 1.0, 1e2, 1e4) for name in able[:2]]
