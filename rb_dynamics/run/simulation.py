"""The loop: `Simulation` advances a scene from edge to edge (command, timeout, knot, output, end) and feeds sinks.

Offline runs, the node and replay all advance through `Simulation`, which must not read a clock, a file or a message.
"""

from __future__ import annotations

import contextlib
import logging
import math
import sys
import weakref
from bisect import insort
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import lru_cache
from operator import attrgetter
from typing import TYPE_CHECKING, cast

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import ConvergenceError, WrenchError
from rb_dynamics.formats.log_metadata import INPUTS_RULE
from rb_dynamics.loads.actuator import ActuatorCommand, Setpoint
from rb_dynamics.loads.actuator_bank import ActuatorBank
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.compiled_load import Underway
from rb_dynamics.loads.gradual_wrench import Transient, TransientLoad
from rb_dynamics.loads.reaction_wheel import NEAR_LIMIT
from rb_dynamics.loads.wheel_imbalance import RESOLVED
from rb_dynamics.loads.wheel_set import WheelLoad, WheelSet
from rb_dynamics.loads.wrench import HeldWrench, Wrench, held_of
from rb_dynamics.loads.wrench_channels import (
    AppliedWrench,
    CheckedWrench,
    ReceivedWrench,
    RejectedWrench,
    WrenchChannels,
)
from rb_dynamics.loads.wrench_command_arrays import CommandBatch
from rb_dynamics.motion import array_steps
from rb_dynamics.motion.arc import Arc, Enough, LoadFrom, OfPhase, OutOfTime, stop_if
from rb_dynamics.motion.closed_form import is_free
from rb_dynamics.motion.kernel_layout import phase_numbers, phase_of
from rb_dynamics.motion.phase_state import (
    SUMS,
    PhaseState,
    RoundingHistory,
    in_principal_axes,
    spun,
    time_between,
    two_sum,
)
from rb_dynamics.motion.propagation import Edges, Propagated, pays
from rb_dynamics.motion.propagation_kernel import CHANGE, OUTPUT
from rb_dynamics.motion.step_checks import out_of_range
from rb_dynamics.motion.step_control import WholeArc
from rb_dynamics.numerics.argument_checks import instance, items, shown, time_count, whole_number
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, exact_period_ns, nanoseconds
from rb_dynamics.numerics.sign_change import first_positive
from rb_dynamics.numerics.vector import ZERO, Vector, norm, scale
from rb_dynamics.run.edge_schedule import FEWEST, EdgeSchedule
from rb_dynamics.run.event_arrays import EventArrays
from rb_dynamics.run.input_hash import RULE, InputHash
from rb_dynamics.run.measurements import Measurements
from rb_dynamics.run.plan import OPEN_END_HORIZON, Plan
from rb_dynamics.run.provenance import run_metadata
from rb_dynamics.run.sample import Sample, SampleBuilder, acceleration, kinetic_energy, too_long
from rb_dynamics.run.sink import Event, RunInfo, Sink, Status
from rb_dynamics.run.state_change import StateChange, moved
from rb_dynamics.scene.model import Past, Scene
from rb_dynamics.scene.read import with_true_text
from rb_dynamics.sensors.sensor import Truth

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

_logger = logging.getLogger(__name__)

# What scenes continue without reaching their initial state, and was warned of.
_unreached: weakref.WeakValueDictionary[int, Past] = weakref.WeakValueDictionary()

_REMEDY = "give nanoseconds: round(1e9 * seconds)"

# ns: for so long a motion in closed form must be possible from a state to which the body is moved, under a torque; free
# motion must be up to the next change that is known, or the end, or of a run without one for so long as its accuracy.
_FORESEEN_NS, _FORESEEN_FREE_NS = NANOSECONDS, nanoseconds(OPEN_END_HORIZON)

# The level of a status, as in diagnostic_msgs/DiagnosticStatus.
_WARN = 1

# Hz: at a lower rate the first output after the start would be beyond the range of time.
_NEVER = 2.0**-31


class Simulation:
    """One run of a scene: takes commands, advances time, feeds sinks.

    Time is integer nanoseconds from 0. The motion depends only on the scene and on the commands with the times at which
    they take effect, not on how often `advance` is called, nor on the output rate.

    Attributes:
        clipped_on: number of commands reduced by the limits of their channel or actuator, by topic.
        taken_back: commands that `post` or `actuate` accepted, but that were rejected because the motion could not
            continue with them.
        refused: states from `set_state` from which the motion could not continue, each with the reason; the body was
            not moved.
        continues: whether this run continues the run in `scene.past`, with its bits, impulses and work. It does not if
            that run does not reach exactly the scene's initial state, as with another body.
    """

    def __init__(self, scene: Scene, sinks: Sequence[Sink] = (), facts: Mapping[str, str] | None = None) -> None:
        """Prepare a run; `start` begins it.

        Args:
            scene: the scene to simulate.
            sinks: receive the events of the run.
            facts: additional facts for logs, such as the source of the commands.

        Raises:
            TypeError: an argument has the wrong type.
            SceneError: the solver does not suit the scene.
        """
        scene = instance(scene, Scene, "scene", "read one with read_scene(path)")
        self.scene = scene = with_true_text(scene) if sinks else scene
        self._opened = self._finished = False
        self.end_ns = scene.end_ns
        self._facts = facts or {}
        self._sinks = tuple(map(_sink, items(sinks, "sinks", "a sequence of sinks")))
        self._effects = scene.combined_effects
        self._inputs = InputHash(scene)
        # States to move the body to, in order of time.
        self._moves: list[StateChange] = []
        self.taken_back: list[RejectedWrench | ActuatorCommand] = []
        self.refused: list[tuple[StateChange, str]] = []
        self.clipped_on = Counter[str]()
        # Times at which wheels came near their limits, by wheel and limit.
        self._remarks: dict[tuple[str, str], str] = {}
        self.continues = False
        self._period_ns = _period_ns(scene.output_rate) if scene.output_rate else None
        self._outputs = 0
        # Time of the last sample that the sinks have.
        self._written_ns = 0
        # Time up to which edges are taken one by one.
        self._one_by_one_ns = 0
        # Schedules count from the start of the run that the scene continues.
        self._earlier_ns = 0 if scene.past is None else scene.past.length_ns
        if scene.past is None:
            self._prepare(scene)
        else:
            self.continues = self._catch_up(scene.past)
        # Without a sink, nobody receives measurements.
        self._sensing = Measurements(scene) if scene.sensors and self._sinks else None

    def _prepare(self, scene: Scene, begin_ns: int = 0, channels: WrenchChannels | None = None) -> None:
        """Prepare the start of a run at `begin_ns` in the time of this one, with the commands that `channels` hold."""
        # Effects count time from the start of the run that the scene continues.
        elapsed = (self._earlier_ns + begin_ns) / NANOSECONDS
        self._planned = scene, begin_ns, elapsed
        self.plan = Plan(*self._planned)
        self.time_ns = self._computed_ns = begin_ns
        self._channels = channels or _channels(scene, self._effects, self._earlier_ns)
        self._bank = None
        if scene.actuators:
            self._bank = ActuatorBank(scene.actuators, scene.body, scene.frames, self._effects.magnetic_field)
        # By their nanosecond: the time that the effect gave may be a little later.
        self._named_knots = {nanoseconds(knot) - self._earlier_ns: knot for knot in self._effects.knots()}
        self._knots = list(self._named_knots)
        self._steps = self._steps_before = 0
        self._used: dict[str, None] = {}
        phase = self.plan.start
        self._wheels = None if self._bank is None else self._bank.wheels
        if self._wheels is not None:
            phase = phase.with_inner(self._wheels.begin(phase.angular_velocity))
        # The end of the stride that was searched for a switch of a wheel, and the time of the switch in it.
        self._searched_ns, self._switch_ns = -1, cast("int | None", None)
        # Whether a wheel may switch before that end or at it.
        self._unlike = True
        # The phase there, how far the wheels are beyond in it, and w' if it is known.
        self._ahead = cast("tuple[PhaseState, float, Vector | None] | None", None)
        _require_finite(scene.body, phase, begin_ns)
        self._observer = SampleBuilder(self._effects, phase, self._wheels)
        self._phase = phase
        self._held, self._load_from = HeldWrench(), cast("LoadFrom | None", None)
        self._arc = self._new_arc(self.plan)
        # Whether the load from `time_ns` on differs from that in `_arc`, and the arc of that load, if it was tried.
        self._stale, self._tried = False, cast("Arc | None", None)
        self._edge_schedule = EdgeSchedule(self._channels, scene.body, self._period_ns or (1, 1))

    def _catch_up(self, past: Past) -> bool:
        """Simulate `past` and continue it; otherwise begin anew with the held commands. Return whether it continues."""
        origin = replace(self.scene, initial=past.initial, duration=past.duration, past=None)
        self._prepare(origin, -past.length_ns)
        for topic, wrench, time_ns in past.commands:
            with contextlib.suppress(WrenchError):
                self._channels.post(topic, wrench, time_ns - past.length_ns)
        sinks, self._sinks = self._sinks, ()
        with contextlib.suppress(ConvergenceError):
            self._go_quietly()
        self._sinks = sinks
        if self.time_ns == 0 and self._phase.state(self.scene.body, 0) == self.scene.initial:
            return True
        # Once: a study runs the same scene with many solvers.
        if _unreached.get(id(past)) is not past:
            _unreached[id(past)] = past
            _logger.warning(
                "%s: the run that it continues does not reach the state in `initial`, because body, effects, solver "
                "or state were changed, or commands left out; this run starts anew from that state with the held "
                "commands, and its bits differ",
                self.scene.source,
            )
        # With their own times, from which timeout, delay and lag count.
        channels = self._channels
        while (change_ns := channels.next_change_ns()) is not None and change_ns < 0:
            channels.apply(change_ns)
        self._prepare(self.scene, channels=channels)
        return False

    def _go_quietly(self) -> None:
        """Advance to time 0 without output; changes of the load at 0 are still to come.

        Raises:
            ConvergenceError: a step could not be solved.
        """
        while True:
            if self._stale:
                self._renew()
            change = self._next_change_ns()
            edge = 0 if change is None else min(change, 0)
            self._phase = self._arc.at(edge)
            self.time_ns = self._computed_ns = edge
            self._steps = self._steps_before + self._arc.steps_to(edge)
            self._used.update(dict.fromkeys(self._arc.methods))
            if edge == 0:
                return
            self._apply_changes()

    @property
    def sample(self) -> Sample:
        """The sample at `time_ns`."""
        return self._observer.sample(self._phase, self.time_ns)

    def look(self) -> Sample:
        """Return the sample at the last time given to `advance`, edge or not, without advancing.

        Raises:
            ConvergenceError: a step could not be solved.
        """
        return self.sample_of(self.phase)

    def sample_of(self, phase: PhaseState) -> Sample:
        """Return the sample of `phase` at the time of `look`."""
        return self._observer.sample(phase, self._computed_ns)

    @property
    def phase(self) -> PhaseState:
        """The phase at the time of `look`.

        Raises:
            ConvergenceError: a step could not be solved.
        """
        if self._computed_ns == self.time_ns:
            return self._phase
        phase = self._arc.at(self._computed_ns)
        _require_finite(self.scene.body, phase, self._computed_ns)
        return phase

    def phases(self, times_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        """Advance to the first of `times_ns` or, by a kernel, to more of them; return the phases there, (k, `PHASE`).

        `times_ns` increase. The phases are those that `look` shows at these times, none after the end.

        Raises:
            ConvergenceError: not even the first could be reached.
        """
        import numpy as np

        first = int(times_ns[0])
        if self._stale:
            self._renew()
        if first > self._computed_ns and (found := self._propagate_to(times_ns)) is not None:
            return found
        self.advance(first)
        return np.array([phase_numbers(self.phase)])

    def _propagate_to(self, times_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.float64] | None:
        """Return the phases at those of the times that a kernel reaches before the next edge; None if there are few."""
        if self._period_ns is None or self._goes_edge_by_edge:
            return None
        edge = self._nearest_ns(self.next_output_ns(), self._next_change_ns())
        at = times_ns[: times_ns.searchsorted(edge)]
        if len(at) < FEWEST or not (pays(len(at)) or len(at) >= array_steps.FEWEST):
            return None
        found = self.plan.propagate(self._arc, Edges.of_outputs(at))
        if found is None or found[1].edges == 0:
            return None
        self._arc, propagated = found
        self._computed_ns = int(at[propagated.edges - 1])
        return propagated.outputs[: propagated.edges]

    @property
    def _goes_edge_by_edge(self) -> bool:
        """Whether a load or a sink needs edges one by one, because kernels do not support it."""
        load_from, scales = self._arc.load
        # Sinks are told of a transient at each output.
        acts = self._bank is not None or (load_from is not None and not scales.numbers) or scales.settled < math.inf
        return bool(acts or self._moves or self._sensing is not None)

    @property
    def acceleration(self) -> tuple[Vector, Vector]:
        """Acceleration of the body origin (m/s^2) and angular acceleration (rad/s^2) at `time_ns`, body axes."""
        if self.time_ns == self._planned[1] and (first := self._channels.scheduled(self.time_ns)) is not None:
            # Effects act from the start; their held wrenches are reported, and begin a new arc, after the first sample.
            with self._tentative():
                self._new_arc(Plan(*self._planned), first)
                return self._acceleration()
        return self._acceleration()

    def _acceleration(self) -> tuple[Vector, Vector]:
        load = self._load_from(self._phase) if self._load_from else None
        return acceleration(self.scene.body, self._phase, self._held, load)

    @contextlib.contextmanager
    def _tentative(self) -> Iterator[None]:
        """Undo afterwards what a new arc changes, and where it begins."""
        undo = self._undo()
        try:
            yield
        finally:
            undo()

    def _undo(self) -> Callable[[], None]:
        """Return what undoes what a new arc changes, and where it begins."""
        before = self._held, self._load_from, self._phase, self.time_ns
        turning = None if self._wheels is None else self._wheels.now

        def undo() -> None:
            self._held, self._load_from, self._phase, self.time_ns = before
            if self._wheels is not None and turning is not None:
                self._wheels.restore(turning)

        return undo

    @property
    def steps(self) -> int:
        """Steps taken so far, not counting the short ones to times between two grid points."""
        return self._steps

    @property
    def steps_computed(self) -> int:
        """Steps taken up to the last time given to `advance`, edge or not; a step beyond it counts, too."""
        return self._steps_before + self._arc.steps_to(self._computed_ns)

    @property
    def methods(self) -> str:
        """Names of the methods that have moved the body, in order of first use, joined by "+"."""
        return "+".join(self._used) or self.plan.name

    @property
    def moving(self) -> tuple[str, ...]:
        """Names of the methods used up to the last time given to `advance`, edge or not."""
        return tuple(dict.fromkeys((*self._used, *(self._arc.methods if self._computed_ns > self.time_ns else ()))))

    def course(self) -> RoundingHistory:
        """Return statistics of the path up to the last time given to `advance`, edge or not.

        Raises:
            ConvergenceError: a step could not be solved.
        """
        return self.plan.course(self._arc.at(self._computed_ns))

    @property
    def ended(self) -> bool:
        """Whether the scene's duration is over."""
        return self.time_ns == self.end_ns

    def open(self) -> None:
        """Open the sinks; if one cannot be opened, those opened before are closed.

        Raises:
            LogError: a log cannot be written.
        """
        self._opened = True
        if not self._sinks:
            return
        facts = {**run_metadata(self.scene, self.plan.name, self.plan.description), **self._facts}
        run = RunInfo(self.scene, self.plan.name, facts, lambda: self.acceleration)
        with contextlib.ExitStack() as opened:
            for sink in self._sinks:
                sink.open(run)
                opened.callback(sink.close, {})
            opened.pop_all()

    def start(self) -> None:
        """Give the sinks the initial state, and open them before, unless `open` did.

        Raises:
            LogError: a log cannot be written.
        """
        if not self._opened:
            self.open()
        self._outputs = 1
        if self._sinks:
            self.write(self.sample)
        if self.scene.past is not None:
            self._write_changes(self._channels.standing(0, self._phase.orientation))
        self._measure()

    def post(self, topic: str, wrench: Wrench, time_ns: int = 0) -> bool:
        """Let `wrench` take effect on channel `topic` at `time_ns`; a time in the past means now.

        A command after the end has no effect. Returns whether the limits of the channel reduce it.

        Raises:
            TypeError: an argument has the wrong type.
            WrenchError: the command is rejected; the run continues without it.
        """
        command = self.check(topic, wrench)
        self.take(command, time_ns)
        return command.require()

    def check(self, topic: str, wrench: Wrench) -> CheckedWrench:
        """Return the command as the channel `topic` would apply it, for `take`; changes nothing.

        Raises:
            TypeError: an argument has the wrong type.
            WrenchError: there is no such channel.
        """
        instance(topic, str, "topic", "write the name of a channel")
        return self._channels.check(topic, instance(wrench, Wrench, "wrench", "write Wrench(force, torque)"))

    def take(self, command: CheckedWrench, time_ns: int) -> None:
        """Let a command from `check` take effect as `post` does; a rejected one is reported to the sinks."""
        if self.scene.past is not None and time_ns < 0:
            return  # in the past, which has its commands at their own times, whether it is continued or begun anew
        time_ns = max(self._computed_ns, whole_number(time_ns, "time_ns", _REMEDY))
        # A command for after the end is kept, too: see `hasten`.
        self._channels.take(command, time_ns)
        self._edge_schedule.forget()
        if command.clipped and self._before_end(time_ns):
            self.clipped_on[self.scene.channels[command.channel].topic] += 1

    def actuate(self, topic: str, value: float, time_ns: int = 0) -> bool:
        """Let a command to an actuator take effect as `post` does; returns whether its limits reduce it.

        Raises:
            TypeError: an argument has the wrong type.
            WrenchError: there is no such actuator, or it cannot honour the command; the run continues without it.
        """
        instance(topic, str, "topic", "write the topic of an actuator, such as wheel/command")
        value, time_ns = Setpoint(value).value, max(self._computed_ns, whole_number(time_ns, "time_ns", _REMEDY))
        if self._bank is None:
            raise WrenchError(f"topic is {topic!r}, expected that of an actuator; the scene lists none")
        in_time = self._before_end(time_ns)
        if in_time:
            # A rejected one is kept, too: sinks receive it at its time.
            self._bank.post(topic, value, time_ns)
        clipped = self._bank.accept(topic, value)
        if clipped and in_time:
            self.clipped_on[topic] += 1
        return clipped

    @property
    def clipped(self) -> int:
        """Number of commands reduced by the limits of their channel or actuator."""
        return self.clipped_on.total()

    def _before_end(self, time_ns: int) -> bool:
        return self.end_ns is None or time_ns <= self.end_ns

    def set_state(self, change: StateChange) -> None:
        """Move the body to another state at the time of `change`; a time in the past means now.

        Commands remain held; outputs, schedules and the end keep their times. A change after the end is ignored. One
        after which no step can be taken is left out, without a trace in the motion: see `refused`.

        Raises:
            ConvergenceError: an energy or a momentum of that state is beyond double precision.
        """
        if change.time_ns < self._computed_ns:
            change = change.at(self._computed_ns)
        _require_finite(self.scene.body, PhaseState.of(self.scene.body, change.state), change.time_ns)
        if self._before_end(change.time_ns):
            insort(self._moves, change, key=attrgetter("time_ns"))

    def move(self, change: StateChange) -> None:
        """Move the body as `set_state` does, now.

        Raises:
            ConvergenceError: no step could be taken after the change, or an earlier one; the body was not moved.
        """
        change = change.at(self._computed_ns)
        self.set_state(change)
        try:
            self.advance(self._computed_ns)
        finally:
            self._moves = [each for each in self._moves if each is not change]
        for number, (refused, reason) in enumerate(self.refused):
            if refused is change:
                del self.refused[number]
                raise ConvergenceError(reason)

    def hindrance(self, change: StateChange | None = None) -> str:
        """Return why the motion cannot continue from now, or from `change` now, or ""; changes nothing."""
        with self._tentative():
            try:
                self._phase = self.phase
            except ConvergenceError as error:
                return str(error)
            self.time_ns = self._computed_ns
            if change is not None:
                self._phase = self._after_move(change)
            return self._obstacle(_FORESEEN_NS)

    def post_batch(self, batch: CommandBatch) -> list[str]:
        """Let commands take effect as `post` does, in the order of `batch`, each at its time; return why some do not.

        No command is earlier than one of an earlier batch.
        """
        end_ns = math.inf if self.end_ns is None else self.end_ns
        first, last = batch.time_ns.searchsorted((self._computed_ns, end_ns), side="right").tolist()
        table, others = self._channels.regular(batch.some(slice(first, None)))
        rejected = []
        for row in (*range(first), *(others + first).tolist()):
            topic, time_ns = self.scene.channels[int(batch.channel[row])].topic, int(batch.time_ns[row])
            rejected += self.try_post(topic, batch.received(row), time_ns)
        self._channels.extend(table.before(last - first - int(others.searchsorted(last - first))))
        self._edge_schedule.forget()
        return rejected

    def try_post(self, topic: str, command: Wrench | Setpoint, time_ns: int) -> list[str]:
        """Let a command take effect as `post` and `actuate` do; return the reason if it is rejected."""
        try:
            if isinstance(command, Setpoint):
                self.actuate(topic, command.value, time_ns)
            else:
                self.post(topic, command, time_ns)
        except WrenchError as error:
            return [f"{topic} at simulation time {time_ns / NANOSECONDS:.9f} s: {error}"]
        return []

    def number_of(self, topic: str) -> int | None:
        """Return the number of the channel `topic` in the order of the scene; None if there is none."""
        return self._channels.number(topic)

    def hasten(self, by_ns: int | None) -> list[str]:
        """Let pending commands that have a stamp act this much sooner, None: never; return the channels of these.

        Of each channel's commands that would have acted before now, the newest acts now, and the others never.
        """
        self._edge_schedule.forget()
        return self._channels.hasten(by_ns, self._computed_ns)

    def outstanding(self) -> list[tuple[str, Wrench, int]]:
        """Return topic, command and time (ns from now, 0 if held) of each command that a run from here would need."""
        return [(topic, wrench, max(0, at - self._computed_ns)) for topic, wrench, at in self._channels.outstanding()]

    def next_output_ns(self) -> int:
        """Return the next time at which a sample is due."""
        if self._period_ns is None:
            return self._arc.next_grid_ns()
        period, parts = self._period_ns
        return (2 * self._outputs * period + parts) // (2 * parts)

    def next_event_ns(self) -> int:
        """Return the next time at which a sink receives a sample or a measurement, as far as known."""
        output = self.next_output_ns()
        return output if self._sensing is None else min(output, self._sensing.next_ns)

    @property
    def computed_ns(self) -> int:
        """The time up to which the motion is computed, edge or not: nothing can take effect before it."""
        return self._computed_ns

    def advance(self, until_ns: int, enough: Enough | None = None) -> None:
        """Advance to the last edge at or before `until_ns`, never past the end of the scene.

        `sample` is that of the edge; `look` shows the motion at `until_ns`.

        With `enough`, it ends after the first stride or edge at which `enough()` is true, at `computed_ns`.

        Raises:
            ConvergenceError: a step could not be solved; `time_ns` and `sample` remain at the last good state.
        """
        try:
            with contextlib.suppress(OutOfTime):
                self._advance(time_count(until_ns, "until_ns"), enough)
        finally:
            # However it ended, the strides taken are final.
            self._computed_ns = max(self._computed_ns, self._arc.reached_ns)

    def _advance(self, until_ns: int, enough: Enough | None) -> None:
        output, begun_ns = self.next_output_ns(), self.time_ns
        while True:
            change = self._next_change_ns()
            if self._stale:
                self._renew_before(change)
                output = self.next_output_ns()
            if change is not None and change <= self.time_ns:
                self._write_step()
                self._apply_changes()
                continue
            # Not before the changes of this time: a run that ends here would have reached them without a trace.
            stop_if(enough, begun_ns < self.time_ns < until_ns)
            edge, switch = self._nearest_ns(output, change), None
            if self._wheels is not None and not self.ended:
                switch = self._next_switch_ns(self._wheels, min(edge, until_ns), enough)
                edge = edge if switch is None else switch
            if edge > until_ns or self.ended:
                # No edge is reached, but steps towards it are taken, so that the next call costs less.
                if not self.ended:
                    self._arc.advance(until_ns, enough)
                    self._computed_ns = max(self._computed_ns, until_ns)
                return
            if edge > self._one_by_one_ns and self._fly(until_ns, enough):
                output = self.next_output_ns()
                continue
            phase = self._arc.at(edge, enough)
            _require_finite(self.scene.body, phase, edge)
            if self._wheels is not None and edge > self.time_ns:
                self._wheels.move_on()
            self.time_ns, self._phase = edge, phase
            self._computed_ns = max(self._computed_ns, edge)
            # Not later, when more may have been computed.
            self._steps = self._steps_before + self._arc.steps_to(edge)
            self._used.update(dict.fromkeys(self._arc.methods))
            if edge == switch:
                self._switch(phase)
            if edge == output:
                self._outputs += 1
                output = self.next_output_ns()
                self._write_sample()
            elif edge == self.end_ns:
                self._write_sample()
            self._measure()

    @property
    def rate(self) -> float:
        """Angular rate of the body at `time_ns`, rad/s."""
        return norm(self._phase.angular_velocity)

    @property
    def remarks(self) -> list[str]:
        """Warnings about limits that were nearly reached so far and steps that are too long, in full sentences."""
        remarks, step = [*self._remarks.values()], self.scene.solver.step
        if step is not None:
            now = self.sample
            if long := too_long(step, self.scene.body, now.kinetic_energy, now.work, now.energy_defect):
                remarks.append(long)
        return remarks

    def _look_at_wheels(self, wheels: WheelSet) -> None:
        """Record the first time at which each wheel is near a limit."""
        speeds = wheels.speeds(self._phase.angular_velocity, self._phase.inner)
        step, at = self.scene.solver.step or 0.0, f"{self.time_ns / NANOSECONDS:.9g} s"
        for wheel, speed in zip(wheels.wheels, speeds, strict=True):
            if abs(speed) >= NEAR_LIMIT * wheel.max_speed and (wheel.name, "full") not in self._remarks:
                self._remarks[wheel.name, "full"] = (
                    f"{wheel.name} was near its max_speed of {wheel.max_speed:g} rad/s at {at}, beyond which its "
                    "motor does not drive it"
                )
            if abs(speed) * step > RESOLVED and not wheel.is_balanced and (wheel.name, "step") not in self._remarks:
                self._remarks[wheel.name, "step"] = (
                    f"{wheel.name} turned by {abs(speed) * step:.2g} rad per step of {step:g} s at {at}, too far to "
                    "resolve its imbalance; take shorter steps, or give solver.accuracy"
                )

    def _write_sample(self) -> None:
        """Pass to the sinks the state, and the wrenches that are changing gradually."""
        self._written_ns = self.time_ns
        if self._wheels is not None:
            self._look_at_wheels(self._wheels)
        if self._sinks:
            self.write(self.sample)
            if self._channels.lag:
                for event in self._channels.on_their_way(self.time_ns, self._phase.orientation):
                    self.write(event)
            if self._bank is not None:
                for actuator in self._bank.on_their_way(self.time_ns):
                    self.write(actuator)

    def _write_step(self) -> None:
        """Write the sample before the changes at `time_ns`, if every step is an output and there is none yet.

        Not where the edge is reached: a command may come later at the time of a sample of a sensor. States from which
        the motion could not continue are left out without a trace.
        """
        if self._period_ns is not None or self._written_ns == self.time_ns:
            return
        change = self._next_load_change_ns()
        due = [move for move in self._moves if move.time_ns <= self.time_ns]
        if (change is not None and change <= self.time_ns) or not all(map(self.hindrance, due)):
            self._write_sample()

    def _nearest_ns(self, output_ns: int, change_ns: int | None) -> int:
        """Return the earliest of an output, a change, the next sample of a sensor, and the end."""
        nearest_ns = output_ns if change_ns is None else min(output_ns, change_ns)
        if self._sensing is not None:
            nearest_ns = min(nearest_ns, self._sensing.next_ns)
        return nearest_ns if self.end_ns is None else min(nearest_ns, self.end_ns)

    def _fly(self, until_ns: int, enough: Enough | None) -> bool:
        """Propagate over many edges up to `until_ns`; return whether it may be called again."""
        # The last edge needs more than a kernel does; where this fails, all edges are taken one by one.
        self._one_by_one_ns = until_ns
        few = self._period_ns is None or self._edge_schedule.count(self.time_ns, until_ns) < FEWEST
        if few or self._goes_edge_by_edge:
            return False
        horizon_ns = until_ns if self.end_ns is None else self.end_ns - 1
        if self._knots:
            horizon_ns = min(horizon_ns, self._knots[0] - 1)
            self._one_by_one_ns = min(until_ns, self._knots[0])
        count = self._edge_schedule.count(self.time_ns, min(until_ns, horizon_ns))
        if count < FEWEST or not (pays(count) or count >= array_steps.FEWEST):
            return False
        edges = self._edge_schedule.after(self.time_ns, self._outputs, min(until_ns, horizon_ns), horizon_ns)
        found = None if edges is None else self.plan.propagate(self._arc, edges, enough)
        if edges is None or found is None:
            self._one_by_one_ns = min(until_ns, self._edge_schedule.known_ns)
            if edges is not None:
                # Up to the change after which array steps may pay.
                begin, end = edges.stretch(array_steps.FEWEST)
                self._one_by_one_ns = int(edges.at[min(begin - 1 if begin else end, len(edges.at) - 1)])
            return False
        before = self._arc.methods
        self._arc, propagated = found
        self._arc.expected_ns = horizon_ns
        self._one_by_one_ns = int(edges.at[min(propagated.edges, len(edges.at) - 1)])
        if propagated.edges == 0:
            return False
        self._steps = self._steps_before + propagated.steps_here
        self._used.update(dict.fromkeys((*before, *propagated.methods)))
        if propagated.changes:
            self._steps_before += propagated.steps
        self._report(edges, propagated)
        self._phase, self._held = propagated.here, propagated.arc_state.held
        self._computed_ns = max(self._computed_ns, self.time_ns)
        return True

    def _report(self, edges: Edges, propagated: Propagated) -> None:
        """Apply the changes of a propagation, and pass its events to the sinks."""
        import numpy as np

        at, kinds = edges.at[: propagated.edges], edges.kinds[: propagated.edges]
        outputs = at[kinds & OUTPUT != 0]
        self._outputs += len(outputs)
        self.time_ns = int(at[-1])
        if not self._sinks:
            self._channels.skip(self.time_ns)
            return
        rows = np.ascontiguousarray(propagated.outputs[: len(outputs)].T)
        block = EventArrays.of(
            self._observer.samples(phase_of(tuple(rows)), outputs), self._channels.changes(self.time_ns)
        )
        self._inputs.update_all(block.changes)
        if self._finished:
            return
        others = []
        for sink in self._sinks:
            if (write_block := getattr(sink, "write_block", None)) is not None:
                write_block(block)
            else:
                others.append(sink)
        if not others:
            return
        held = dict(zip(at[kinds & CHANGE != 0].tolist(), edges.held, strict=False))
        for number, event in block.events():
            # For the acceleration.
            self.time_ns = event.time_ns
            if isinstance(event, Sample):
                self._phase = phase_of(tuple(rows[:, number].tolist()))
            else:
                self._held = held_of(held[event.time_ns].tolist())
            for sink in others:
                sink.write(event)

    def _with_wheels(self, wheels: WheelSet, held: HeldWrench, load_from: LoadFrom | None) -> LoadFrom:
        return lambda phase: WheelLoad(wheels, held, None if load_from is None else load_from(phase), phase.inner)

    def _torque(self, phase: PhaseState) -> Vector:
        """Return the external torque (principal axes) on body and wheels."""
        load = None if self._load_from is None else self._load_from(phase)
        assert isinstance(load, WheelLoad)
        velocity = scale(1.0 / self.scene.body.mass, phase.linear_momentum_world)
        return load.outside(0.0, ZERO, velocity, phase.orientation, phase.angular_velocity, load.states)[2]

    def _beyond(self, wheels: WheelSet, phase: PhaseState) -> tuple[float, Vector | None]:
        return wheels.excess(lambda: self._torque(phase), phase.angular_velocity, phase.inner)

    def _spin_up(self, wheels: WheelSet, phase: PhaseState) -> Vector:
        return wheels.spin_up(self._torque(phase), phase.angular_velocity, phase.inner)

    def _switch(self, phase: PhaseState) -> None:
        """Switch the wheels that have reached a switching time, from here on."""
        if self._wheels is not None:
            there = phase.orientation, phase.angular_velocity
            change, gains = self._wheels.switch(self._torque(phase), *there, phase.inner)
            if change != ZERO:
                high, low = zip(*map(two_sum, phase.high[SUMS:], gains, phase.low[SUMS:]), strict=True)
                turned = spun(phase, self.scene.body.principal_moments, change)
                self._phase = turned._replace(high=turned.high + high, low=turned.low + low)
            self._stale = True

    def _next_switch_ns(self, wheels: WheelSet, until_ns: int, enough: Enough | None) -> int | None:
        """Return the first time up to `until_ns` at which a wheel switches between free and held; None if none does.

        The search covers whole strides, so that the result depends neither on outputs nor on the calls of `advance`.
        """
        # At the end of a stride after which none may switch, the next is not chosen: a new arc may begin there.
        while self._switch_ns is None and until_ns > self._searched_ns - self._unlike:
            before = self._searched_ns, self._unlike
            try:
                self._search_stride(wheels)
            except ConvergenceError:
                self._searched_ns, self._unlike = before
                if until_ns > max(self._searched_ns, self.time_ns):
                    raise
                # Time does not enter that stride: another load may act from its beginning on.
                break
            if enough is not None and self.time_ns < before[0] < until_ns and enough():
                # The search has entered the stride that begins there: nothing can act before it goes on.
                self._computed_ns = max(self._computed_ns, before[0] + 1)
                raise OutOfTime
        return self._switch_ns if self._switch_ns is not None and self._switch_ns <= until_ns else None

    def _search_stride(self, wheels: WheelSet) -> None:
        """Search the next stride for a time at which a wheel switches."""
        if self._arc.next_grid_ns() == self._searched_ns:
            self._arc.advance(self._searched_ns)
        end_ns = self._arc.next_grid_ns()
        first, last = max(self._searched_ns - 1, self.time_ns), end_ns
        self._searched_ns = end_ns
        start, there = self._arc.state.phase, self._arc.ahead()
        above, late = self._beyond(wheels, there)
        self._unlike = above > 0.0
        if self._unlike:
            last -= 1
            if last <= first:
                return
            there = self._arc.at(last)
            above, late = self._beyond(wheels, there)
        if self._ahead is None or self._ahead[0] is not start:
            self._ahead = start, *self._beyond(wheels, start)
        _, below, early = self._ahead
        self._ahead, below = (there, above, late), min(below, 0.0)
        turning, h = (start.angular_velocity, there.angular_velocity), (last - first) / NANOSECONDS
        if wheels.is_far(max(below, above), h, turning, (start.orientation, there.orientation)):
            return
        gaining = early or self._spin_up(wheels, start), late or self._spin_up(wheels, there)
        self._ahead = there, above, gaining[1]
        bend, noise = wheels.bend_and_noise(start.inner, h, turning, gaining)
        found = first_positive(
            lambda at: self._beyond(wheels, self._arc.at(at))[0],
            first,
            last,
            below,
            above,
            bend / NANOSECONDS**2,
            noise,
        )
        if found > 0:
            self._switch_ns = first + found

    def _measure(self) -> None:
        """Let the sensors read the motion at `time_ns`, and pass to the sinks what has arrived by then."""
        sensing = self._sensing
        if sensing is None or sensing.next_ns > self.time_ns:
            return
        sample, effects = self.sample, self._effects
        truth = Truth(
            sample.position_world,
            sample.orientation_xyzw,
            sample.angular_velocity_body,
            lambda: self.acceleration,
            effects.gravity(),
            effects.magnetic_field(self._phase.time),
        )
        for measurement in sensing.at(self.time_ns, truth):
            self.write(measurement)

    def _write_changes(self, changes: Sequence[AppliedWrench | ReceivedWrench | RejectedWrench]) -> None:
        for change in changes:
            # Only sinks receive the hash of the inputs, at the end.
            if self._sinks and isinstance(change, AppliedWrench):
                self._inputs.update(change)
            self.write(change)

    def write(self, event: Event) -> None:
        """Pass an event to every sink, unless the run is finished."""
        if not self._finished:
            for sink in self._sinks:
                sink.write(event)

    def tell(self, warnings: Sequence[str]) -> None:
        """Pass warnings to every sink, as one status on `/diagnostics`."""
        if warnings:
            self.write(Status(self.time_ns, _WARN, "; ".join(warnings), {}))

    def finish(self) -> None:
        """Close every sink, even if one of them fails; a second call does nothing."""
        if self._finished:
            return
        try:
            if self._outputs and self._computed_ns == 0 and self._sinks:
                # What acts from the start on belongs to a run that ends there, too.
                with contextlib.suppress(ConvergenceError, OverflowError):
                    self.advance(0)
        finally:
            self._finished = True
            self._close_sinks()

    def _close_sinks(self) -> None:
        if not self._sinks:
            return
        result = {
            "method": self.methods,
            "steps": str(self.steps),
            "end_time_ns": str(self.time_ns),
            "inputs_sha256": self._inputs.hexdigest(),
            INPUTS_RULE: RULE,
        }
        with contextlib.ExitStack() as stack:
            for sink in self._sinks:
                stack.callback(sink.close, result)

    def _next_load_change_ns(self) -> int | None:
        """Return when the load changes next: a command, a timeout or a knot of an effect."""
        change = self._channels.next_change_ns()
        if self._bank is not None and (driven := self._bank.next_change_ns()) is not None:
            change = driven if change is None else min(change, driven)
        if self._knots and (change is None or self._knots[0] < change):
            return self._knots[0]
        return change

    def _next_change_ns(self) -> int | None:
        """Return when the load changes next, or the body is moved."""
        change = self._next_load_change_ns()
        if self._moves and (change is None or self._moves[0].time_ns < change):
            return self._moves[0].time_ns
        return change

    def _apply_changes(self) -> None:
        ahead = [knot for knot in self._knots if knot > self.time_ns]
        kink = len(ahead) < len(self._knots)
        self._knots = ahead
        if kink and self.time_ns in self._named_knots:
            self._effects.require_smooth(self._phase.point(self.scene.body), self._named_knots[self.time_ns])
        changes = self._channels_applied()
        while self._channels.is_due(self.time_ns):
            changes += self._channels_applied()
        self._write_changes(changes)
        if self._bank is not None:
            for told in self._drive(self._bank):
                if self._sinks and isinstance(told, ActuatorCommand) and not told.reason:
                    self._inputs.actuate(told)
                self.write(told)
        # A rejected command leaves no trace in the motion, not even an edge.
        if kink or any(isinstance(change, AppliedWrench) for change in changes):
            self._stale = True
        while self._moves and self._moves[0].time_ns <= self.time_ns:
            self._move(self._moves.pop(0))

    def _channels_applied(self) -> list[AppliedWrench | ReceivedWrench | RejectedWrench]:
        """Apply commands up to one that must be tried, but not that one if no step can be taken under it."""
        orientation = self._phase.orientation
        changes = self._channels.apply(self.time_ns, orientation)
        came = self._channels.came
        while self._channels.huge and not self._goes_on():
            changes = [*came, *self._channels.apply(self.time_ns, orientation)]
            came = [*came, *self._channels.came]
        return changes

    def _drive(self, bank: ActuatorBank) -> list[ActuatorCommand | AppliedWrench]:
        """Apply what is due to the actuators, but not the commands of wheels under which no step can be taken."""
        told = bank.apply(self.time_ns)
        if not bank.changed:
            return told
        before = () if self._wheels is None else self._wheels.now
        turning = self._phase.angular_velocity, self._phase.inner
        for place in bank.huge(told):
            # Before a later one of its time replaces it, as where they come one by one.
            bank.turn(told[: place + 1], *turning)
            if reason := self._obstacle():
                refused = told[place] = replace(
                    cast("ActuatorCommand", told[place]), reason=f"not one step can be taken under it: {reason}"
                )
                self.taken_back.append(refused)
            cast("WheelSet", self._wheels).restore(before)
        bank.turn(told, *turning)
        self._stale |= any(not (isinstance(each, ActuatorCommand) and each.reason) for each in told)
        return told

    def _move(self, change: StateChange) -> None:
        """Move the body, unless the motion could not continue from there."""
        plan, undo = copy(self.plan).separated(), self._undo()
        self._phase = self._after_move(change)
        try:
            self._tried = self._first_arc(plan, _FORESEEN_NS)
        except (ConvergenceError, OverflowError) as error:
            undo()
            self.refused.append((change, f"the motion cannot continue from there: {error}"))
            return
        self.plan = plan
        if self._sinks:
            self._inputs.move(change)
        self.write(change)
        self._stale = True

    def _after_move(self, change: StateChange) -> PhaseState:
        """Return the phase after `change`."""
        before, phase = self._phase, moved(self.scene.body, self._phase, change)
        if self._wheels is None:
            return phase
        there = (phase.orientation, phase.angular_velocity)
        return phase.with_inner(self._wheels.moved((before.orientation, before.angular_velocity), there, before.inner))

    def _goes_on(self) -> bool:
        """Return whether one step can be taken under the present load; if not, reject the largest command."""
        if reason := self._obstacle():
            self.taken_back.append(self._channels.take_back(f"not one step can be taken under it: {reason}"))
        return not reason

    def _obstacle(self, foreseen_ns: int = 0) -> str:
        """Return why not one step can be taken from the present state under the present load, or "".

        As for `_first_arc`.
        """
        try:
            with self._tentative():
                self._first_arc(copy(self.plan).separated(), foreseen_ns)
        except (ConvergenceError, OverflowError) as error:
            return str(error)
        return ""

    def _first_arc(self, plan: Plan, foreseen_ns: int) -> Arc:
        """Return a new arc that lasts a step or, in closed form, `foreseen_ns` and a free one longer, if the run does.

        Raises:
            ConvergenceError: it does not.
            OverflowError: likewise.
        """
        arc = self._new_arc(plan)
        grid_ns = arc.next_grid_ns()
        if grid_ns - self.time_ns < WholeArc.length:
            _require_finite(self.scene.body, arc.ahead(), grid_ns)
        else:
            until_ns = self.time_ns + foreseen_ns
            if foreseen_ns and is_free(self._held):
                # No command can be foreseen, and nothing but a command slows it down.
                free_ns = self.time_ns + _FORESEEN_FREE_NS if self.end_ns is None else self.end_ns
                change_ns = self._next_change_ns()
                until_ns = max(until_ns, free_ns if change_ns is None else min(free_ns, change_ns))
            until_ns = until_ns if self.end_ns is None else min(until_ns, self.end_ns)
            _require_finite(self.scene.body, arc.at(until_ns), until_ns)
        self._observer.sample(self._phase, self.time_ns)
        return arc

    def _renew_before(self, change_ns: int | None) -> None:
        """Begin a new arc at `time_ns`, if one can begin before the next change at `change_ns`."""
        try:
            self._renew()
        except (ConvergenceError, OverflowError):
            # A change now may let the motion continue.
            if change_ns is None or change_ns > self.time_ns:
                raise

    def _renew(self) -> None:
        """Begin a new arc at `time_ns`."""
        if self._wheels is not None:
            self._look_at_wheels(self._wheels)
        self._arc, self._tried = self._tried or self._new_arc(self.plan), None
        self._steps_before, self._stale = self._steps, False
        self._searched_ns, self._switch_ns, self._ahead = -1, None, None

    def _new_arc(self, plan: Plan, more: HeldWrench | None = None) -> Arc:
        """Begin an arc at `time_ns` under the present loads and `more`."""
        acting, driven, dipole = self._channels.total(), None, ZERO
        if more is not None:
            acting = acting + more
        if self._bank is not None:
            acting, driven, dipole = acting + self._bank.held(), self._bank.wrenching(), self._bank.dipole
        self._held = held = in_principal_axes(self.scene.body, acting)
        seconds = (self.time_ns + self._earlier_ns) / NANOSECONDS
        seconds = max(seconds, self._named_knots.get(self.time_ns, seconds))
        body, load_from = self.scene.body, self._effects.load_from(seconds, driven)
        self._load_from = None if load_from is None else lambda phase: load_from(phase.point(body))
        gradual = self._channels.transients() + (self._bank.transients() if self._bank is not None else [])
        transients = [
            each._replace(before=in_principal_axes(body, each.before), after=in_principal_axes(body, each.after))
            for each in gradual
        ]
        if transients:
            self._load_from = _with_transients(transients, self.time_ns, self._phase, self._load_from)
        if self._wheels is not None:
            self._load_from, start = self._with_wheels(self._wheels, held, self._load_from), self._phase
            self._wheels.settle(lambda: self._torque(start), start.angular_velocity, start.inner)
        numbers, gradually = None, None
        wheels: tuple[float, ...] = ()
        # Imbalances have no numbers for kernels.
        plain = self._wheels is not None and self._wheels.imbalances
        if self._load_from is not None and not plain:
            clock = self._phase.high[13], self._phase.low[13]
            underway = [Underway(each, (self.time_ns - each.since_ns) / NANOSECONDS, *clock) for each in transients]
            numbers = self._effects.numbers(seconds, dipole, plugins=True, underway=underway)
            wheels = self._wheels.now if self._wheels is not None and numbers else ()
        if transients:
            settled = self._phase.time + (min(each.end_ns for each in transients) - self.time_ns) / NANOSECONDS
            gradually = settled, _sight_of(transients, self.time_ns, self._phase)
        sight = None if self._wheels is None else _sight_of_wheels(self._wheels)
        arc = plan.arc(held, self.time_ns, self._phase, self._load_from, numbers, wheels, gradually, sight)
        expected = [time for time in (self._next_change_ns(), self.end_ns) if time is not None]
        arc.expected_ns = min(expected, default=self.time_ns)
        return arc


def without_outputs(scene: Scene) -> Scene:
    """Return `scene` without outputs, for runs without sinks; the motion is the same."""
    if scene.output_rate == 0.0:
        return scene
    # Everything else has been checked, and cached properties of the scene stay valid.
    found = object.__new__(Scene)
    vars(found).update(vars(scene), output_rate=_NEVER)
    return found


@lru_cache(maxsize=16)
def _period_ns(rate: float) -> tuple[int, int]:
    """Return the exact time (ns) between outputs at `rate` (Hz), taken as the decimal number that was written."""
    return exact_period_ns(rate).as_integer_ratio()


def _sink(sink: Sink) -> Sink:
    for name in ("open", "write", "close"):
        if isinstance(sink, type) or not callable(getattr(sink, name, None)):
            raise TypeError(f"sinks has {shown(sink)}, expected what can open, write and close; give [MemorySink()]")
    return sink


def _channels(scene: Scene, effects: CombinedEffects, earlier_ns: int) -> WrenchChannels:
    """Return the channels of the scene, then one for each effect with held wrenches, `earlier_ns` sooner."""
    schedules = effects.schedules()
    channels = WrenchChannels(scene.channels, scene.frames, [name for name, _ in schedules], scene.body)
    for number, (_, entries) in enumerate(schedules):
        for seconds, wrench in entries:
            time_ns = nanoseconds(seconds)
            channels.schedule(number, replace(wrench, stamp_ns=time_ns), time_ns - earlier_ns)
    return channels


def _with_transients(
    transients: Sequence[Transient], since_ns: int, start: PhaseState, load_from: LoadFrom | None
) -> LoadFrom:
    """Return the load of an arc from `start` at `since_ns`, transients included."""
    ages = [(since_ns - each.since_ns) / NANOSECONDS for each in transients]

    def at(phase: PhaseState) -> TransientLoad:
        t = time_between(start, phase)
        return TransientLoad(transients, [age + t for age in ages], load_from and load_from(phase))

    return at


def _sight_of(transients: Sequence[Transient], since_ns: int, start: PhaseState) -> OfPhase:
    """Return for how long (s) a phase of an arc predicts the transients."""
    ages = [(since_ns - each.since_ns, each) for each in transients]

    def at(phase: PhaseState) -> float:
        t = time_between(start, phase)
        return min(each.sight(age_ns / NANOSECONDS + t) for age_ns, each in ages)

    return at


def _sight_of_wheels(wheels: WheelSet) -> OfPhase | None:
    """Return for how long (s) a phase predicts the loads of imbalances; None without imbalances."""
    return (lambda phase: wheels.sight(phase.angular_velocity, phase.inner)) if wheels.imbalances else None


def _require_finite(body: RigidBody, phase: PhaseState, time_ns: int) -> None:
    least = min(body.principal_moments)
    if 0.0 < least < sys.float_info.min:
        raise ConvergenceError(
            f"the body has a moment of inertia of {least:.3g} kg m^2, expected at least {sys.float_info.min:.3g}; "
            "below it double precision has too few digits; check the units, or leave the inertia out for a particle"
        )
    numbers = (*phase.high, *phase.low, *phase.orientation, *phase.angular_velocity, kinetic_energy(body, phase))
    if not all(map(math.isfinite, numbers)):
        raise out_of_range(f"at simulation time {time_ns / NANOSECONDS:.9g} s")
