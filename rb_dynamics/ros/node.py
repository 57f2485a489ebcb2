"""The ROS 2 node: topics, services and parameters around a `Runner`, which decides when the simulation advances.

One thread does everything: it waits for messages until the next output is due and then advances for a few milliseconds
at a time, so that neither messages nor signals wait for the physics. A steady clock paces it, unless it follows
`/clock`. At high output rates it sleeps from one output to the next and then takes the commands that arrived meanwhile,
since waiting for messages would cost more than simulating.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib.util
import os
import signal
import sys
import time
from array import array
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import rclpy
from geometry_msgs.msg import Wrench, WrenchStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import InvalidParameterTypeException, NameValidationException
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from rb_dynamics.errors import LogError, RigidBodyError, SceneError
from rb_dynamics.formats.message_types import PLAIN_WRENCH, WRENCH
from rb_dynamics.formats.output_file import move_aside
from rb_dynamics.logs.messages import ACCEL, COMMAND_DEPTH, SAMPLE_TOPICS, WHEEL_TOPICS, decode_setpoint, decode_wrench
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, split_stamp
from rb_dynamics.ros import conversions
from rb_dynamics.ros.command_statistics import Losses
from rb_dynamics.ros.health import ERROR, OK, Health, Throttle
from rb_dynamics.ros.other_nodes import Neighbours, unheard_commands
from rb_dynamics.ros.pacing import ClockFollower, Pacer
from rb_dynamics.ros.publishers import TopicSink
from rb_dynamics.ros.runner import Runner
from rb_dynamics.ros.settings import (
    changed_state,
    read_settings,
    real_time_factor,
    remap_overrides,
    require_overridable,
    require_paceable,
    scene_overrides,
)
from rb_dynamics.ros.start_arguments import shared_parameters, with_file
from rb_dynamics.run.edge_schedule import FEWEST
from rb_dynamics.run.scene_remarks import scene_remarks
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.run.sink import Sink, StateChange
from rb_dynamics.run.stop_signals import stop_signals
from rb_dynamics.scene.model import Scene
from rb_dynamics.sinks.failure_guard import GuardedSink

# s: output periods up to this are slept through; number of those after which services are checked; time for that.
_LONGEST_SLEEP, _BETWEEN_SPINS, _LONGEST_SPIN = 0.006, 0.1, 0.005
# s before an output: commands that arrived until then are computed before the output is due, and do not delay it.
_LAST_LOOK = 0.0004
# s for the answers to those who wait for the last output: they take milliseconds, but not on a machine that is busy.
_LAST_ANSWERS = 10.0
# s that a publisher may take longer than a reader until each has found the other.
_FINDS_S = 1.0
# prctl(2): by how many ns Linux may delay the end of a sleep to merge wake-ups; the default is 50 000.
_PR_SET_TIMERSLACK, _SLACK_NS = 29, 1
# Says what is compiled: docs/how-to/install.md.
_COMPILE = "RB_DYNAMICS_COMPILE"


# ns between the ticks of a timer: so soon are commands and services noticed, and so seldom is the executor woken.
_SHORTEST_TICK_NS, _LONGEST_TICK_NS = 500_000, 10_000_000


class _Change(NamedTuple):
    """Parameters set together, checked as one change."""

    factor: float | None
    scene: Scene | None
    initial_only: bool
    move: StateChange | None
    parameters: Sequence[Parameter]


class RigidBodyNode(Node):
    """Simulates the body of a scene; docs/ros.md lists topics, parameters and services."""

    def __init__(self, elsewhere: Sequence[str] = (), *, cli_args: list[str] | None = None, **kwargs: object) -> None:
        """Read the parameters and the scene, and start the run; keyword arguments go to `rclpy.node.Node`.

        QoS overrides for topics in the namespaces `elsewhere` belong to other nodes of the process.

        Raises:
            RigidBodyError: a parameter, the scene or a log file is not valid.
        """
        # Accept undeclared parameters here; our own check names the valid ones.
        kwargs |= {"allow_undeclared_parameters": True, "enable_logger_service": True}
        super().__init__("rigid_body", cli_args=cli_args, **kwargs)
        try:
            self._start(elsewhere, cli_args or ())
        except BaseException as error:
            name = self.get_name()
            # A node that cannot start must not stay in the graph, where others would send it commands.
            self.destroy_node()
            if isinstance(error, SceneError):
                raise SceneError(with_file(str(error), [*sys.argv, *(cli_args or ())], name)) from None
            raise

    def _start(self, elsewhere: Sequence[str], own_arguments: Sequence[str]) -> None:
        shared = shared_parameters([*sys.argv, *own_arguments], self.get_name())
        self._settings = settings = read_settings(self, shared)
        scene = settings.scene
        self._topics = [channel.topic for channel in scene.channels]
        self._actuators = [actuator.topic for actuator in scene.actuators]
        # Logs that were deleted, and have been reported.
        self._missing: set[Path] = set()
        # What was said of logs of earlier runs when the present one began.
        self._kept: list[str] = []
        # Under use_sim_time this clock is /clock, else that of the system.
        pacer = (
            ClockFollower(self._ros_now)
            if settings.use_sim_time
            else Pacer(settings.mode.real_time_factor or 1.0, self._ros_now if settings.ros_stamps else None)
        )
        remap_overrides(self)
        self._throttle = Throttle()
        self._health = Health(self.get_fully_qualified_name(), [*self._topics, *self._actuators], self._say)
        self.runner = Runner(scene, settings.mode, pacer, self._health, self)
        self._topic_sink = TopicSink(self, scene, settings.topics, self._health, self.runner)
        _warm_up(scene)
        # Find invalid names and QoS before there is a log.
        self._losses = {topic: Losses() for topic in self._topics}
        # Channels that are read as Wrench, without a stamp.
        self._plain: set[str] = set()
        # Channels that keep their type because of another reader in this process.
        self._shared: set[str] = set()
        self._wrench_subscriptions = {topic: self._subscribe(topic) for topic in self._topics}
        self._setpoint_subscriptions = {
            topic: self.create_subscription(
                Float64,
                topic,
                partial(self._on_setpoint, topic),
                COMMAND_DEPTH,
                event_callbacks=SubscriptionEventCallbacks(
                    incompatible_qos=partial(self._on_mismatch, topic, self._or_best_effort(topic))
                ),
                raw=True,
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            )
            for topic in self._actuators
        }
        # Channels with a BEST_EFFORT publisher from which nothing is received yet; readers that are being replaced for
        # that; and what was taken meanwhile, as both readers may get it.
        self._unheard: set[str] = set()
        self._replaced: dict[str, Subscription] = {}
        # Since when the reader in its place has found every publisher, by the monotonic clock, s.
        self._found: dict[str, float] = {}
        self._taken: deque[tuple[object, ...]] = deque(maxlen=COMMAND_DEPTH)
        # Topics of commands to actuators that are not there, as of the last look.
        self._absent: list[str] = []
        require_overridable(self, elsewhere, shared)
        self._neighbours = Neighbours(self, self._topic_sink.publishers, self._health)
        # Channels without publishers are not polled: it would cost 1 % of a processor at 1 kHz.
        self._state_senders = 0
        self._states = self.create_subscription(
            Odometry,
            "~/set_state",
            self._on_set_state,
            COMMAND_DEPTH,
            event_callbacks=SubscriptionEventCallbacks(
                matched=self._on_state_senders, incompatible_qos=partial(self._on_mismatch, "~/set_state", "")
            ),
        )
        self.create_service(SetBool, "~/pause", self._on_pause)
        # A group of its own: a long step must not block ~/pause or commands.
        group = MutuallyExclusiveCallbackGroup()
        self.create_service(Trigger, "~/step", self._on_step, callback_group=group)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.runner.open()
        for _, log in self._logs:
            # A log that cannot be opened at the start is an error; later, an error only stops the log.
            if log.error:
                self.runner.simulation.finish()
                raise log.error
        if importlib.util.find_spec("simulation_interfaces") is not None:
            from rb_dynamics.ros.simulation_services import SimulationServices

            self._simulation_services = SimulationServices(self, self.runner)
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self.add_post_set_parameters_callback(self._after_set_parameters)
        self.get_logger().info(self._introduction())
        # A condition, as it holds after a reset, too; the log says each in a line of its own.
        for place, remark in enumerate(scene_remarks(self._settings.scene)):
            self._health.holds(f"scene {place}", remark)

    def _ros_now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def tick(self) -> None:
        """Take commands, advance as far as time allows, and publish diagnostics once a second."""
        self.runner.tick()
        if self._state_senders:
            self._set_newest([message for message, _ in _waiting(self._states)])
        if self._unheard or self._replaced:
            self._hear_best_effort()
        self._neighbours.look()
        if self._health.due():
            self.runner.every_second()
            self._hear_types()
            self._hear_of_absent()
            self._miss_logs()
            if self._settings.logs.names or self._topic_sink.status_is_read:
                self.runner.report()

    def run_by_timer(self) -> None:
        """Let time run by a timer, in whatever single-threaded executor spins this node; see docs/ros.md for the cost.

        At the end of the scene the logs are closed, and time stands until `~/reset`; before that, call `finish`.
        """
        runner = self.runner
        _time_begins()
        runner.start()
        period_ns = max(1, runner.simulation.next_output_ns() - runner.simulation.time_ns)
        # Ticks fall on the outputs, and at most _LONGEST_TICK_NS apart.
        period_ns //= -(-period_ns // _LONGEST_TICK_NS)
        period = 1e-9 * max(_SHORTEST_TICK_NS, period_ns)

        finished = False

        def tick() -> None:
            nonlocal finished
            if finished and runner.done:
                return
            self.tick()
            finished = runner.done
            if finished:
                self.finish()

        self.create_timer(period, tick, clock=RosClock(clock_type=ClockType.STEADY_TIME))

    def _miss_logs(self) -> None:
        """Warn once of each log that was deleted while it is being written."""
        missing = {path for path, log in self._logs if path and log.error is None and not path.exists()}
        for path in sorted(missing - self._missing):
            self._health.failed(f"the log {path} was deleted: data written to it are lost; ~/reset begins another")
        self._missing = missing

    def finish(self) -> None:
        """Report a last time and close the logs."""
        self.runner.report()
        simulation = self.runner.simulation
        simulation.finish()
        steps = f"{simulation.steps} step{'s' * (simulation.steps != 1)}"
        self.get_logger().info(f"stopped at {self.runner.shown_time} after {steps} of {simulation.methods}")

    def _introduction(self) -> str:
        settings, scene, factor = self._settings, self._settings.scene, self._settings.mode.real_time_factor
        mode = "as fast as possible"
        if factor:
            mode = "in real time" if factor == 1.0 else f"at {factor:g} times real time"
        if settings.mode.lockstep:
            mode = "in lockstep"
        if settings.use_sim_time:
            mode = "following /clock"
        stamps = "" if settings.use_sim_time else f", stamps in {'ROS' if settings.ros_stamps else 'simulation'} time"
        heard = ", ".join(self.resolve_topic_name(topic) for topic in (*self._topics, *self._actuators)) or "no wrench"
        end = "until stopped" if scene.duration is None else f"for {scene.duration:g} s"
        logs = ", ".join(settings.logs.names)
        return (
            f"{scene.source} by {self.runner.simulation.plan.name}, {mode}{stamps}, {end}; listening on {heard}"
            f"{f'; logging to {logs}' if logs else ''}{'; paused' if self.runner.paused else ''}"
        )

    def sinks(self) -> list[Sink]:
        """Return the sinks of the next run: topics and logs, each guarded, so that a failure stops only that one."""
        scene = self._settings.scene
        topics = (*self._topics, *self._actuators, *(each.name for each in scene.actuators), *scene.sensor_topics)
        names = ["inertia", *(name for name, _ in (*SAMPLE_TOPICS, *WHEEL_TOPICS, ACCEL)), *topics]
        resolved = {name: self.resolve_topic_name(name) for name in names}
        sinks = self._settings.logs.sinks(self.get_namespace(), resolved)
        # A sink of a plug-in need not write a file.
        paths = [Path(log.path) if hasattr(log, "path") else None for log in sinks]
        guarded = [
            GuardedSink(
                log,
                lambda error: self._health.failed(f"a log has stopped: {error}"),
                before_open=partial(self._keep_earlier, path),
            )
            for log, path in zip(sinks, paths, strict=True)
        ]
        self._logs = list(zip(paths, guarded, strict=True))
        self._missing.clear()
        self._kept.clear()
        return [self._topic_sink, *guarded]

    def _keep_earlier(self, path: Path | None) -> None:
        """Rename an earlier log: its run cannot be repeated."""
        kept = path and move_aside(path)
        if kept is not None:
            self._kept.append(f"an earlier log {path} is kept as {kept.name}")
            self.get_logger().info(self._kept[-1])

    def _subscribe(self, topic: str, replaced: Subscription | None = None) -> Subscription:
        # In lockstep no command may be lost, however far ahead the sender is: the reader keeps all.
        lockstep = self._settings.mode.lockstep
        qos = QoSProfile(history=HistoryPolicy.KEEP_ALL) if lockstep else QoSProfile(depth=COMMAND_DEPTH)
        if replaced is not None:
            qos = replaced.qos_profile
            qos.reliability = ReliabilityPolicy.BEST_EFFORT
        override = f"qos_overrides.{self.resolve_topic_name(topic)}.subscription.reliability"

        def mismatched(event: Any) -> None:
            # As in `read_settings`.
            asked = lockstep or override in self._parameter_overrides
            if event.last_policy_kind == QoSPolicyKind.RELIABILITY and not asked:
                self._unheard.add(topic)
                return
            remedy = "as in lockstep no command may be lost" if lockstep else f"or leave out {override}"
            self._on_mismatch(topic, f", {remedy}", event)

        events = SubscriptionEventCallbacks(
            incompatible_qos=mismatched,
            message_lost=lambda event: self._on_lost(topic, self._losses[topic].tell(event.total_count_change)),
            matched=lambda _: self._losses[topic].forget(),
        )
        return self.create_subscription(
            Wrench if topic in self._plain else WrenchStamped,
            topic,
            partial(self._on_wrenches, topic),
            qos,
            event_callbacks=events,
            raw=True,
            qos_overriding_options=None if lockstep or replaced else QoSOverridingOptions.with_default_policies(),
        )

    def _or_best_effort(self, topic: str) -> str:
        name = f"qos_overrides.{self.resolve_topic_name(topic)}.subscription.reliability"
        return f", or start this node with -p {name}:=best_effort"

    def _on_mismatch(self, topic: str, remedy: str, event: Any) -> None:
        self._health.mismatched(topic, event.total_count_change)
        self._health.failed(
            f"{topic}: a publisher's QoS is incompatible, expected RELIABLE; its messages have no effect: publish "
            f"RELIABLE (in rclpy QoSProfile(depth=10), in a shell --qos-reliability reliable){remedy}"
        )

    def _hear_best_effort(self) -> None:
        """Replace the reader of a channel that has a BEST_EFFORT publisher by one that can receive from it.

        Readers ask for RELIABLE while they can, as a lost wrench is lost momentum. The earlier reader goes only a while
        after the new one has found every publisher: a publisher may find the reader later, and nothing may be lost.
        """
        for topic in self._unheard - self._replaced.keys():
            before = self._wrench_subscriptions[topic]
            if before.qos_profile.reliability == ReliabilityPolicy.RELIABLE:
                self._wrench_subscriptions[topic] = self._subscribe(topic, before)
                self._replaced[topic] = before
                self.get_logger().info(
                    f"{topic}: a publisher offers BEST_EFFORT: its commands are received, but those that the "
                    "network loses are not sent again; for that, let every publisher offer RELIABLE"
                )
        self._unheard.clear()
        for topic, before in list(self._replaced.items()):
            now = time.monotonic()
            if self._wrench_subscriptions[topic].get_publisher_count() < self.count_publishers(topic):
                self._found.pop(topic, None)
            elif now - self._found.setdefault(topic, now) >= _FINDS_S:
                self.take_commands()
                del self._found[topic]
                del self._replaced[topic]
                self.destroy_subscription(before)
                self._losses[topic].forget()

    def _hear_types(self) -> None:
        """Read a channel as Wrench, without a stamp, if only that is published on it; warn of others.

        In one process a topic has one type.
        """
        unheard = []
        for topic, subscription in self._wrench_subscriptions.items():
            publishers = self.get_publishers_info_by_topic(subscription.topic_name)
            heard, other = (PLAIN_WRENCH, WRENCH) if topic in self._plain else (WRENCH, PLAIN_WRENCH)
            types = {publisher.topic_type for publisher in publishers}
            asked = other in types and heard not in types and not self._settings.mode.lockstep
            if asked and topic not in self._shared and self._changes_type(topic):
                heard = other
                self.get_logger().info(f"{topic}: subscribed as {heard}, the type of its publisher")
            unheard += [
                f"{topic}: {publisher.node_name} publishes {publisher.topic_type}, expected {heard}"
                for publisher in publishers
                if publisher.topic_type != heard
            ]
        remedy = (
            "it has no effect: lockstep needs WrenchStamped, as does a topic with another reader in this process, else "
            "a channel takes WrenchStamped or only Wrench"
        )
        self._health.holds("types", (unheard and f"{'; '.join(unheard)}; {remedy}") or "")

    def _changes_type(self, topic: str) -> bool:
        """Read a channel as its other type; return False if another reader in this process keeps it from that."""
        self.take_commands()
        readers = [self._wrench_subscriptions[topic], self._replaced.pop(topic, None)]
        self._found.pop(topic, None)
        for reader in readers:
            if reader is not None:
                self.destroy_subscription(reader)
        if self.executor is not None:
            # At an event, such as another publisher, an executor holds all that it waited for, these readers too.
            with contextlib.suppress(TimeoutException):
                self.executor.wait_for_ready_callbacks(timeout_sec=0.0, nodes=[])
        self._plain ^= {topic}
        try:
            self._wrench_subscriptions[topic] = self._subscribe(topic)
        except RuntimeError:
            self._shared.add(topic)
            self._plain ^= {topic}
            self._wrench_subscriptions[topic] = self._subscribe(topic)
            return False
        return True

    def _hear_of_absent(self) -> None:
        """Warn of commands to actuators that the scene does not have, at the second look that finds them.

        Discovery may tell of a publisher before it tells of the reader beside it.
        """
        found = unheard_commands(self)
        topics = [topic for topic in found if topic in self._absent]
        self._absent = found
        self._health.unheard = len(topics)
        known = ", ".join(self.resolve_topic_name(topic) for topic in self._actuators) or "none, as the scene has none"
        told = f"{', '.join(topics)}: commands that no node receives, expected those of an actuator here: {known}"
        self._health.holds("absent", told if topics else "")

    def _on_wrenches(self, topic: str, message: bytes, facts: dict[str, Any]) -> None:
        self._take(topic, message, facts)
        self.take_commands()

    def take_commands(self) -> None:
        """Take all waiting commands on every channel.

        Waiting for each one separately would cost more than simulating it; and time must not advance on the commands of
        one channel while earlier ones of another are unread.
        """
        for topic, subscription in [*self._replaced.items(), *self._wrench_subscriptions.items()]:
            for message, facts in _waiting(subscription):
                self._take(topic, message, facts)
        for topic, subscription in self._setpoint_subscriptions.items():
            for message, facts in _waiting(subscription):
                self._on_setpoint(topic, message, facts)

    def _take(self, topic: str, message: bytes, facts: dict[str, Any]) -> None:
        number = facts.get("publication_sequence_number")
        if topic in self._replaced:
            if (key := (topic, facts["source_timestamp"], number)) in self._taken:
                return
            self._taken.append(key)
        else:
            alone = self._wrench_subscriptions[topic].get_publisher_count
            self._on_lost(topic, self._losses[topic].take(number, lambda: alone() == 1))
        try:
            # As raw bytes: the middleware takes several times as long to make a message object.
            wrench = decode_wrench(PLAIN_WRENCH if topic in self._plain else WRENCH, 0, message)
            # A stamp with more than 1e9 nanoseconds may be a time that no log can hold.
            split_stamp(wrench.stamp_ns)
        except LogError as error:
            self._health.rejected(topic)
            self._health.warn(f"{topic}: rejected: {error}")
            return
        sent = None
        if self.runner.times_commands:
            sent = int(facts["source_timestamp"]), int(facts["received_timestamp"]), number or 0
        self.runner.command(topic, wrench, _age_ns(facts), sent)

    def _on_setpoint(self, topic: str, message: bytes, facts: dict[str, Any]) -> None:
        try:
            value = decode_setpoint(message)
        except LogError as error:
            self._health.rejected(topic)
            self._health.warn(f"{topic}: rejected: {error}")
            return
        self.runner.actuate(topic, value, _age_ns(facts))

    def _on_lost(self, topic: str, lost: int) -> None:
        if not lost:
            return
        self._health.lost(topic, lost)
        message = (
            f"{topic}: {lost} commands lost in transport; the publisher needs RELIABLE and enough depth, or KEEP_ALL, "
            f"and no more than {COMMAND_DEPTH} may arrive at once"
        )
        if self._settings.mode.lockstep:
            self.runner.fail(f"the motion no longer follows its commands: {message}")
        else:
            self._health.warn(message)

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.runner.pause(request.data)
        response.success, response.message = True, "paused" if request.data else "running"
        return response

    async def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self.runner.stands_still:
            response.success, response.message = False, "only while paused or in lockstep: call ~/pause first"
            return response
        failure = await self.runner.stepped()
        response.success, response.message = not failure, failure or "one output period more"
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        failure = self.runner.reset()
        response.success, response.message = not failure, "simulation time 0 s, initial state, commands cleared"
        response.message = "; ".join([response.message, *self._kept, *[f"but {failure}"] * bool(failure)])
        return response

    def _on_set_state(self, message: Odometry) -> None:
        self._set_newest([message, *(later for later, _ in _waiting(self._states))])

    def _on_state_senders(self, event: Any) -> None:
        self._state_senders = event.current_count

    def _set_newest(self, waiting: list[Odometry]) -> None:
        """Apply the newest valid state of those waiting."""
        while waiting:
            try:
                self.runner.set_state(conversions.to_state(waiting.pop(), self.runner.scene.frames))
                self._health.states.accepted += 1
                if self._throttle.lets(moved := f"~/set_state: moved at {self.runner.shown_time}"):
                    self._health.told(moved)
                break
            except RigidBodyError as error:
                self._health.states.rejected += 1
                self._health.warn(f"~/set_state: rejected: {error}")
        self._health.states.left_out += len(waiting)

    def _on_set_parameters(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Check all parameters set together as one change; nothing changes unless all are valid."""
        try:
            self._change = self._checked(parameters)
        except RigidBodyError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _checked(self, parameters: Sequence[Parameter]) -> _Change:
        overrides = scene_overrides(parameters)
        initial_only = all(name.startswith("initial.") for name in overrides)
        if not initial_only and not self.runner.paused:
            raise SceneError(f"{', '.join(overrides)}: can only be changed while paused; call ~/pause first")
        factor = None
        for parameter in parameters:
            if parameter.name == "real_time_factor":
                factor = real_time_factor(parameter.value)
                if self._settings.use_sim_time:
                    raise SceneError(
                        f"parameter real_time_factor: found {factor:g} while /clock is followed, expected no change, "
                        "as that clock sets the pace; change it at its source, or start the node without use_sim_time"
                    )
        scene = self.runner.changed(overrides) if overrides else None
        if scene is not None:
            require_paceable(scene)
        # What is checked is what will be done: no time passes between.
        self.runner.catch_up()
        move = self.runner.rehearse(None if initial_only else scene, changed_state(parameters, self.runner.state))
        return _Change(factor, scene, initial_only, move, parameters)

    def _after_set_parameters(self, _: Sequence[Parameter]) -> None:
        change = self._change
        if change.factor is not None:
            self.runner.pace(change.factor)
        try:
            if change.scene is not None:
                self.runner.change(change.scene, change.initial_only)
            if change.move is not None:
                self.runner.simulation.move(change.move)
            values = ((each.name, each.value) for each in change.parameters)
            changes = ", ".join(f"{name} = {list(to) if isinstance(to, array) else to}" for name, to in values)
            self._health.told(f"parameters set at {self.runner.shown_time}: {changes}")
        except RigidBodyError as error:
            self._health.failed(f"the body is as it was: {error}")

    def reject_clock(self, error: ValueError) -> None:
        """Count an invalid message of the clock that is followed; time did not move."""
        if isinstance(self.runner.pacer, ClockFollower):
            self.runner.pacer.rejected += 1
        self._health.warn(f"/clock: rejected: {error}")

    def _say(self, level: int, message: str) -> None:
        logger: Any = self.get_logger()
        if level == OK:
            logger.info(message)
        elif level == ERROR:
            logger.error(message)
        elif self._throttle.lets(message):
            logger.warning(message)


def _warm_up(scene: Scene) -> None:
    """Compile now what the run may need, if anything is to be compiled: see `_time_begins`."""
    step = scene.solver.step
    rate = scene.output_rate if step is None else 1.0 / step
    if os.environ.get(_COMPILE) == "always" and rate:
        # Number of outputs computed at once if the node has fallen behind.
        Simulation(replace(scene, output_rate=rate)).advance(round(2 * FEWEST / rate * NANOSECONDS))


def _time_begins() -> None:
    """From now on load what has been compiled, and compile nothing: it would delay the body by seconds."""
    if os.environ.get(_COMPILE) == "always":
        os.environ[_COMPILE] = "cached"


@contextlib.contextmanager
def _compiling_nothing() -> Iterator[None]:
    """Compile nothing unless asked to: it takes seconds, and pays if there are many steps between two outputs."""
    given = os.environ.get(_COMPILE)
    os.environ[_COMPILE] = given or "never"
    try:
        yield
    finally:
        del os.environ[_COMPILE]
        if given is not None:
            os.environ[_COMPILE] = given


def _waiting(subscription: Subscription) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Take all waiting messages, each with the middleware's information about it."""
    with subscription.handle:
        for _ in range(COMMAND_DEPTH):
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if taken is None:
                return
            yield taken


def _age_ns(facts: dict[str, Any]) -> int:
    """Return how long ago a message arrived, according to the middleware; 0 if it does not say."""
    came_ns = int(facts["received_timestamp"])
    return time.time_ns() - came_ns if came_ns else 0


def spin(
    args: Sequence[str] | None = None, make: Callable[[], Sequence[RigidBodyNode]] = lambda: [RigidBodyNode()]
) -> int:
    """Run the nodes of `make` until their scenes end or a signal stops them; return 0 after a clean stop.

    Raises:
        RigidBodyError: a node could not start.
    """
    stop: list[int] = []
    with stop_signals(stop.append, signal.SIGINT), contextlib.ExitStack() as stack:
        stack.enter_context(_compiling_nothing())
        with told_by_ros():
            # rclpy's own handlers would shut the context down before the logs are closed.
            rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
            stack.callback(rclpy.try_shutdown)
            nodes = make()
        # Everything so far stays: searching it for garbage would take longer than an output period.
        gc.freeze()
        for last_first in (gc.collect, gc.unfreeze):
            stack.callback(last_first)
        executor = SingleThreadedExecutor()
        for last_first in (*(node.destroy_node for node in nodes), executor.shutdown, *(node.finish for node in nodes)):
            stack.callback(last_first)
        for node in nodes:
            executor.add_node(node)
        _end_sleeps_in_time()
        _run(nodes, executor, stop)
    return 0


@contextlib.contextmanager
def told_by_ros() -> Iterator[None]:
    """Raise errors of rcl and rmw, each of which names the argument or name that is invalid, as a `RigidBodyError`."""
    try:
        yield
    except (RuntimeError, ValueError, NameValidationException, InvalidParameterTypeException) as error:
        raise RigidBodyError(
            f"ROS 2 could not start the node: {error}; check the arguments after --ros-args"
        ) from error


def _end_sleeps_in_time() -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, _SLACK_NS)


def _run(nodes: Sequence[RigidBodyNode], executor: SingleThreadedExecutor, stop: Sequence[int]) -> None:
    _time_begins()
    for node in nodes:
        node.runner.start()
    next_spin = 0.0
    while not stop and (running := [node for node in nodes if not node.runner.done]):
        seconds = _seconds_until_due(running)
        if seconds > _LONGEST_SLEEP:
            _serve(executor, seconds)
        else:
            if time.monotonic() >= next_spin:
                spin_some(executor)
                next_spin = time.monotonic() + _BETWEEN_SPINS
                seconds = _seconds_until_due(running)
            if seconds > _LAST_LOOK:
                time.sleep(seconds - _LAST_LOOK)
                for node in running:
                    node.runner.prepare()
                seconds = _seconds_until_due(running)
            time.sleep(seconds)
        # A command carries its arrival time, so it acts no later for being taken late.
        for node in running:
            node.tick()
    # Who waits for the last output is answered; the executor may have other things to do first.
    give_up = time.monotonic() + _LAST_ANSWERS
    while any(node.runner.unanswered for node in nodes) and time.monotonic() < give_up:
        spin_some(executor)


def spin_some(executor: SingleThreadedExecutor) -> None:
    """Let everything that is ready do one thing each, for at most some milliseconds, without waiting."""
    until = time.monotonic() + _LONGEST_SPIN
    while _serve(executor, 0.0) and time.monotonic() < until:
        pass


def _serve(executor: SingleThreadedExecutor, seconds: float) -> bool:
    """Wait for one task and execute it; return whether it was completed, which `spin_once` does not."""
    try:
        task, entity, node = executor.wait_for_ready_callbacks(timeout_sec=seconds)
    except TimeoutException:
        return False
    task()
    error = task.exception()
    # rclpy's own reader of /clock does not accept negative times, and would end the node.
    if isinstance(error, ValueError) and isinstance(entity, Subscription) and entity.msg_type is Clock:
        node.reject_clock(error)
    elif error is not None:
        raise error
    # Unfinished callbacks wait for time to advance.
    return bool(task.done())


def _seconds_until_due(nodes: Sequence[RigidBodyNode]) -> float:
    return min(node.runner.seconds_until_due() for node in nodes)


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of `ros2 run rb_dynamics rigid_body`: like `rb-dynamics node`, with the scene as a parameter."""
    arguments = list(sys.argv[1:] if args is None else args)
    if {"-h", "--help"} & set(arguments):
        print(
            "usage: rigid_body --ros-args -p scene:=FILE [-p lockstep:=true] [-p real_time_factor:=1.0] ...\n"
            "Simulate one free-floating rigid body; docs/reference/ros.md lists parameters, topics and services."
        )
        return 0
    try:
        return spin(arguments)
    except RigidBodyError as error:
        print(f"rigid_body: {error}", file=sys.stderr)
        return 2
