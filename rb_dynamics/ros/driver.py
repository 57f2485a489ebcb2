"""`Driver`: decides when the simulation advances, and carries it from one run to the next. Must not know ROS.

A change of state or body from outside begins a new run with new logs, so that each log can be repeated from its own
content, with the books of energy and momentum starting at the changed state. Stamps and held commands continue.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from rb_dynamics.body.state import State
from rb_dynamics.errors import ConvergenceError, LogError, RigidBodyError, SceneError
from rb_dynamics.loads.channels import CheckedWrench
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.ros.arrivals import Arrival, Arrivals
from rb_dynamics.ros.health import Health
from rb_dynamics.ros.pacing import ClockFollower, Pacer
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.run.sink import Sink
from rb_dynamics.scene import parse_scene
from rb_dynamics.scene.model import Scene

# How long the node may wait without looking at signals, and compute without looking at messages or signals.
LONGEST_WAIT = 0.05
_LONGEST_BURST_NS = 5_000_000
# A command this far ahead was stamped by another clock, most likely.
_FAR_AHEAD_NS = 10**6 * NANOSECONDS


@dataclass(frozen=True)
class Mode:
    """How time passes: see the node's parameters of the same names."""

    real_time_factor: float = 1.0
    lockstep: bool = False
    start_paused: bool = False
    apply_at: str = "arrival"


class Host(Protocol):
    """What a driver asks of the node around it."""

    def sinks(self) -> Sequence[Sink]:
        """Return what the next run is told to: publishers, and logs of its own."""

    def take_commands(self) -> None:
        """Hand over by `Driver.command` what has come."""


class Driver:
    """One body, paused or on its way; its times are simulation time, its commands' stamps are the users'.

    Attributes:
        simulation: the run, from `start` on.
    """

    simulation: Simulation

    def __init__(self, scene: Scene, mode: Mode, pacer: Pacer | ClockFollower, health: Health, host: Host) -> None:
        """Prepare; `start` begins the first run."""
        self.pacer, self.health, self.lockstep = pacer, health, mode.lockstep
        self._mode, self._host = mode, host
        self._free_running = mode.real_time_factor == 0.0
        self._scene = scene
        self.paused, self.stopped, self._quitting = mode.start_paused, False, False
        # How often steps that were asked for may have been cut short.
        self.interruptions = 0
        self._topics = tuple(channel.topic for channel in scene.channels)

    def start(self) -> None:
        """Begin the first run.

        Raises:
            RigidBodyError: the scene cannot be run.
        """
        self.simulation = Simulation(self._scene, self._host.sinks())
        self._begin(0)

    def quit(self) -> None:
        """Be done, wherever the run is."""
        self._quitting = True

    @property
    def done(self) -> bool:
        """Whether the scene's duration is over, or there was a call of `quit`."""
        return self._quitting or self.simulation.ended

    @property
    def stands_still(self) -> bool:
        """Whether time moves only when it is told to."""
        return self.paused or self.lockstep

    @property
    def behind(self) -> bool:
        """Whether there is something to compute up to where time is to go."""
        return (self._reached_ns < self._goal_ns or self.steps_left > 0) and not self.done

    @property
    def scene(self) -> Scene:
        """The scene, with the state that `reset` leads back to."""
        return self._scene

    def go(self) -> None:
        """Let time pass from here on: what it took to get ready is no lag."""
        self.pacer.restart(self._reached_ns)

    def seconds_until_due(self) -> float:
        """Return how long there is nothing to do but to wait for messages, s."""
        if self.stands_still:
            return 0.0 if self.behind else LONGEST_WAIT
        if self._free_running or self.behind:
            return 0.0
        return min(LONGEST_WAIT, self.pacer.seconds_until(self._next_ns()))

    def tick(self) -> None:
        """Take commands, and advance as far as time, pause and lockstep allow, for one burst.

        Time goes no further than to when that began: a command that comes meanwhile is taken the next time, and still
        acts from when it came.
        """
        due_ns = self._due_ns()
        self._host.take_commands()
        if not self.paused:
            # A lag may have been given up meanwhile.
            self._goal_ns = self._lockstep_limit() if self.lockstep else min(due_ns, self._due_ns())
        if self.steps_left and self._reached_ns >= self._goal_ns:
            self.steps_left -= 1
            self._goal_ns = max(self._goal_ns, self._next_ns())
        self._burst()

    def prepare(self) -> None:
        """Take commands, and compute what is known already, before the next output is due.

        Not where stamps count: a command with an earlier one may still come.
        """
        if self.lockstep or self._mode.apply_at == "stamp":
            self._host.take_commands()
        else:
            self.tick()

    def report(self) -> None:
        """Tell every sink how the run is."""
        state = "stopped" if self.stopped else "paused" if self.paused else "lockstep" if self.lockstep else "running"
        awaited = self._awaited() if state == "lockstep" and not self.behind else ""
        self.simulation.write(self.health.status(self.simulation, self.pacer, state, awaited))

    def pace(self, factor: float) -> None:
        """Go on at another real-time factor; 0 is as fast as possible."""
        self._free_running = factor == 0.0
        if isinstance(self.pacer, Pacer):
            self.pacer.factor = factor or 1.0
        self.pacer.restart(self._reached_ns)

    def pause(self, paused: bool) -> None:
        """Pause or go on."""
        if self.paused and not paused:
            self.pacer.restart(self._reached_ns)
            self.health.went_on()
        self.paused, self.stopped = paused, False
        self._hold_still()

    def step(self, count: int = 1) -> None:
        """Let time go on by `count` output periods more; only where it stands still."""
        self.stopped = False
        self.steps_left += count

    def reset(self) -> str:
        """Begin again with the initial state at time 0, without commands; return what failed, or ""."""
        self.paused, self.stopped = self._mode.start_paused, False
        self._restart(self._scene, 0, carry=False, forget=True)
        return self.health.failure

    def stop(self) -> str:
        """Reset, and stay at time 0; return what failed, or ""."""
        failure = self.reset()
        self.paused = self.stopped = True
        return failure

    def reset_state(self) -> None:
        """Begin a new run with the initial state and without commands; stamps go on."""
        self.catch_up()
        self._restart(self._again({}), self._passed_ns(), carry=False)

    def reset_time(self) -> None:
        """Begin a new run from the state as it is; stamps, the scene's duration and schedules begin again."""
        self.catch_up()
        scene = parse_scene(self._scene.text, self._scene.source, _initial(self.state))
        self._restart(scene, 0, carry=True)

    def catch_up(self) -> None:
        """Go on to now, so that what is changed from outside changes then, and not at the last output."""
        if not (self.stands_still or self._free_running):
            self.tick()

    @property
    def state(self) -> State:
        """The motion at this moment, which may lie between two outputs.

        Raises:
            ConvergenceError: a step could not be solved.
        """
        s = self.simulation.look()
        return State(s.time_ns, s.position_world, s.orientation_xyzw, s.linear_velocity_world, s.angular_velocity_body)

    def stamped(self, time_ns: int) -> int | None:
        """Return what a message about a time of the run is stamped, never 0; None while that is not known."""
        offset_ns = self.pacer.offset_ns
        return None if offset_ns is None else max(1, time_ns + offset_ns)

    @property
    def stamp_ns(self) -> int:
        """What a message about this moment is stamped; never 0."""
        return self.stamped(self.simulation.time_ns) or max(1, self.simulation.time_ns)

    @property
    def shown_time(self) -> str:
        """Simulation time, and what our stamps show then, for a person."""
        return f"simulation time {self.simulation.time_ns / 1e9:.9g} s (header.stamp {self.stamp_ns / 1e9:.9g} s)"

    def set_state(self, state: State) -> None:
        """Begin a new run from `state`; stamps and commands go on.

        Raises:
            SceneError: the state is not valid, or an effect of the scene runs by time.
        """
        self._require_no_schedule(self._scene)
        self.catch_up()
        self._restart(self._again(_initial(state)), self._passed_ns(), carry=True)

    def changed(self, overrides: Mapping[str, object]) -> Scene:
        """Return the scene with `overrides`, checked as a whole; nothing changes yet.

        Raises:
            SceneError: it is not valid, or it cannot be changed while the node runs.
        """
        scene = parse_scene(self._scene.text, self._scene.source, overrides)
        for name in ("world_frame", "body_frame"):
            if getattr(scene.frames, name) != getattr(self._scene.frames, name):
                raise SceneError(f"{name}: cannot be changed while the node runs; start it anew")
        if tuple(channel.topic for channel in scene.channels) != self._topics:
            raise SceneError("wrenches: topics cannot be changed while the node runs; start it anew")
        if not all(name.startswith("initial.") for name in overrides):
            self._require_no_schedule(scene)
            # Whether the method can run it at all.
            Simulation(scene)
        return scene

    def change(self, scene: Scene, initial_only: bool) -> None:
        """Take over a scene from `changed`, where it is another; what `initial` says counts from the next reset on.

        Raises:
            RigidBodyError: it cannot run from the state as it is; nothing has changed.
        """
        before = self._scene
        if replace(scene, text=before.text) == before:
            return
        self._scene = scene
        if initial_only:
            return
        try:
            self._restart(self._again(_initial(self.state)), self._passed_ns(), carry=True)
        except RigidBodyError:
            self._scene = before
            raise

    def command(self, topic: str, wrench: Wrench, age_ns: int = 0) -> None:
        """Take a command: at its stamp where stamps count and it has one, otherwise when it came, `age_ns` ago."""
        offset_ns = self.pacer.offset_ns
        by_stamp = self.lockstep or (self._mode.apply_at == "stamp" and wrench.stamp_ns != 0 and offset_ns is not None)
        stamp_ns = wrench.stamp_ns - (offset_ns or 0)
        time_ns = stamp_ns if by_stamp else max(self._arrived_ns(age_ns), self._latest_ns[topic])
        # A rejected command has spoken too: time does not wait for what will never come.
        self._newest[topic] = max(stamp_ns, self._newest.get(topic) or 0)
        computed_ns = self._computed_ns
        command = self.simulation.check(topic, wrench)
        # A rejected one never acts: none that comes after it is late or left out for its sake.
        classified = by_stamp and command.held is not None
        arrival = self._arrivals[topic].classify(time_ns, computed_ns) if classified else None
        if arrival is Arrival.SUPERSEDED:
            self.health.superseded(topic)
            self.health.warn(
                f"{topic}: a command was left out, as a newer one had taken effect when it came, "
                f"{(computed_ns - time_ns) / 1e9:.9g} s after its stamp"
            )
            return
        if not self._take_command(topic, command, time_ns):
            return
        if not by_stamp:
            self._latest_ns[topic] = time_ns
            if wrench.stamp_ns == 0:
                # Its time is when it came: a stamped one that was to act before it must not undo it.
                self._arrivals[topic].classify(max(time_ns, computed_ns), computed_ns)
        self.health.accepted(topic, arrival)
        if self.lockstep and wrench.stamp_ns == 0 and arrival is Arrival.DUPLICATE:
            self.health.warn(
                f"{topic}: two commands without a stamp, and in lockstep time goes no further than the newest stamp; "
                "stamp each for the output that is to come"
            )
        if arrival is Arrival.LATE:
            self.health.warn(
                f"{topic}: a command came {(computed_ns - time_ns) / 1e9:.9g} s after its stamp and took effect at once"
            )
        if time_ns - computed_ns > _FAR_AHEAD_NS:
            self.health.warn(
                f"{topic}: a command has the header.stamp {wrench.stamp_ns / 1e9:.9g} s, far ahead of ours, "
                f"{(computed_ns + (offset_ns or 0)) / 1e9:.9g} s, expected the time that our stamps show"
            )

    def fail(self, message: str) -> None:
        """Pause, because the motion is no longer what it should be."""
        self.paused = True
        self._hold_still()
        self.health.paused(f"paused at {self.shown_time}, because {message}; ~/reset starts again")

    def _hold_still(self) -> None:
        self._goal_ns = self._reached_ns
        self.steps_left = 0
        self.interruptions += 1

    def _take_command(self, topic: str, command: CheckedWrench, time_ns: int) -> bool:
        """Let a command act from `time_ns` on; return whether it can be honoured."""
        self.simulation.take(command, time_ns)
        if command.held is None:
            self.health.rejected(topic)
            self.health.warn(f"{topic}: rejected: {command.reason}")
        elif command.clipped:
            self.health.clipped(topic)
        return command.held is not None

    def _forget_what_was_taken_back(self) -> None:
        """Reject what seemed good when it was taken."""
        while self.simulation.taken_back:
            rejected = self.simulation.taken_back.pop()
            self.health.taken_back(rejected.topic)
            self.health.warn(f"{rejected.topic}: rejected: {rejected.reason}")

    def _begin(self, before_ns: int) -> None:
        """Start the simulation, so many ns after the last reset."""
        # The newest stamp of each channel that holds time back in lockstep, None before it has spoken; and the latest
        # time at which a command of a channel acts by its arrival: those keep their order.
        self._newest: dict[str, int | None] = {c.topic: None for c in self._scene.channels if not c.optional}
        self._latest_ns = dict.fromkeys(self._topics, 0)
        self._arrivals = {topic: Arrivals() for topic in self._topics}
        # Where time is to go, how far that has been computed, and how much to compute before looking at the clock.
        self._goal_ns = self._reached_ns = 0
        self.steps_left = 0
        self._slice_ns = 1_000_000
        self._before_ns = before_ns
        self.pacer.begin(before_ns)
        self.simulation.start()

    def _restart(self, scene: Scene, before_ns: int, carry: bool, forget: bool = False) -> None:
        """End the run and begin another, as many ns after the last reset; on failure nothing has changed.

        `carry` lets the commands that are held or wait act on, their timeouts counted anew; `forget` clears the health
        of the run that ends, the failure of a log to end included.
        """
        ended_ns, newest, latest = self._computed_ns, self._newest, self._latest_ns
        outstanding = self.simulation.outstanding() if carry else []
        simulation = Simulation(scene, self._host.sinks())
        self.simulation.finish()
        if forget:
            self.health.clear()
            self.pacer.clear()
        self.simulation = simulation
        self._begin(before_ns)
        if not carry:
            return
        self._newest = {topic: None if ns is None else ns - ended_ns for topic, ns in newest.items()}
        self._latest_ns = {topic: max(0, ns - ended_ns) for topic, ns in latest.items()}
        for topic, wrench, time_ns in outstanding:
            self._take_command(topic, self.simulation.check(topic, wrench), time_ns)

    def _again(self, overrides: dict[str, object]) -> Scene:
        """Return the scene with `overrides` and with what is left of its duration."""
        scene = self._scene
        if scene.end_ns is not None:
            overrides = overrides | {"duration": max(1, scene.end_ns - self._passed_ns()) / NANOSECONDS}
        return parse_scene(scene.text, scene.source, overrides) if overrides else scene

    def _passed_ns(self) -> int:
        """Return how long ago the last reset was, in simulation time."""
        return self._before_ns + self._computed_ns

    @property
    def _computed_ns(self) -> int:
        """How far the motion is known: commands act from there on."""
        return max(self.simulation.time_ns, self._reached_ns)

    def _require_no_schedule(self, scene: Scene) -> None:
        acting = scene.combined_effects
        if any(acting.knots()) or any(time for _, entries in acting.schedules() for time, _ in entries):
            raise SceneError(
                "effects: one of them runs by a schedule, whose time would begin again; state and body can only be "
                "changed without it, or in the scene file"
            )

    def _arrived_ns(self, age_ns: int) -> int:
        """Return the simulation time `age_ns` ago, which may lie between two outputs, but not before the last."""
        if self.stands_still or self._free_running:
            return self.simulation.time_ns
        # A lag that is given up is given up before a command gets its time from it.
        return max(self.simulation.time_ns, self._due_ns() - self.pacer.since(max(0, age_ns)))

    def _due_ns(self) -> int:
        """Return how far time should have gone now, where it passes by itself."""
        if self.stands_still:
            return self._goal_ns
        return self._next_ns() if self._free_running else self.pacer.due_ns(self._next_look_ns())

    def _next_ns(self) -> int:
        """Return when there is something to do next: an output or the end of the scene."""
        output = self.simulation.next_output_ns()
        return output if self.simulation.end_ns is None else min(output, self.simulation.end_ns)

    def _next_look_ns(self) -> int:
        """Return how far time may go before the clock is looked at again; what it is beyond that is a lag.

        An output may be far away: what is not computed until then is a lag before.
        """
        return min(self._next_ns(), self._reached_ns + self.pacer.since(round(LONGEST_WAIT * NANOSECONDS)))

    def _lockstep_limit(self) -> int:
        """Return the smallest of the channels' newest stamps; no further may time advance."""
        stamps = (-1 if stamp is None else stamp for stamp in self._newest.values())
        return max(self._goal_ns, min(stamps, default=-1))

    def _awaited(self) -> str:
        """Return what lockstep waits for, in the users' stamps."""
        oldest = min(self._newest, key=lambda topic: self._newest[topic] or -1, default="")
        newest_ns = self._newest.get(oldest)
        if newest_ns is None:
            return f", waits for the first command on {oldest}" if oldest else ""
        seconds = (newest_ns + (self.pacer.offset_ns or 0)) / NANOSECONDS
        return f", waits for a command on {oldest} with a header.stamp later than {seconds:.9f} s"

    def _burst(self) -> None:
        """Advance towards the goal until a few milliseconds have passed; how it is cut up changes nothing."""
        begun = now = time.monotonic_ns()
        while True:
            until = min(self._goal_ns, self._reached_ns + self._slice_ns)
            try:
                self.simulation.advance(until)
            except (ConvergenceError, LogError, OverflowError) as error:
                # A log stops itself alone: the error of one here is that of a stamp that no message can hold.
                self.fail(f"the motion cannot be continued: {error}")
                return
            finally:
                self._forget_what_was_taken_back()
            whole_slice = until - self._reached_ns == self._slice_ns
            self._reached_ns = max(self._reached_ns, until)
            before, now = now, time.monotonic_ns()
            # Only a whole slice tells what a slice costs: that nothing costs nothing is no reason to take more.
            if whole_slice and now - before < _LONGEST_BURST_NS // 8:
                self._slice_ns = min(2 * self._slice_ns, NANOSECONDS)
            elif now - before > _LONGEST_BURST_NS // 2:
                self._slice_ns = max(1, self._slice_ns // 2)
            if not self.behind or now - begun > _LONGEST_BURST_NS:
                return


def _initial(state: State) -> dict[str, object]:
    """Return the overrides of a scene that make `state` its initial one."""
    return {
        "initial.position_world": state.position_world,
        "initial.orientation": dict(zip("xyzw", state.orientation_xyzw, strict=True)),
        "initial.linear_velocity_world": state.linear_velocity_world,
        "initial.angular_velocity_body": state.angular_velocity_body,
    }
