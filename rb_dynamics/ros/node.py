"""The ROS 2 node: decides when the simulation advances; what happens then is the loop's.

One thread does everything: it waits for messages until the next output is due, then advances. Steady time paces it, so
that no jump of a ROS clock can; the physics never sees either.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
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
# How long the node may wait without looking at signals, and how long it may compute without looking at messages.
_LONGEST_WAIT = 0.05
_LONGEST_BURST_NS = 5_000_000


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
        self._paused = settings.start_paused
        self._free_running = settings.real_time_factor == 0.0
        self._pacer = Pacer(settings.real_time_factor or 1.0)
        self._health = Health([channel.topic for channel in self._scene.channels])
        self._topics = TopicSink(self, self._scene.frames, settings.publish_clock)
        self._runs = 0
        # The newest stamp of each channel that holds time back in lockstep; None before it has spoken.
        self._newest: dict[str, int | None] = {}
        self._simulation = self._begin()
        for channel in self._scene.channels:
            self._subscribe(channel.topic)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/step", self._on_step)
        self.create_service(Trigger, "~/reset", self._on_reset)

    @property
    def done(self) -> bool:
        """Whether the scene's duration is over."""
        return self._simulation.ended

    def seconds_until_due(self) -> float:
        """Return how long there is nothing to do but to wait for messages, s."""
        if self._paused or self._settings.lockstep:
            return _LONGEST_WAIT
        if self._free_running:
            return 0.0
        return min(_LONGEST_WAIT, self._pacer.seconds_until(self._next_ns()))

    def tick(self) -> None:
        """Advance as far as time, pause and lockstep allow, and publish diagnostics once a second."""
        if not self._paused:
            if self._settings.lockstep:
                self._advance(self._lockstep_limit())
            elif self._free_running:
                self._burst()
            else:
                self._advance(self._pacer.due_ns(self._next_ns()))
        if self._health.due():
            self._report()

    def finish(self) -> None:
        """Report a last time and close the logs."""
        self._report()
        self._simulation.finish()

    def _begin(self) -> Simulation:
        """Start a run from the initial state, with logs of its own."""
        self._newest = {channel.topic: None for channel in self._scene.channels if not channel.optional}
        logs: list[Sink] = []
        if self._settings.mcap:
            from rb_dynamics.recording.mcap_sink import SAMPLE_TOPICS, McapSink

            names = ["inertia", *(name for name, _ in SAMPLE_TOPICS), *(c.topic for c in self._scene.channels)]
            resolved = {name: self.resolve_topic_name(name) for name in names}
            logs.append(McapSink(_numbered(self._settings.mcap, self._runs), remap=resolved))
        if self._settings.rerun:
            from rb_dynamics.recording.rerun_sink import RerunSink

            logs.append(RerunSink(_numbered(self._settings.rerun, self._runs)))
        self._runs += 1
        guarded = [GuardedSink(log, self._on_log_error) for log in logs]
        simulation = Simulation(self._scene, [self._topics, *guarded])
        simulation.start()
        for guard in guarded:
            # A log that cannot even be opened is a mistake of whoever asked for it; later it only stops the log.
            if guard.error:
                raise guard.error
        self._pacer.restart(0)
        return simulation

    def _subscribe(self, topic: str) -> None:
        # In lockstep no command may be lost, however far the commander is ahead: the reader keeps them all.
        qos = QoSProfile(history=HistoryPolicy.KEEP_ALL) if self._settings.lockstep else QoSProfile(depth=100)
        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda _: self._health.warn(f"{topic}: a publisher's QoS does not fit (needs RELIABLE)"),
            message_lost=lambda event: self._health.lost(topic, event.total_count_change),
        )
        options = QoSOverridingOptions.with_default_policies()
        self.create_subscription(
            WrenchStamped,
            topic,
            partial(self._on_wrench, topic),
            qos,
            event_callbacks=events,
            qos_overriding_options=None if self._settings.lockstep else options,
        )

    def _on_wrench(self, topic: str, message: WrenchStamped) -> None:
        wrench = conversions.to_wrench(message)
        now = self._now_ns()
        by_stamp = self._settings.lockstep or self._settings.apply_at == "stamp"
        try:
            self._simulation.post(topic, wrench, wrench.stamp_ns if by_stamp else now)
        except WrenchError as error:
            self._health.rejected(topic, str(error))
        else:
            self._health.accepted(topic, late_ns=self._simulation.time_ns - wrench.stamp_ns if by_stamp else 0)
        # A rejected command has spoken too: time does not wait for what will never come.
        self._newest[topic] = max(wrench.stamp_ns, self._newest.get(topic) or 0)

    def _now_ns(self) -> int:
        """Return the simulation time of this moment, which may lie between two outputs."""
        time_ns = self._simulation.time_ns
        if self._paused or self._free_running or self._settings.lockstep:
            return time_ns
        return max(time_ns, self._pacer.now_ns())

    def _next_ns(self) -> int:
        """Return when there is something to do next: an output or the end of the scene."""
        output = self._simulation.next_output_ns()
        return output if self._simulation.end_ns is None else min(output, self._simulation.end_ns)

    def _lockstep_limit(self) -> int:
        """Return the smallest of the channels' newest stamps; no further may time advance."""
        stamps = self._newest.values()
        return min((-1 if stamp is None else stamp for stamp in stamps), default=-1)

    def _burst(self) -> None:
        stop = time.monotonic_ns() + _LONGEST_BURST_NS
        while not self.done and time.monotonic_ns() < stop:
            self._advance(self._next_ns())

    def _advance(self, until_ns: int) -> None:
        try:
            self._simulation.advance(until_ns)
        except ConvergenceError as error:
            self._paused = True
            self._health.failed(f"paused, because the motion cannot be continued: {error}; ~/reset starts again")
            self.get_logger().error(str(error))

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if self._paused and not request.data:
            self._pacer.restart(self._simulation.time_ns)
        self._paused = request.data
        response.success, response.message = True, "paused" if request.data else "running"
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not (self._paused or self._settings.lockstep):
            response.success, response.message = False, "only while paused or in lockstep: call ~/pause first"
            return response
        self._advance(self._next_ns())
        response.success, response.message = True, f"time {self._simulation.time_ns / _NANOSECONDS:.9f} s"
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._simulation.finish()
        self._paused = self._settings.start_paused
        self._health = Health([channel.topic for channel in self._scene.channels])
        self._simulation = self._begin()
        response.success, response.message = True, "time 0 s, initial state, commands cleared"
        return response

    def _on_log_error(self, error: Exception) -> None:
        self._health.failed(f"a log has stopped: {error}")
        self.get_logger().error(f"a log has stopped: {error}")

    def _report(self) -> None:
        state = "paused" if self._paused else "lockstep" if self._settings.lockstep else "running"
        self._simulation.write(self._health.status(self._simulation, self._pacer, state))


def _numbered(path: str, run: int) -> Path:
    """Return `path` for the first run and `path` with the number of the run for later ones: nothing is overwritten."""
    file = Path(path)
    return file if run == 0 else file.with_stem(f"{file.stem}_{run}")


def spin(args: Sequence[str] | None = None, make: Callable[[], RigidBodyNode] = RigidBodyNode) -> int:
    """Run the node to the end of its scene or until SIGINT or SIGTERM; return exit code 0 after a clean stop.

    Raises:
        RigidBodyError: the node could not start.
    """
    stop: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _: stop.append(received))
    # rclpy's own handlers would take the context away before the logs are closed.
    rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = make()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        try:
            while not stop and not node.done:
                executor.spin_once(timeout_sec=node.seconds_until_due())
                node.tick()
        finally:
            node.finish()
            executor.shutdown()
            node.destroy_node()
    finally:
        rclpy.try_shutdown()
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
