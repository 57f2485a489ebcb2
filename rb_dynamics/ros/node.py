"""The ROS 2 node: decides when the simulation advances; what happens then is the loop's.

One thread does everything: it waits for messages until the next output is due, then advances, a few milliseconds at a
time, so that neither messages nor signals wait for the physics. Steady time paces it; no jump of a ROS clock can.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from std_srvs.srv import SetBool, Trigger

from rb_dynamics.errors import ConvergenceError, RigidBodyError, WrenchError
from rb_dynamics.recording.guard import GuardedSink
from rb_dynamics.recording.sink import Sink
from rb_dynamics.ros import conversions
from rb_dynamics.ros.health import Health
from rb_dynamics.ros.pacing import Pacer
from rb_dynamics.ros.publishers import TopicSink
from rb_dynamics.ros.settings import read_settings
from rb_dynamics.simulate import Simulation

_NANOSECONDS = 1_000_000_000
# How long the node may wait without looking at signals, and compute without looking at messages or signals.
_LONGEST_WAIT = 0.05
_LONGEST_BURST_NS = 5_000_000
# How many waiting commands of a channel are taken at once.
_LARGEST_BATCH = 1000
# A command this far ahead in lockstep was stamped by another clock, most likely.
_FAR_AHEAD_NS = 10**6 * _NANOSECONDS


class RigidBodyNode(Node):
    """Simulates the body of a scene and speaks ROS 2; topics, parameters and services are listed in the README."""

    def __init__(self, **kwargs: object) -> None:
        """Read the parameters and the scene, and start the run; keyword arguments go to `rclpy.node.Node`.

        Raises:
            RigidBodyError: a parameter, the scene or a log file is not valid.
        """
        super().__init__("rigid_body", **kwargs)
        self._settings = settings = read_settings(self)
        self._scene = settings.scene
        self._topics = [channel.topic for channel in self._scene.channels]
        self._paused = settings.start_paused
        self._free_running = settings.real_time_factor == 0.0
        self._pacer = Pacer(settings.real_time_factor or 1.0)
        self._health = Health(self.get_fully_qualified_name(), self._topics)
        self._publishers_sink = TopicSink(self, self._scene.frames, settings.publish_clock, self._stands_still)
        self._runs = 0
        logs = self._open_logs()
        self._simulation = self._begin(logs)
        for log in logs:
            # A log that cannot even be opened is a mistake of whoever asked for it; later it only stops the log.
            if log.error:
                raise log.error
        if self._scene.acting.potential() is not None:
            self._publishers_sink.add_potential()
        if settings.publish_accel:
            self._publishers_sink.add_acceleration(lambda: self._simulation.acceleration)
        self._wrench_subscriptions = {topic: self._subscribe(topic) for topic in self._topics}
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/step", self._on_step)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.get_logger().info(self._introduction())

    @property
    def done(self) -> bool:
        """Whether the scene's duration is over."""
        return self._simulation.ended

    def seconds_until_due(self) -> float:
        """Return how long there is nothing to do but to wait for messages, s."""
        if self._stands_still():
            return 0.0 if self._behind() else _LONGEST_WAIT
        if self._free_running or self._behind():
            return 0.0
        return min(_LONGEST_WAIT, self._pacer.seconds_until(self._next_ns()))

    def tick(self) -> None:
        """Advance as far as time, pause and lockstep allow, for one burst, and publish diagnostics once a second."""
        if not self._paused:
            if self._settings.lockstep:
                self._goal_ns = self._lockstep_limit()
            elif self._free_running:
                self._goal_ns = self._next_ns()
            else:
                self._goal_ns = self._pacer.due_ns(self._next_ns())
        self._burst()
        if self._health.due():
            self._report()

    def finish(self) -> None:
        """Report a last time and close the logs."""
        self._report()
        self._simulation.finish()
        self.get_logger().info(
            f"stopped at {self._simulation.time_ns / _NANOSECONDS:.9g} s after {self._simulation.steps} steps of "
            f"{self._simulation.methods}"
        )

    def _stands_still(self) -> bool:
        return self._paused or self._settings.lockstep

    def _introduction(self) -> str:
        settings = self._settings
        mode = "as fast as possible" if self._free_running else f"at {settings.real_time_factor:g} times real time"
        if settings.lockstep:
            mode = "in lockstep"
        heard = ", ".join(self.resolve_topic_name(topic) for topic in self._topics) or "no wrench"
        end = "until stopped" if self._scene.duration is None else f"for {self._scene.duration:g} s"
        logs = ", ".join(log for log in (settings.mcap, settings.rerun) if log)
        return (
            f"{self._scene.source}: {self._simulation.plan.description}; {mode}, {end}; listening on {heard}"
            f"{f'; logging to {logs}' if logs else ''}{'; paused' if self._paused else ''}"
        )

    def _begin(self, logs: Sequence[Sink]) -> Simulation:
        """Start a run from the initial state."""
        # The newest stamp of each channel that holds time back in lockstep, None before it has spoken; and the latest
        # time at which a command of a channel takes effect: an older command never acts after a newer one.
        self._newest: dict[str, int | None] = {c.topic: None for c in self._scene.channels if not c.optional}
        self._latest_ns = dict.fromkeys(self._topics, 0)
        # Where time is to go, how far that has been computed, and how much to compute before looking at the clock.
        self._goal_ns = self._reached_ns = 0
        self._slice_ns = 1_000_000
        simulation = Simulation(self._scene, [self._publishers_sink, *logs])
        simulation.start()
        self._pacer.restart(0)
        return simulation

    def _open_logs(self) -> list[GuardedSink]:
        """Return the logs that are asked for, each guarded, so that a failure stops the log and not the run."""
        logs: list[Sink] = []
        if self._settings.mcap:
            from rb_dynamics.recording.mcap_sink import SAMPLE_TOPICS, McapSink

            names = ["inertia", *(name for name, _ in SAMPLE_TOPICS), *self._topics]
            resolved = {name: self.resolve_topic_name(name) for name in names}
            logs.append(McapSink(_numbered(self._settings.mcap, self._runs), remap=resolved))
        if self._settings.rerun:
            from rb_dynamics.recording.rerun_sink import RerunSink

            logs.append(RerunSink(_numbered(self._settings.rerun, self._runs)))
        self._runs += 1
        return [GuardedSink(log, self._on_log_error) for log in logs]

    def _subscribe(self, topic: str) -> Subscription:
        # In lockstep no command may be lost, however far the commander is ahead: the reader keeps them all.
        qos = QoSProfile(history=HistoryPolicy.KEEP_ALL) if self._settings.lockstep else QoSProfile(depth=100)
        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda _: self._warn(f"{topic}: a publisher's QoS does not fit, expected RELIABLE"),
            message_lost=lambda event: self._on_lost(topic, event.total_count_change),
        )
        options = QoSOverridingOptions.with_default_policies()
        return self.create_subscription(
            WrenchStamped,
            topic,
            partial(self._on_wrenches, topic),
            qos,
            event_callbacks=events,
            qos_overriding_options=None if self._settings.lockstep else options,
        )

    def _on_wrenches(self, topic: str, message: WrenchStamped) -> None:
        """Take a command and all that wait, on every channel.

        To wait anew for each would cost more than to simulate it; and time must not advance on the commands of one
        channel while earlier ones of another lie there unread.
        """
        self._on_wrench(topic, message)
        for waiting, subscription in self._wrench_subscriptions.items():
            with subscription.handle:
                for _ in range(_LARGEST_BATCH):
                    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
                    if taken is None:
                        break
                    self._on_wrench(waiting, taken[0])

    def _on_wrench(self, topic: str, message: WrenchStamped) -> None:
        wrench = conversions.to_wrench(message)
        by_stamp = self._settings.lockstep or self._settings.apply_at == "stamp"
        time_ns = wrench.stamp_ns if by_stamp else max(self._now_ns(), self._latest_ns[topic])
        late_ns = self._simulation.time_ns - wrench.stamp_ns if by_stamp else 0
        self._latest_ns[topic] = time_ns
        # A rejected command has spoken too: time does not wait for what will never come.
        self._newest[topic] = max(wrench.stamp_ns, self._newest.get(topic) or 0)
        try:
            self._simulation.post(topic, wrench, time_ns)
        except WrenchError as error:
            self._health.rejected(topic)
            self._warn(f"{topic}: rejected: {error}")
            return
        self._health.accepted(topic, late=late_ns > 0)
        if late_ns > 0:
            self._warn(f"{topic}: a command came {late_ns / 1e9:.9g} s after its stamp and took effect at once")
        if by_stamp and time_ns - self._simulation.time_ns > _FAR_AHEAD_NS:
            self._warn(
                f"{topic}: a command is stamped {time_ns / 1e9:.9g} s, far ahead of the simulation at "
                f"{self._simulation.time_ns / 1e9:.9g} s, expected simulation time, which begins at 0"
            )

    def _on_lost(self, topic: str, number: int) -> None:
        self._health.lost(topic, number)
        message = (
            f"{topic}: {number} commands lost on the way; the publisher needs RELIABLE and enough depth, or KEEP_ALL"
        )
        if self._settings.lockstep:
            self._fail(f"paused, because the motion is no longer that of its commands: {message}; ~/reset starts again")
        else:
            self._warn(message)

    def _now_ns(self) -> int:
        """Return the simulation time of this moment, which may lie between two outputs."""
        if self._stands_still() or self._free_running:
            return self._simulation.time_ns
        # A lag that is given up is given up before a command gets its time from it.
        return max(self._simulation.time_ns, self._pacer.due_ns(self._next_ns()))

    def _next_ns(self) -> int:
        """Return when there is something to do next: an output or the end of the scene."""
        output = self._simulation.next_output_ns()
        return output if self._simulation.end_ns is None else min(output, self._simulation.end_ns)

    def _lockstep_limit(self) -> int:
        """Return the smallest of the channels' newest stamps; no further may time advance."""
        stamps = (-1 if stamp is None else stamp for stamp in self._newest.values())
        return max(self._goal_ns, min(stamps, default=-1))

    def _behind(self) -> bool:
        return self._reached_ns < self._goal_ns and not self.done

    def _burst(self) -> None:
        """Advance towards the goal until a few milliseconds have passed; how it is cut up changes nothing."""
        begun = now = time.monotonic_ns()
        while True:
            until = min(self._goal_ns, self._reached_ns + self._slice_ns)
            try:
                self._simulation.advance(until)
            except (ConvergenceError, OverflowError) as error:
                self._fail(f"paused, because the motion cannot be continued: {error}; ~/reset starts again")
                return
            whole_slice = until - self._reached_ns == self._slice_ns
            self._reached_ns = max(self._reached_ns, until)
            before, now = now, time.monotonic_ns()
            # Only a whole slice tells what a slice costs: that nothing costs nothing is no reason to take more.
            if whole_slice and now - before < _LONGEST_BURST_NS // 8:
                self._slice_ns = min(2 * self._slice_ns, _NANOSECONDS)
            elif now - before > _LONGEST_BURST_NS // 2:
                self._slice_ns = max(1, self._slice_ns // 2)
            if not self._behind() or now - begun > _LONGEST_BURST_NS:
                return

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if self._paused and not request.data:
            self._pacer.restart(self._simulation.time_ns)
        self._paused = request.data
        self._goal_ns = self._reached_ns
        response.success, response.message = True, "paused" if request.data else "running"
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self._stands_still():
            response.success, response.message = False, "only while paused or in lockstep: call ~/pause first"
            return response
        self._goal_ns = max(self._goal_ns, self._next_ns())
        response.success, response.message = True, f"on to {self._goal_ns / _NANOSECONDS:.9f} s"
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._simulation.finish()
        self._paused = self._settings.start_paused
        self._health = Health(self.get_fully_qualified_name(), self._topics)
        self._simulation = self._begin(self._open_logs())
        response.success, response.message = True, "time 0 s, initial state, commands cleared"
        if failure := self._health.failure:
            response.success, response.message = False, f"{response.message}; but {failure}"
        return response

    def _on_log_error(self, error: Exception) -> None:
        message = f"a log has stopped: {error}"
        self._health.failed(message)
        self.get_logger().error(message)

    def _warn(self, message: str) -> None:
        self._health.warn(message)
        self.get_logger().warning(message, throttle_duration_sec=1.0)

    def _fail(self, message: str) -> None:
        self._paused = True
        self._goal_ns = self._reached_ns
        self._health.failed(message)
        self.get_logger().error(message)

    def _report(self) -> None:
        state = "paused" if self._paused else "lockstep" if self._settings.lockstep else "running"
        self._simulation.write(self._health.status(self._simulation, self._pacer, state))


def _numbered(path: str, run: int) -> Path:
    """Return `path` for the first run, and for later ones the next name with a number that is free."""
    file = Path(path)
    if run == 0:
        return file
    while (numbered := file.with_stem(f"{file.stem}_{run}")).exists():
        run += 1
    return numbered


@contextlib.contextmanager
def _signals() -> Iterator[list[int]]:
    """Yield the list of SIGINT and SIGTERM received; the handlers that were there come back afterwards."""
    received: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda number, _: received.append(number)) for number in numbers]
    try:
        yield received
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def spin(args: Sequence[str] | None = None) -> int:
    """Run the node to the end of its scene or until SIGINT or SIGTERM; return exit code 0 after a clean stop.

    Raises:
        RigidBodyError: the node could not start.
    """
    # Compilation takes seconds, in which no tick would be kept.
    os.environ.setdefault("RB_DYNAMICS_COMPILE", "never")
    with _signals() as stop, contextlib.ExitStack() as stack:
        try:
            # rclpy's own handlers would take the context away before the logs are closed.
            rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
            stack.callback(rclpy.try_shutdown)
            node = RigidBodyNode()
        except (RuntimeError, ValueError, NameValidationException) as error:
            # rcl's and rmw's errors; each says which argument or name it could not take.
            raise RigidBodyError(
                f"ROS 2 could not start the node: {error}; check what stands behind --ros-args"
            ) from error
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        for last_first in (node.destroy_node, executor.shutdown, node.finish):
            stack.callback(last_first)
        while not stop and not node.done:
            executor.spin_once(timeout_sec=node.seconds_until_due())
            node.tick()
    return 0


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of `ros2 run rb_dynamics rigid_body`: like `rb-dynamics node`, with the scene as a parameter."""
    arguments = list(sys.argv[1:] if args is None else args)
    if {"-h", "--help"} & set(arguments):
        print(
            "usage: rigid_body --ros-args -p scene:=FILE [-p lockstep:=true] [-p real_time_factor:=1.0] ...\n"
            "Simulate one free-floating rigid body; the README lists parameters, topics and services."
        )
        return 0
    try:
        return spin(arguments)
    except RigidBodyError as error:
        print(f"rigid_body: {error}", file=sys.stderr)
        return 2
