"""`TopicSink`: the node's publishers, as a sink.

Samples are published as the same bytes as in a log. Building message objects only for the middleware to serialize them
again would cost several times as much.
"""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions

from rb_dynamics.formats import message_types as types
from rb_dynamics.formats.cdr import clock_packer, covariance, odometry_packer, stamped_packer
from rb_dynamics.logs import messages
from rb_dynamics.ros.health import Health
from rb_dynamics.ros.runner import Runner
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.sink import Event, Measurement, RunInfo, StateChange, Status
from rb_dynamics.scene.model import Scene

_POSE_WITH_COVARIANCE = ("pose_with_covariance", types.POSE_WITH_COVARIANCE)
_TWIST_WITH_COVARIANCE = ("twist_with_covariance", types.TWIST_WITH_COVARIANCE)
_OVERRIDABLE = (
    QoSPolicyKind.HISTORY,
    QoSPolicyKind.DEPTH,
    QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY,
)
# s between two checks for readers.
_LOOK = 0.005
# s for the last messages of all topics together, when a run ends.
_LAST_MESSAGES = 0.2


@dataclass(frozen=True)
class Topics:
    """Optional topics, and how many samples each topic keeps."""

    depth: int = 10
    clock: bool = False
    transforms: bool = False
    acceleration: bool = False
    pose_with_covariance: bool = False
    twist_with_covariance: bool = False
    # Variances in odom and the two: three of position or velocity, three of rotation; zero if there are none.
    pose_variances: tuple[float, ...] = (0.0,) * 6
    twist_variances: tuple[float, ...] = (0.0,) * 6


@dataclass
class _SampleTopic:
    """A topic of samples: whether late readers get the last one, and its encoder if the run has it."""

    publisher: Publisher
    kept: bool
    pack: Callable[[messages.Stamped], bytes] | None = None


class TopicSink:
    """Publishes every sample on the topics of the node; a topic without readers costs nothing.

    While time is paused, a new reader gets the newest sample, so that it sees where the body is. No stamp is ever zero:
    to tf2 that means "the newest", and to readers of `/clock` "not started". The initial state, at time 0, is stamped 1
    ns.
    """

    def __init__(self, node: Node, scene: Scene, topics: Topics, health: Health, runner: Runner) -> None:
        """Create the publishers on `node`; `publishers` holds all of them.

        Args:
            node: creates the publishers.
            scene: that of the first run.
            topics: optional topics and depth.
            health: counts readers with incompatible QoS.
            runner: gives stamps, without which nothing is published, and whether time is paused.
        """
        self._node, self._asked, self._health, self._runner = node, topics, health, runner
        self._newest: tuple[Sample, int] | None = None
        # The topics that have readers, and when that was checked, s.
        self._read: list[tuple[Callable[[bytes], None], Callable[[messages.Stamped], bytes]]] = []
        self._looked = -math.inf
        self.publishers: list[Publisher] = []
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._inertia = self._created(*messages.MASS_PROPERTIES, latched)
        self._diagnostics = self._created("/diagnostics", types.DIAGNOSTICS, 1)
        # Equivalent to the broadcaster of tf2_ros, on the same topics, but nothing is made for topics without readers.
        self._static = self._created(*messages.TF_STATIC, latched) if topics.transforms else None
        self._samples: dict[str, _SampleTopic] = {}
        if topics.clock:
            self._add("/clock", types.CLOCK)
        for name, type_name, asked in (
            (*_POSE_WITH_COVARIANCE, topics.pose_with_covariance),
            (*_TWIST_WITH_COVARIANCE, topics.twist_with_covariance),
        ):
            if asked:
                self._add(name, type_name)
        self._add_samples(scene)
        overriding = QoSOverridingOptions(_OVERRIDABLE)
        self._sensors = {
            sensor.name: self._created(
                sensor.name, sensor.message, messages.depth_at(sensor.rate), qos_overriding_options=overriding
            )
            for sensor in scene.sensors
        }

    def open(self, run: RunInfo) -> None:
        """Publish the mass properties; late subscribers receive them too (transient local)."""
        self._add_samples(run.scene)
        packers, pack_clock = messages.sample_packers(run.scene, run.acceleration), clock_packer()
        packers["/clock"] = lambda s: pack_clock(*s.stamp)
        packers |= self._with_covariance(run.scene)
        for name, topic in self._samples.items():
            topic.pack = packers.get(name)
        self._looked = -math.inf
        self._encode_measurement = messages.measurement_packers(run.scene)
        self._body_frame = run.scene.frames.body_frame
        stamp_ns = self._runner.stamped(run.scene.initial.time_ns) or 1
        self._inertia.publish(messages.encode_inertia(run.scene, stamp_ns))
        if self._static is not None and run.scene.frames.fixed:
            self._static.publish(messages.encode_fixed(run.scene.frames, stamp_ns))

    def write(self, event: Event) -> None:
        """Publish a sample or a status; wrenches are not echoed."""
        if isinstance(event, Sample):
            stamp_ns = self._runner.stamped(event.time_ns)
            if stamp_ns is None:
                return
            self._newest = event, stamp_ns
            if reading := self._readers():
                stamped = messages.Stamped(event, stamp_ns)
                for publish, pack in reading:
                    publish(pack(stamped))
        elif isinstance(event, Measurement):
            self._publish(event)
        elif isinstance(event, StateChange) and self._runner.stands_still:
            # No output may come for a while.
            self.write(self._runner.simulation.sample)
        elif isinstance(event, Status) and self.status_is_read:
            status = replace(event, time_ns=self._runner.stamped(event.time_ns) or 1)
            self._diagnostics.publish(messages.encode_status(status, self._body_frame))

    def _readers(self) -> list[tuple[Callable[[bytes], None], Callable[[messages.Stamped], bytes]]]:
        """Return how to publish and pack each topic that is read.

        While time advances by itself, readers are checked every few milliseconds: at 1 kHz it would cost as much as
        the motion.
        """
        now = time.monotonic()
        if now > self._looked + _LOOK or not self._runner.paced:
            self._looked = now
            self._read = [
                (topic.publisher.publish, topic.pack)
                for topic in self._samples.values()
                if topic.pack and (topic.kept or topic.publisher.get_subscription_count())
            ]
        return self._read

    def _with_covariance(self, scene: Scene) -> dict[str, Callable[[messages.Stamped], bytes]]:
        """Return what makes the messages that have a covariance; a log has zeros in odom, as it has the truth."""
        frames, of_pose, of_twist = (
            scene.frames,
            *map(covariance, (self._asked.pose_variances, self._asked.twist_variances)),
        )
        pack_odometry = odometry_packer(frames.world_frame, frames.body_frame, of_pose, of_twist)
        (pose, pose_type), (twist, twist_type) = _POSE_WITH_COVARIANCE, _TWIST_WITH_COVARIANCE
        pack_pose = stamped_packer(pose_type, frames.world_frame)
        pack_twist = stamped_packer(twist_type, frames.body_frame)
        return {
            "odom": lambda s: pack_odometry(*s.stamp, s.pose, s.twist),
            pose: lambda s: pack_pose(*s.stamp, *s.pose, *of_pose),
            twist: lambda s: pack_twist(*s.stamp, *s.twist, *of_twist),
        }

    def _publish(self, event: Measurement) -> None:
        publisher = self._sensors[event.topic]
        stamp_ns = self._runner.stamped(event.taken_ns)
        if stamp_ns is not None and publisher.get_subscription_count():
            publisher.publish(self._encode_measurement[event.topic](event, stamp_ns))

    @property
    def status_is_read(self) -> bool:
        """Whether `/diagnostics` has readers; assembling a status takes 0.2 ms."""
        return bool(self._diagnostics.get_subscription_count())

    def close(self, result: Mapping[str, str]) -> None:
        """Wait, briefly, until readers have received the last messages: logs are closed after that."""
        give_up = time.monotonic() + _LAST_MESSAGES
        for publisher in (*(topic.publisher for topic in self._samples.values()), *self._sensors.values()):
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, give_up - time.monotonic())))

    def _add_samples(self, scene: Scene) -> None:
        """Create the publishers for samples of `scene` that do not exist yet."""
        for name, type_name in messages.sample_topics(scene, self._asked.acceleration):
            if name not in self._samples and (type_name != types.TRANSFORMS or self._asked.transforms):
                self._add(name, type_name)

    def _add(self, name: str, type_name: str) -> None:
        events = PublisherEventCallbacks(
            matched=partial(self._greet, name),
            incompatible_qos=lambda event: self._health.mismatched(name, event.total_count_change),
        )
        overriding = QoSOverridingOptions(_OVERRIDABLE)
        publisher = self._created(
            name, type_name, self._asked.depth, event_callbacks=events, qos_overriding_options=overriding
        )
        # Publish what is kept for late readers before they connect.
        kept = publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self._samples[name] = _SampleTopic(publisher, kept)

    def _created(self, name: str, type_name: str, qos: QoSProfile | int, **options: Any) -> Publisher:
        package, _, kind = type_name.partition("/msg/")
        message = getattr(importlib.import_module(f"{package}.msg"), kind)
        self.publishers.append(self._node.create_publisher(message, name, qos, **options))
        return self.publishers[-1]

    def _greet(self, name: str, event: Any) -> None:
        topic = self._samples[name]
        greeted = event.current_count_change > 0 and self._runner.stands_still and not topic.kept
        if greeted and self._newest and topic.pack:
            topic.publisher.publish(topic.pack(messages.Stamped(*self._newest)))
