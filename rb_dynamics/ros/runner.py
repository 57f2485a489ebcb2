"""`Runner`: paces the simulation: decides when it advances, and restarts it when it is changed. Must not import ROS.

A change of the body from outside begins a new run with new logs, so that each log can be replayed from its own content;
balances start again there. Stamps and held commands continue. A change of state is an event of the run.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import coroutine
from typing import Protocol

from rb_dynamics.body.state import State
from rb_dynamics.errors import ConvergenceError, LogError, RigidBodyError, SceneError, WrenchError
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.loads.wrench_channels import CheckedWrench
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, seconds_text
from rb_dynamics.ros.command_statistics import Arrival, Arrivals
from rb_dynamics.ros.health import Health
from rb_dynamics.ros.pacing import ClockFollower, Pacer
from rb_dynamics.run.scene_remarks import STREAM, nutation_rate, too_slow
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.run.sink import Epoch, Latency, Sink, StateChange
from rb_dynamics.scene import parse_scene
from rb_dynamics.scene.model import Scene

# How long the node may wait without checking signals, and compute without checking messages or signals.
LONGEST_WAIT = 0.05
_LONGEST_BURST_NS = 5_000_000
# A command this far from our time was most likely stamped by another clock.
_FAR_NS = 10**6 * NANOSECONDS
# Seconds after which a wait is reported: a slow commander is not worth a line each time.
_LONG_WAIT = 3


@dataclass(frozen=True)
class Mode:
    """Time control; see the node's parameters of the same names."""

    real_time_factor: float = 1.0
    lockstep: bool = False
    start_paused: bool = False
    apply_at: str = "arrival"
    log_latency: bool = False
    deadline_ns: int = 0


class Host(Protocol):
    """What a runner needs from the node around it."""

    def sinks(self) -> Sequence[Sink]:
        """Return the sinks of the next run: publishers, and new logs."""

    def take_commands(self) -> None:
        """Pass waiting commands to `Runner.command`."""


class Runner:
    """One body and its simulation time; the stamps of its commands are in the time of those who send them.

    Attributes:
        simulation: the run, from `start` on.
    """

    simulation: Simulation

    def __init__(self, scene: Scene, mode: Mode, pacer: Pacer | ClockFollower, health: Health, host: Host) -> None:
        """Prepare; `open` and `start` begin the first run."""
        self.pacer, self.health, self.lockstep = pacer, health, mode.lockstep
        self._mode, self._host = mode, host
        self._free_running = mode.real_time_factor == 0.0
        self._scene = scene
        self.paused, self.stopped, self._quitting = mode.start_paused, False, False
        self._begun = False
        # Number of events that may have interrupted requested steps.
        self.interruptions = 0
        # Number of callers that wait for steps.
        self._callers = 0
        self._topics = tuple(channel.topic for channel in scene.channels)
        # What time waits for, and for how many seconds it has.
        self._wait, self._waited = "", 0

    def open(self) -> None:
        """Prepare the first run and open its logs.

        Raises:
            RigidBodyError: the scene cannot be run.
        """
        self.simulation = Simulation(self._scene, self._host.sinks())
        self._clear(0)
        self.simulation.open()

    def start(self) -> None:
        """Begin the first run: time passes from here, after all preparation, and the initial state is stamped now.

        In an executor of the user, a reset or a new state may come before: then that run goes on.
        """
        if self._begun:
            self.go()
        else:
            self._begin(0)

    def _begin(self, before_ns: int) -> None:
        self._begun = True
        self.pacer.begin(before_ns)
        self.simulation.start()

    def quit(self) -> None:
        """End, at any point of the run."""
        self._quitting = True

    @property
    def done(self) -> bool:
        """Whether the scene's duration is over, or `quit` was called."""
        return self._quitting or self.simulation.ended

    @property
    def stands_still(self) -> bool:
        """Whether time advances only on request."""
        return self.paused or self.lockstep

    @property
    def paced(self) -> bool:
        """Whether time advances like a clock."""
        return not (self.stands_still or self._free_running)

    @property
    def behind(self) -> bool:
        """Whether there is something to compute before the present time."""
        return (self.simulation.computed_ns < self._goal_ns or self.steps_left > 0) and not self.done

    @property
    def unanswered(self) -> bool:
        """Whether callers wait for steps that are computed."""
        return self._callers > 0 and not self.behind

    @property
    def scene(self) -> Scene:
        """The scene, with the state that `reset` restores."""
        return self._scene

    def every_second(self) -> None:
        """Let stamps follow ROS time if that was set anew, and report wheels near their limit and long waits.

        A wait for commands or a clock is reported once.
        """
        self.health.hold_wheels(self.simulation)
        self._nutation = nutation_rate(self.simulation.scene, self.simulation.sample)
        if isinstance(self.pacer, Pacer) and self.paced:
            self.pacer.correct()
        wait = ""
        if not (self.paused or self.behind or self.done):
            wait = self._awaited() if self.lockstep else self.pacer.warning() if self.pacer.offset_ns is None else ""
        self._waited = self._waited + 1 if wait == self._wait else 0
        self._wait = wait
        if wait and self._waited == _LONG_WAIT:
            hint = "; stamp each for the next output: under our /clock now() is not later than the newest state"
            told = f"lockstep{wait}{hint if self._newest and None not in self._newest.values() else ''}"
            self.health.told(told if self.lockstep else wait)

    def go(self) -> None:
        """Pace from here: the time until now, a pause, passed without the body and is not a lag."""
        offset_ns = self.pacer.offset_ns
        self.pacer.restart(self.simulation.computed_ns)
        self._keep_to_stamps(offset_ns)

    def seconds_until_due(self) -> float:
        """Return for how long there is nothing to do except wait for messages, s."""
        if self.stands_still:
            return 0.0 if self.behind else LONGEST_WAIT
        if self._free_running or self.behind:
            return 0.0
        return min(LONGEST_WAIT, self.pacer.seconds_until(self._next_ns()))

    def tick(self) -> None:
        """Take commands, and advance for one burst as far as time, pause and lockstep allow.

        Time advances at most to the time at which the burst began: a command that arrives meanwhile is taken in the
        next burst and still acts from its arrival.
        """
        due_ns = self._due_ns()
        self._tell_epoch()
        self._host.take_commands()
        if not self.paused:
            # The pacer may have given up a lag meanwhile.
            self._goal_ns = self._lockstep_limit() if self.lockstep else min(due_ns, self._due_ns())
        if self.steps_left and self.simulation.computed_ns >= self._goal_ns:
            self.steps_left -= 1
            self._goal_ns = max(self._goal_ns, self._within(self.simulation.next_output_ns()))
        self._burst()

    def prepare(self) -> None:
        """Take commands and compute what is already determined, before the next output is due.

        Not if stamps count, as a command with an earlier stamp may still arrive.
        """
        if self.lockstep or self._mode.apply_at == "stamp":
            # Stamps are those of the present clock.
            self._due_ns()
            self._host.take_commands()
        else:
            self.tick()

    def report(self) -> None:
        """Send the status to every sink."""
        state = "stopped" if self.stopped else "paused" if self.paused else "lockstep" if self.lockstep else "running"
        awaited = self._awaited() if state == "lockstep" and not self.behind else ""
        self.simulation.write(self.health.status(self.simulation, self.pacer, state, awaited))

    def pace(self, factor: float) -> None:
        """Change the real-time factor; 0 is as fast as possible."""
        self._free_running = factor == 0.0
        if isinstance(self.pacer, Pacer):
            self.pacer.factor = factor or 1.0
        self.go()

    def _keep_to_stamps(self, before_ns: int | None) -> None:
        """Let the commands that wait act at their stamps, which were `before_ns` ahead until time was lost."""
        offset_ns = self.pacer.offset_ns
        if not self.lockstep and before_ns is not None and offset_ns is not None:
            self._hasten(offset_ns - before_ns)

    def _hasten(self, by_ns: int | None, run: Simulation | None = None) -> None:
        """Let commands that wait for their stamps act so much earlier, or never (None), where their time is over."""
        if self._mode.apply_at != "stamp" or by_ns == 0:
            return
        for arrivals in self._arrivals.values():
            arrivals.hasten(by_ns)
        for topic in (run or self.simulation).hasten(by_ns):
            self.health.overtaken(topic)

    def pause(self, paused: bool) -> None:
        """Pause or continue."""
        if self.paused and not paused:
            self.go()
            self.health.went_on()
        if self.paused != paused:
            self.health.told(f"{'paused' if paused else 'goes on'} at {self.shown_time}")
        self.paused, self.stopped = paused, False
        self._hold_still()

    def step(self, count: int = 1) -> None:
        """Let time advance by `count` more output periods; only while it is paused or in lockstep."""
        self.stopped = False
        self.steps_left += count

    async def stepped(self, count: int = 1) -> str:
        """Let time advance as `step` does; when that is done, return why it was not, or ""."""
        before, interruptions = self.simulation, self.interruptions
        self.step(count)
        self._callers += 1
        await self._until_stepped()
        self._callers -= 1
        if self.simulation is not before:
            return "the simulation was reset meanwhile"
        if self.interruptions != interruptions:
            return self.health.failure or "paused or resumed meanwhile"
        return "the run is over; ~/reset starts again" if self.steps_left else ""

    @coroutine
    def _until_stepped(self) -> Generator[None, None, None]:
        """Let a callback wait, between turns of the executor, until the steps asked for are computed."""
        while self.steps_left and self.behind:
            yield
        goal_ns = self._goal_ns
        while self.simulation.computed_ns < goal_ns and self.behind:
            yield

    def reset(self) -> str:
        """Restart with the initial state at time 0, without commands; return the error, or ""."""
        self.paused, self.stopped = self._mode.start_paused, False
        before = self.shown_time
        self._restart(self._scene, 0, carry=False, forget=True)
        self.health.told(f"reset at {before}{', paused' if self.paused else ''}")
        return self.health.failure

    def stop(self) -> str:
        """Reset, and stay at time 0; return the error, or ""."""
        failure = self.reset()
        self.paused = self.stopped = True
        return failure

    def reset_state(self) -> None:
        """Begin a new run with the initial state and without commands; stamps continue."""
        self.catch_up()
        self._restart(self._again(self._scene, {}), self._passed_ns(), carry=False)

    def reset_time(self) -> None:
        """Begin a new run from the present state; stamps, the scene's duration and schedules start again."""
        self.catch_up()
        scene = parse_scene(self._scene.text, self._scene.source, _initial(self.state))
        self._restart(scene, 0, carry=True)

    def catch_up(self) -> None:
        """Advance to now, so that a change from outside acts now and not at the last output."""
        if not self._begun:
            self.start()
        if self.paced:
            self.tick()

    @property
    def state(self) -> State:
        """The present motion, possibly between two outputs.

        Raises:
            ConvergenceError: a step could not be solved.
        """
        s = self.simulation.look()
        return State(s.time_ns, s.position_world, s.orientation_xyzw, s.linear_velocity_world, s.angular_velocity_body)

    def stamped(self, time_ns: int) -> int | None:
        """Return the stamp for a time of the run, never 0; None while it is unknown."""
        offset_ns = self.pacer.offset_ns
        return None if offset_ns is None else max(1, time_ns + offset_ns)

    @property
    def stamp_ns(self) -> int:
        """The stamp for the present time; never 0."""
        return self.stamped(self.simulation.time_ns) or max(1, self.simulation.time_ns)

    @property
    def shown_time(self) -> str:
        """Simulation time and the corresponding stamp, as text."""
        return f"simulation time {self.simulation.time_ns / 1e9:.9g} s (header.stamp {seconds_text(self.stamp_ns)} s)"

    def set_state(self, state: State) -> None:
        """Move the body to `state` now; the run, its commands and its log continue.

        Raises:
            SceneError: the state is not valid.
            ConvergenceError: the motion cannot continue from there; the body was not moved.
        """
        change = StateChange.to(state, self._scene.body)
        self.catch_up()
        self.simulation.move(change)

    def changed(self, overrides: Mapping[str, object]) -> Scene:
        """Return the scene with `overrides`, validated as a whole; nothing changes yet.

        Raises:
            SceneError: it is not valid, or it cannot be changed while the node runs.
        """
        scene = parse_scene(self._scene.text, self._scene.source, overrides)
        for name in ("world_frame", "body_frame"):
            if getattr(scene.frames, name) != getattr(self._scene.frames, name):
                raise SceneError(f"{name}: cannot be changed while the node runs; start it anew")
        if tuple(channel.topic for channel in scene.channels) != self._topics:
            raise SceneError("wrenches: topics cannot be changed while the node runs; start it anew")
        if [(a.topic, a.kind) for a in scene.actuators] != [(a.topic, a.kind) for a in self._scene.actuators]:
            raise SceneError("actuators: they cannot be changed while the node runs; start it anew")
        if [(s.name, s.message) for s in scene.sensors] != [(s.name, s.message) for s in self._scene.sensors]:
            raise SceneError("sensors: what they publish cannot be changed while the node runs; start it anew")
        if not all(name.startswith("initial.") for name in overrides):
            self._require_no_schedule(scene)
        # Check that the method can run it.
        _require_steps(Simulation(scene))
        return scene

    def rehearse(self, scene: Scene | None, state: State | None) -> StateChange | None:
        """Return the change to `state` now, after that to `scene`, if the motion can continue; nothing changes yet.

        Raises:
            SceneError: the state is not valid.
            ConvergenceError: the motion cannot continue.
        """
        run, body = self.simulation, (scene or self._scene).body
        change = None if state is None else StateChange.to(state, body)
        if scene is not None and self._differs(scene):
            run = Simulation(self._again(scene, _initial(self.state)))
            for topic, wrench, time_ns in self.simulation.outstanding():
                run.take(run.check(topic, wrench), time_ns)
            run.advance(0)
        if scene is not None or change is not None:
            _require_steps(run, change)
        return change

    def change(self, scene: Scene, initial_only: bool) -> None:
        """Apply a scene from `changed`, if it differs; its `initial` applies from the next reset on.

        Raises:
            RigidBodyError: the scene cannot run from the present state; nothing has changed.
        """
        if not self._differs(scene):
            return
        before, self._scene = self._scene, scene
        if initial_only:
            return
        try:
            self._restart(self._again(scene, _initial(self.state)), self._passed_ns(), carry=True)
        except RigidBodyError:
            self._scene = before
            raise

    def _differs(self, scene: Scene) -> bool:
        return replace(scene, text=self._scene.text) != self._scene

    @property
    def times_commands(self) -> bool:
        """Whether `command` needs the time at which a command was sent."""
        return self._mode.log_latency or self._mode.deadline_ns > 0

    def command(self, topic: str, wrench: Wrench, age_ns: int = 0, sent: tuple[int, int, int] | None = None) -> None:
        """Take a command: at its stamp if stamps count and it has one, otherwise at its arrival `age_ns` ago.

        `sent` is ROS time at which it was sent and came (ns), and its sequence number, if latencies matter.
        """
        # Once: the clock goes on while the command is taken.
        arrived_ns = self._arrived_ns(age_ns)
        offset_ns = self.pacer.offset_ns
        by_stamp = self.lockstep or (self._mode.apply_at == "stamp" and wrench.stamp_ns != 0 and offset_ns is not None)
        stamp_ns = wrench.stamp_ns - (offset_ns or 0)
        time_ns = stamp_ns if by_stamp else max(arrived_ns, self._latest_ns[topic])
        if by_stamp and isinstance(self.pacer, ClockFollower) and self.pacer.is_over(wrench.stamp_ns):
            self.health.superseded(topic)
            self.health.warn(
                f"{topic}: a command was ignored because its stamp, {seconds_text(wrench.stamp_ns)} s, is of the "
                "time before the clock jumped back"
            )
            return
        # A rejected command counts for lockstep: time must not wait for one that will never act.
        self._newest[topic] = max(stamp_ns, self._newest.get(topic) or 0)
        computed_ns = self.simulation.computed_ns
        command = self.simulation.check(topic, wrench)
        # A rejected command never acts, so no later one is late or superseded because of it.
        classified = by_stamp and command.held is not None
        arrival = self._arrivals[topic].classify(time_ns, computed_ns) if classified else None
        if arrival is Arrival.SUPERSEDED:
            self.health.superseded(topic)
            self.health.warn(
                f"{topic}: a command was ignored because a newer one had already taken effect, "
                f"{(computed_ns - time_ns) / 1e9:.9g} s after its stamp"
            )
            return
        if not self._take_command(topic, command, time_ns):
            return
        if not by_stamp:
            self._latest_ns[topic] = time_ns
            if wrench.stamp_ns == 0:
                # It acts at its arrival: a stamped one for an earlier time must not undo it.
                self._arrivals[topic].classify(max(time_ns, computed_ns), computed_ns)
        self.health.accepted(topic, arrival)
        self._pace(topic, time_ns)
        if sent is not None:
            self._time(topic, sent, max(time_ns, computed_ns) - arrived_ns)
        if self.lockstep and wrench.stamp_ns == 0 and arrival is Arrival.DUPLICATE:
            self.health.warn(
                f"{topic}: two commands without a stamp; in lockstep time advances only to the newest stamp, so stamp "
                "each for the next output"
            )
        if by_stamp and abs(time_ns - computed_ns) > _FAR_NS:
            self.health.warn(
                f"{topic}: a command has the header.stamp {seconds_text(wrench.stamp_ns)} s, far "
                f"{'ahead of' if time_ns > computed_ns else 'behind'} ours, "
                f"{seconds_text(computed_ns + (offset_ns or 0))} s, expected the time that our stamps show: either its "
                "sender has use_sim_time and follows the same /clock (publish_clock:=true here), or it has not and our "
                "stamps are ROS time (stamps:=ros here)"
            )
        elif arrival is Arrival.LATE:
            self.health.warn(
                f"{topic}: a command came {(computed_ns - time_ns) / 1e9:.9g} s after its stamp and took effect at "
                "once; stamp it further ahead, such as by one output period"
            )

    def _time(self, topic: str, sent: tuple[int, int, int], waits_ns: int) -> None:
        """Log the latency of a command, and check it against the deadline."""
        sent_ns, received_ns, number = sent
        factor = self.pacer.factor if isinstance(self.pacer, Pacer) else 1.0
        latency = Latency(
            self.simulation.time_ns, topic, sent_ns, received_ns, received_ns + round(waits_ns / factor), number
        )
        if self._mode.log_latency:
            self.simulation.write(latency)
        late_ns = latency.acted_ns - sent_ns - self._mode.deadline_ns
        if late_ns > 0 and self._mode.deadline_ns:
            self.health.missed(topic)
            self.health.warn(f"{topic}: a command missed its deadline by {late_ns / 1e6:.3f} ms")

    def actuate(self, topic: str, value: float, age_ns: int = 0) -> None:
        """Take a command to an actuator, which has no stamp: at its arrival `age_ns` ago."""
        time_ns = max(self._arrived_ns(age_ns), self._latest_ns[topic])
        try:
            clipped = self.simulation.actuate(topic, value, time_ns)
        except WrenchError as error:
            self.health.rejected(topic)
            self.health.warn(f"{topic}: rejected: {error}")
            return
        self._latest_ns[topic] = time_ns
        self.health.accepted(topic, None)
        self._pace(topic, time_ns)
        if clipped:
            self.health.clipped(topic)

    def _pace(self, topic: str, time_ns: int) -> None:
        """Warn of a stream of commands, the newest at `time_ns`, that is slower than the body turns or nutates."""
        last_ns, slow = self._paces.get(topic, (time_ns, 0))
        remarks = too_slow(topic, self.simulation.rate, self._nutation, (time_ns - last_ns) / NANOSECONDS)
        slow = slow + 1 if remarks else 0
        self._paces[topic] = time_ns, slow
        if slow == STREAM:
            self.health.warn(remarks[0])

    def fail(self, message: str) -> None:
        """Pause because of an error."""
        self.paused = True
        self._hold_still()
        self.health.paused(f"paused at {self.shown_time}, because {message}; ~/reset starts again")

    def _hold_still(self) -> None:
        self._goal_ns = self.simulation.computed_ns
        self.steps_left = 0
        self.interruptions += 1

    def _take_command(self, topic: str, command: CheckedWrench, time_ns: int) -> bool:
        """Let a command act from `time_ns` on; return whether it was accepted."""
        self.simulation.take(command, time_ns)
        if command.held is None:
            self.health.rejected(topic)
            self.health.warn(f"{topic}: rejected: {command.reason}")
        elif command.clipped:
            self.health.clipped(topic)
        return command.held is not None

    def _forget_what_was_taken_back(self) -> None:
        """Reject commands that were accepted at first."""
        while self.simulation.taken_back:
            rejected = self.simulation.taken_back.pop()
            self.health.taken_back(rejected.topic)
            self.health.warn(f"{rejected.topic}: rejected: {rejected.reason}")

    def _clear(self, before_ns: int) -> None:
        """Forget the run before; the next begins this many ns after the last reset."""
        # Newest stamp of each channel that lockstep waits for (None before its first command), and the latest time at
        # which a command of each channel acts by its arrival: these keep their order.
        self._newest: dict[str, int | None] = {c.topic: None for c in self._scene.channels if not c.optional}
        self._latest_ns = dict.fromkeys((*self._topics, *(each.topic for each in self._scene.actuators)), 0)
        self._arrivals = {topic: Arrivals() for topic in self._topics}
        # Time of the newest command, and how many in a row came too late for how fast the body turns or nutates, rad/s.
        self._paces: dict[str, tuple[int, int]] = {}
        self._nutation = nutation_rate(self.simulation.scene, self.simulation.sample)
        # Time to advance to, and how much to compute before checking the clock.
        self._goal_ns = 0
        self.steps_left = 0
        self._slice_ns = 1_000_000
        self._before_ns = before_ns
        # Stamps that are simulation time count from the last reset: nothing to report.
        self._told_ns: int | None = before_ns

    def _restart(self, scene: Scene, before_ns: int, carry: bool, forget: bool = False) -> None:
        """End the run and begin another, this many ns after the last reset; on failure nothing has changed.

        With `carry`, held and waiting commands continue, with their timeouts counted anew; with `forget`, the health of
        the old run is cleared, including a failure to close its log.
        """
        ended, newest, latest, arrivals = self.simulation, self._newest, self._latest_ns, self._arrivals
        simulation = Simulation(scene, self._host.sinks())
        ended.finish()
        jumped_ns: int | None = 0
        if isinstance(self.pacer, ClockFollower):
            self.pacer.due_ns(0)
            jumped_ns = self.pacer.jump()
        ended_ns, offset_ns = ended.computed_ns, self.pacer.offset_ns
        if forget:
            self.health.clear()
            self.pacer.clear()
        self.simulation = simulation
        self._clear(before_ns)
        self._begin(before_ns)
        if not carry:
            return
        self._newest = {topic: None if ns is None else ns - ended_ns for topic, ns in newest.items()}
        self._latest_ns = {topic: max(0, ns - ended_ns) for topic, ns in latest.items()}
        self._arrivals = arrivals
        by_ns: int | None = 0
        # Stamps in simulation time go on, or start again, with the run; any other clock went on meanwhile.
        if offset_ns is not None and self.pacer.offset_ns not in (None, before_ns):
            by_ns = None if jumped_ns is None else self.pacer.offset_ns - offset_ns - ended_ns + jumped_ns
        self._hasten(by_ns, ended)
        for each in arrivals.values():
            each.hasten(ended_ns)
        for topic, wrench, time_ns in ended.outstanding():
            self._take_command(topic, self.simulation.check(topic, wrench), time_ns)
        if not self.lockstep:
            # What is held acts, and waits for no stamp.
            self.simulation.advance(0)

    def _again(self, scene: Scene, overrides: dict[str, object]) -> Scene:
        """Return `scene` with `overrides` and the rest of its duration."""
        if scene.end_ns is not None:
            overrides = overrides | {"duration": max(1, scene.end_ns - self._passed_ns()) / NANOSECONDS}
        return parse_scene(scene.text, scene.source, overrides) if overrides else scene

    def _passed_ns(self) -> int:
        """Return the simulation time since the last reset."""
        return self._before_ns + self.simulation.computed_ns

    def _require_no_schedule(self, scene: Scene) -> None:
        if scene.actuators:
            raise SceneError(
                "actuators: what they do now would start again; change state and body in the scene file, and start the "
                "node anew"
            )
        acting = scene.combined_effects
        if any(acting.knots()) or any(time for _, entries in acting.schedules() for time, _ in entries):
            raise SceneError(
                "effects: one of them has a schedule, which would start again; change state and body in the scene "
                "file, or without that effect"
            )

    def _arrived_ns(self, age_ns: int) -> int:
        """Return the simulation time `age_ns` ago, possibly between two outputs, but not before the last."""
        if not self.paced:
            return self.simulation.time_ns
        # Drop a lag before it determines the time of a command.
        return max(self.simulation.time_ns, self._due_ns() - self.pacer.since(max(0, age_ns)))

    def _due_ns(self) -> int:
        """Return the simulation time that corresponds to now."""
        if self.stands_still:
            return self._goal_ns
        if self._free_running:
            return self._next_ns()
        offset_ns = self.pacer.offset_ns
        due_ns = self.pacer.due_ns(self._next_look_ns())
        if isinstance(self.pacer, Pacer):
            self._keep_to_stamps(offset_ns)
        else:
            self._hasten(self.pacer.jump())
        return due_ns

    def _next_ns(self) -> int:
        """Return the next time of an output, a measurement or the end of the scene."""
        return self._within(self.simulation.next_event_ns())

    def _within(self, time_ns: int) -> int:
        return time_ns if self.simulation.end_ns is None else min(time_ns, self.simulation.end_ns)

    def _next_look_ns(self) -> int:
        """Return how far time may advance before the clock is read again; beyond that there is a lag.

        The next output may be far away, and a lag must be noticed before it.
        """
        return min(self._next_ns(), self.simulation.computed_ns + self.pacer.since(round(LONGEST_WAIT * NANOSECONDS)))

    def _lockstep_limit(self) -> int:
        """Return the smallest of the channels' newest stamps, the limit of time in lockstep."""
        stamps = (-1 if stamp is None else stamp for stamp in self._newest.values())
        return max(self._goal_ns, min(stamps, default=-1))

    def _awaited(self) -> str:
        """Return what lockstep waits for, in terms of stamps."""
        if not self._newest:
            channels = " or ".join(channel.topic for channel in self._scene.channels)
            by = f"a command on {channels}" if channels else "~/step: the scene has no wrench channel to move time"
            return f", waits for {by}"
        oldest = min(self._newest, key=lambda topic: self._newest[topic] or -1)
        newest_ns = self._newest[oldest]
        if newest_ns is None:
            return f", waits for the first command on {oldest}"
        seconds = seconds_text(newest_ns + (self.pacer.offset_ns or 0))
        return f", waits for a command on {oldest} with a header.stamp later than {seconds} s"

    def _tell_epoch(self) -> None:
        """Report to the sinks how far stamps are ahead of simulation time, if that has changed."""
        if self.pacer.offset_ns != self._told_ns and self.pacer.offset_ns is not None:
            self._told_ns = self.pacer.offset_ns
            self.simulation.write(Epoch(self.simulation.computed_ns, self._told_ns))

    def _burst(self) -> None:
        """Advance towards the goal for a few milliseconds; how time is divided does not change the motion."""
        begun = now = time.monotonic_ns()
        while True:
            before_ns = self.simulation.computed_ns
            until = min(self._goal_ns, before_ns + self._slice_ns)
            try:
                # A command in it may make the rest of a slice cost any amount of time.
                self.simulation.advance(until, lambda: time.monotonic_ns() - begun > _LONGEST_BURST_NS)
            except (ConvergenceError, LogError, OverflowError) as error:
                # A log that fails stops on its own; an error here is a stamp that no message can hold.
                self.fail(f"the motion cannot be continued: {error}")
                return
            finally:
                self._forget_what_was_taken_back()
            whole_slice = self.simulation.computed_ns - before_ns == self._slice_ns
            before, now = now, time.monotonic_ns()
            # Measure the cost by whole slices only: an empty one says nothing.
            if whole_slice and now - before < _LONGEST_BURST_NS // 8:
                self._slice_ns = min(2 * self._slice_ns, NANOSECONDS)
            elif now - before > _LONGEST_BURST_NS // 2:
                self._slice_ns = max(1, self._slice_ns // 2)
            if not self.behind or now - begun > _LONGEST_BURST_NS:
                return


def _require_steps(run: Simulation, change: StateChange | None = None) -> None:
    if reason := run.hindrance(change):
        raise ConvergenceError(f"the motion cannot continue from there: {reason}")


def _initial(state: State) -> dict[str, object]:
    """Return the overrides of a scene that make `state` its initial state."""
    return {
        "initial.position_world": state.position_world,
        "initial.orientation": dict(zip("xyzw", state.orientation_xyzw, strict=True)),
        "initial.linear_velocity_world": state.linear_velocity_world,
        "initial.angular_velocity_body": state.angular_velocity_body,
    }
