"""`explain`: what a scene models and leaves out, which solver runs it, its cost and its error.

The decisions are those of `run/plan.py` and the loads. Cost and error are measured by running the scene for a limited
time, and once more by another method.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace

from rb_dynamics.body.plausibility import Symmetry, symmetry
from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.actuator_types import ACTUATORS
from rb_dynamics.loads.effect_types import EFFECTS
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.closed_form import EXACT
from rb_dynamics.motion.fixed_step_kernel import OnDemand, Tally, counted_by
from rb_dynamics.motion.result_cache import clear_caches
from rb_dynamics.numerics.argument_checks import items, number
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import angle_between
from rb_dynamics.numerics.vector import norm, scale, subtract
from rb_dynamics.run.plan import OPEN_END_HORIZON
from rb_dynamics.run.posting import Command, each_command, post_all
from rb_dynamics.run.scene_remarks import command_remarks, scene_remarks
from rb_dynamics.run.simulation import Simulation, without_outputs
from rb_dynamics.scene import opened
from rb_dynamics.scene.model import DEFAULT_ACCURACY, Scene, Solver
from rb_dynamics.sensors.sensor_types import SENSORS
from rb_dynamics.study.stopwatch import Stopwatch

_EPSILON = 2.0**-52

# Largest number of probe commands: the measurement ends long before.
_PROBES = 1000

# A run shorter than this (s) is repeated, and the shortest time counts; a run stopped by the budget is repeated once.
_SHORT, _REPEATS = 0.05, 3

# A cost needs at least this many steps: the first ones are shorter and fill caches.
_LEAST_STEPS = 16

# The first part of a timed run, as a power of 1/2 of it: the cost of a simulated second is not yet known.
_SMALLEST_PART = 32

# Simulated time run before the stopwatch starts, for tables and the first imports.
_WARM_UP_NS = 1000

# Set-up that takes a smaller fraction of a run is not worth a remark.
_LITTLE = 0.1

NOT_MODELLED = (
    "contact, collision, friction",
    "joints, several bodies that act on each other",
    "flexible parts, slosh, cables",
    "changing mass: propellant, staging",
    "magnetic fields other than a uniform one, a fixed dipole and the main field of the Earth (IGRF)",
    "free surfaces, waves, added mass",
    "atmosphere models, aerodynamic tables, solar pressure",
    "gravity harmonics, third bodies, ephemerides",
    "a moving or rotating world frame",
    "cameras, range sensors",
    "imbalance coupled to the turning of its wheel, gimballed wheels",
    "relativity, recoil of emitted radiation",
)
"""What no scene can describe; docs/limits.md names alternatives."""

_EVALUATED = "evaluated inside every step"

_FREE_ROTATION = {
    Symmetry.SPHERE: "uniform rotation, since all three moments are equal",
    Symmetry.OBLATE: "trigonometric functions, since two moments are equal",
    Symmetry.PROLATE: "trigonometric functions, since two moments are equal",
    Symmetry.TRIAXIAL: "Jacobi's elliptic functions",
}


@dataclass(frozen=True)
class Explanation:
    """What is known about a scene before it is run.

    Attributes:
        modelled: each thing that is modelled, and how.
        left_out: each thing that is not, and why: first what this scene could include, then what no scene can.
        solver: the solver with its setting.
        methods: names of the methods that moved the body in the timed run.
        trial_s: simulated seconds of the timed run with all outputs.
        steps_per_s: steps per simulated second.
        cost_per_s: computing time per simulated second of a whole run with all outputs, on this machine; without
            writing a log, and without compiling and loading kernels.
        bare_cost_per_s: the same without outputs, if only the end is needed; either is NaN where the budget allowed
            too few steps to estimate it.
        compiled: whether kernels took the steps.
        attitude_error: after `error_s`, rad; the difference from a run by another method, or the bound of the closed
            form; None if unknown.
        position_error: the same, m.
        error_s: simulated time of the errors, s; less than `whole_s` if there was no time to reach the end.
        whole_s: length of the scene, s.
        error_basis: how the errors were found.
        remarks: anything else a user should know.
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
        """Return the fields by name; None for a cost that is not known."""
        return {name: None if value != value else value for name, value in asdict(self).items()}

    def as_text(self) -> str:
        """Return the explanation as text."""
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
            f"  computing           {_speed(self.bare_cost_per_s)}: only the end, like simulate without a log",
            f"  with all outputs    {_speed(self.cost_per_s)}: like simulate with a log, without writing it",
            f"  attitude error      {attitude}",
            f"  position error      {position}",
            f"  ({self.error_basis})",
            *(f"note: {remark}" for remark in self.remarks),
        ]
        return "\n".join(lines)


def _speed(cost: float) -> str:
    """Return a cost (s per s) as text."""
    if math.isnan(cost):
        return "not known: the time budget was spent before the run had taken a few steps"
    return f"{cost:.2g} s per simulated s, {1.0 / cost if cost > 0.0 else math.inf:.2g} x real time"


def explain(
    scene: Scene | str | os.PathLike[str], commands: Sequence[Command] = (), budget: float = 2.0
) -> Explanation:
    """Return what `scene` models and leaves out, its cost and its error.

    Args:
        scene: or its file; not changed.
        commands: wrench commands of the scene's channels; without any, and if no effect acts, a probe is used.
        budget: approximate computing time of the timed run, s; the comparison run by another method takes as long
            again. A run that the budget stops is repeated once, as the machine may have been busy.

    Raises:
        TypeError: an argument has the wrong type.
        ValueError: the budget is not greater than 0.
        SceneError: the scene is not valid, its solver does not suit it, or there is no motion to measure.
        ConvergenceError: the scene cannot be run with its solver.
    """
    scene = opened(scene)
    commands = [*each_command(items(commands, "commands", "(topic, wrench) pairs"))]
    number(budget, "budget", "a finite number greater than 0 (s)", above=0.0)
    length = measured_length(scene)
    given, (commands, remarks) = commands, probed(scene, commands, length)
    if rejected := post_all(Simulation(scene), commands):
        remarks.append(f"{len(rejected)} of {len(commands)} commands were rejected; the first: {rejected[0]}")
    if scene.duration is None and scene.output_rate > 0.0:
        # An open-ended scene has at least one output, at the end of the timed run.
        scene = replace(scene, output_rate=max(scene.output_rate, 1.0 / length))
    stopwatch = Stopwatch()
    bare, bare_cost, bare_tally = _measured(scene, commands, length, 0.5 * budget, stopwatch, with_outputs=False)
    run, cost, tally = _measured(scene, commands, length, budget, stopwatch)
    if tally.used and not bare_tally.used:
        # So few steps are not worth loading kernels, which neither cost includes.
        alone = bare_cost * length
        bare, bare_cost, bare_tally = _measured(
            scene, commands, length, 0.5 * budget, stopwatch, with_outputs=False, loaded=tally.used
        )
        if bare_tally.used > tally.used or not bare_tally.lacking:
            remarks.append(
                f"a process that computes only this end does so in plain Python, in {1e3 * alone:.2g} ms, as loading "
                "kernels would take longer"
            )
    reached = run.time_ns / NANOSECONDS
    if reached < length:
        remarks.append(
            f"cost: measured over the first {reached:g} s of {length:g} s, as far as the time budget allowed"
        )
    remarks += (
        scene_remarks(scene)
        + run.remarks
        + command_remarks(((topic, command.stamp_ns) for topic, command in given), scene, run.look())
    )
    remarks += fixed_costs(scene, commands, stopwatch, cost * length)
    lacking = bare_tally.lacking | tally.lacking
    is_compiled = bool(tally.used) and not lacking
    if lacking:
        remarks.append(
            f"the cost is {'in part ' if tally.used else ''}that of plain Python, as kernels are not compiled yet; "
            f"with them later runs take less: rb-dynamics compile {' '.join(sorted(lacking))}"
        )
    # Outputs do not change the motion; without them the run covers more in the same time.
    with counted_by(bare_tally):
        attitude, position, error_s, basis = _errors(without_outputs(scene), commands, bare, length, budget, stopwatch)
    if stopwatch.kernels:
        remarks.append(
            f"kernels compiled or loaded: {len(stopwatch.kernels)}, in {math.fsum(stopwatch.kernels.values()):.2g} s, "
            "not included in the cost"
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


def fixed_costs(scene: Scene, commands: Sequence[Command], clock: Callable[[], float], run_s: float) -> list[str]:
    """Return a remark on what a run of `run_s` costs besides its motion; none if that is little."""
    begin = clock()
    run = Simulation(scene)
    post_all(run, commands)
    run.start()
    run.finish()
    took = clock() - begin
    if took < _LITTLE * run_s:
        return []
    return [
        f"the times leave out set-up: {1e3 * took:.2g} ms for a whole run of {1e3 * run_s:.2g} ms, and process start"
    ]


def measured_length(scene: Scene) -> float:
    """Return the length (s) of a run of `scene`; a horizon if it has no duration.

    Raises:
        SceneError: the duration is 0.
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
        if scene.combined_effects.takes == LoadDependence.HELD and scene.solver.method in ("auto", EXACT.name):
            items.append(f"rotation without torque: in closed form, {_FREE_ROTATION[kind]}")
            items.append("rotation about one principal axis: one angle, in closed form")
    items += [f"wrench channel {channel.topic}: held until its next command" for channel in scene.channels]
    shaking = {wheel.name for wheel in scene.wheels if not wheel.is_balanced}
    items += [
        f"actuator {each.name}: {each.kind}{', with imbalance' if each.name in shaking else ''}, commanded on "
        f"{each.topic}"
        for each in scene.actuators
    ]
    items += [
        f"sensor {each.name}: {each.kind} at {each.rate:g} Hz; it does not change the motion" for each in scene.sensors
    ]
    held = {effect.kind for effect in scene.effects if effect.takes == LoadDependence.HELD}
    items += [
        f"effect {effect.kind}: "
        + ("a field" if effect.magnetic_field() else "held like a wrench" if effect.kind in held else _EVALUATED)
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
    for key, kinds, there in (
        ("effects", EFFECTS.own, scene.effects),
        ("actuators", ACTUATORS, scene.actuators),
        ("sensors", SENSORS, scene.sensors),
    ):
        listed = {each.kind for each in there}
        if absent := [kind for kind in kinds if kind not in listed]:
            items.append(f"{', '.join(absent)}: not listed in {key}")
    return (*items, *(f"{thing}: never modelled" for thing in NOT_MODELLED))


def probed(scene: Scene, commands: Sequence[Command], length: float) -> tuple[Sequence[Command], list[str]]:
    """Return `commands`, or a probe if there are none, and remarks about it.

    The probe is used if the scene has channels and no effects: a force of the body's weight and a torque that gives
    about 1 rad/s after 1 s, reversed every second, for at most a thousand seconds, and nothing from then on.
    """
    if commands or scene.effects or not scene.channels:
        return commands, []
    remark = (
        "the channels were tried with a probe: a force of the body's weight and a torque that turns it at about "
        "1 rad/s after 1 s, reversed every second; with --wrench BAG the commands of a bag are tried instead"
    )
    return _probe(scene, length), [remark]


def _probe(scene: Scene, length: float) -> list[Command]:
    topic, body = scene.channels[0].topic, scene.body
    moment, weight = max(body.principal_moments), 9.80665 * body.mass
    commands: list[Command] = []
    for k in range(min(math.ceil(length), _PROBES)):
        size = (0.5 if k == 0 else 1.0) * (-1.0) ** k
        force, torque = scale(size * weight, (0.6, 0.0, 0.8)), scale(size * moment, (0.36, 0.48, 0.8))
        commands.append((topic, Wrench(force, torque, stamp_ns=k * NANOSECONDS)))
    # Held for longer, the last one would spin the body up without end.
    return [*commands, (topic, Wrench(stamp_ns=len(commands) * NANOSECONDS))]


def _measured(
    scene: Scene,
    commands: Sequence[Command],
    length: float,
    budget: float,
    stopwatch: Stopwatch,
    with_outputs: bool = True,
    loaded: Iterable[OnDemand] = (),
) -> tuple[Simulation, float, Tally]:
    """Run for as long as the budget lasts; return the run, its cost (s per s), and the tally that decided on kernels.

    Kernels are decided on as in a run of `length` s, which may be longer than the measured one, by a process that has
    `loaded` some.
    """
    scene = scene if with_outputs else without_outputs(scene)
    with counted_by(stopwatch.tally(none=True)):
        _start(scene, commands).advance(_WARM_UP_NS)
    for _ in range(2):
        tally, modules = stopwatch.tally(), len(sys.modules)
        tally.used.update(loaded)
        with counted_by(tally):
            run, reached, wall = _timed(scene, commands, length, budget, stopwatch, with_outputs)
        # Outputs count too: a closed form takes one step for any number of them.
        if reached >= length or max(run.steps_computed, reached * scene.output_rate) >= _LEAST_STEPS:
            break
        # The budget was spent on parts of a few steps, which do not show the cost: the machine may have been busy.
    else:
        return run, math.nan, tally
    again = _REPEATS - 1 if wall < _SHORT else int(reached < length)
    longer = reached < length and bool(tally.asked)
    if longer:
        tally = stopwatch.tally(length / reached)
        tally.used.update(loaded)
    if longer or len(sys.modules) > modules:
        # This is not the cost of a longer run: that would use kernels that this one did not, or import nothing.
        wall, again = math.inf, again + 1
    with counted_by(tally):
        for _ in range(again):
            wall = min(wall, _timed(scene, commands, reached, math.inf, stopwatch, with_outputs)[2])
    return run, wall / reached, tally


def _timed(
    scene: Scene,
    commands: Sequence[Command],
    length: float,
    budget: float,
    stopwatch: Stopwatch,
    with_outputs: bool,
) -> tuple[Simulation, float, float]:
    """Run for as long as `budget` lasts; return the run, the simulated time (s), and the computing time (s).

    The run takes a minimum of steps if there is time for them, and with outputs it reaches at least one.
    """
    end = round(length * NANOSECONDS)
    # Results cached by an earlier run would make this one look faster.
    clear_caches()
    run = _start(scene, commands)
    # Set-up is told apart, see `fixed_costs`: it may take longer than all steps.
    begin = stopwatch()
    least = run.next_output_ns() if with_outputs else 0
    part = max(1, end >> _SMALLEST_PART)
    while True:
        run.advance(min(part, end))
        wall = stopwatch() - begin
        # A closed form may have a million outputs and only one step.
        enough = run.steps_computed >= _LEAST_STEPS or wall > budget
        if part >= end or (wall > 0.5 * budget and part >= least and enough):
            return run, min(part, end) / NANOSECONDS, wall
        # The last part must not exceed the budget, and a short run must need few parts.
        part *= 2 if 32.0 * wall > budget else 16


def _start(scene: Scene, commands: Sequence[Command]) -> Simulation:
    run = Simulation(scene)
    post_all(run, commands)
    run.start()
    return run


def _errors(
    scene: Scene,
    commands: Sequence[Command],
    run: Simulation,
    length: float,
    budget: float,
    stopwatch: Stopwatch,
) -> tuple[float | None, float | None, float, str]:
    """Return the errors of attitude (rad) and position (m), the time (s) they apply to, and how they were found.

    That time is `length`, or what another method covers within the budget; `run` is continued to it. Shorter steps
    of the same method would prove nothing: if commands bound the steps, they would be the same.
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
            with counted_by(stopwatch.tally(missing="plain")):
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
        # At least the resolution of the numbers, or the accuracy of a coarser comparison run.
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
    return None, None, length, "no other method could run it for comparison"


def _closed_form_bounds(scene: Scene, run: Simulation, length: float) -> tuple[float, float]:
    """Return bounds on rounding errors: each arc rounds its rotation, and the initial state of the next one."""
    start, end, course = scene.initial, run.look(), run.course()
    attitude = _EPSILON * (100.0 * (course.arcs + course.turned) + 4.0 * course.rates * length)
    far = norm(start.position_world) + norm(end.position_world) + course.travelled + course.speeds * length
    return attitude, 4.0 * _EPSILON * far + norm(scene.body.center_of_mass) * attitude


# Methods of different families to compare with, in order of preference; dverk is of that of dop853, but wheels take no
# other.
_FAMILIES = ("taylor", "dop853", "dlm6", "rkmk54", "radau", "dverk")


def _others(scene: Scene, used: Sequence[str], accuracy: float) -> list[tuple[str, float]]:
    """Return methods and accuracies to compare with: methods not in `used`, finer than `accuracy` first."""
    able = [name for name in _FAMILIES if name not in used and METHODS[name].takes >= scene.combined_effects.takes]
    return [(name, factor * accuracy) for factor in (0.01, 0.1, 1.0, 1e2, 1e4) for name in able[:2]]
