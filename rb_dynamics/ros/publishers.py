"""`TopicSink`: the node's publishers behind the interface of a sink.

Samples are published as the bytes that a log has. Making a message only for the middleware to take it apart again
would cost several times as much.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import AccelStamped, InertiaStamped, PoseStamped, TwistStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64

from rb_dynamics.formats import cdr
from rb_dynamics.numerics.nanoseconds import split_stamp
from rb_dynamics.numerics.rotation import rotate_inverse
from rb_dynamics.ros import conversions
from rb_dynamics.ros.health import Health
from rb_dynamics.run.diagnostics import Sample
from rb_dynamics.run.sink import Event, RunInfo, Status
from rb_dynamics.scene.model import Scene

_SCALAR = cdr.float64_packer()
_OVERRIDABLE = (
    QoSPolicyKind.HISTORY,
    QoSPolicyKind.DEPTH,
    QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY,
)

# Makes a message, or the bytes of one, of a sample and its stamp in seconds and nanoseconds.
_Make = Callable[[Sample, tuple[int, int]], object]


@dataclass(frozen=True)
class Topics:
    """Which topics there are beside those that are always published, and how many samples each of them keeps."""

    depth: int = 10
    clock: bool = False
    transforms: bool = False
    acceleration: bool = False


class TopicSink:
    """Publishes every sample on the topics of the node; a topic that nobody reads costs nothing.

    While time stands still, a reader that joins is greeted with the newest sample, so that it sees where the body is.
    No stamp is ever zero: to tf2 that means "the newest", and to whoever reads `/clock` "not begun". The initial state,
    at time 0, is stamped 1 ns.
    """

    def __init__(
        self,
        node: Node,
        scene: Scene,
        topics: Topics,
        health: Health,
        offset_ns: Callable[[], int | None],
        still: Callable[[], bool],
    ) -> None:
        """Create the publishers on `node`, all of which are in `publishers`.

        Args:
            node: creates the publishers.
            scene: that of the first run.
            topics: which ones beside the usual.
            health: counts readers whose QoS does not fit.
            offset_ns: tells how far stamps are ahead of simulation time; None while that is not known and nothing is
                published.
            still: tells whether time stands still, so that readers are to be greeted.
        """
        self._node, self._health, self._offset_ns, self._still = node, health, offset_ns, still
        self._asked = topics
        self._newest: tuple[Sample, tuple[int, int]] | None = None
        self._frames = scene.frames
        transient = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._inertia = node.create_publisher(InertiaStamped, "inertia", transient)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 1)
        self.publishers = [self._inertia, self._diagnostics]
        self._samples: list[tuple[Publisher, _Make, bool]] = []
        self._has_potential = False
        if topics.clock:
            self._add(Clock, "/clock", lambda _, t: Clock(clock=conversions.stamp(t)))
        self._add(PoseStamped, "pose", lambda s, t: self._pose(*t, *s.position_world, *s.orientation_xyzw))
        self._add(TwistStamped, "twist", lambda s, t: self._twist(*t, *_twist(s)))
        self._add(
            Odometry,
            "odom",
            lambda s, t: self._odometry(*t, (*s.position_world, *s.orientation_xyzw), _twist(s)),
        )
        self._add(Vector3Stamped, "angular_momentum", lambda s, t: self._vector(*t, *s.angular_momentum_world))
        self._add(Vector3Stamped, "linear_momentum", lambda s, t: self._vector(*t, *s.linear_momentum_world))
        self._add(Float64, "energy/kinetic", lambda s, _: _SCALAR(s.kinetic_energy))
        self._add(Float64, "energy/work", lambda s, _: _SCALAR(s.work))
        self._add(Float64, "energy/defect", lambda s, _: _SCALAR(s.energy_defect))
        if topics.transforms:
            self._add_transforms()
        if topics.acceleration:
            self._add(AccelStamped, "accel", lambda _, t: self._accel(*t, *itertools.chain(*self._acceleration())))
        self._add_potential(scene)

    def open(self, run: RunInfo) -> None:
        """Publish what is simulated; late subscribers get it too (transient local)."""
        self._frames = run.scene.frames
        self._prepare()
        if run.acceleration is not None:
            self._acceleration = run.acceleration
        self._add_potential(run.scene)
        stamp_ns = self._stamp_ns(run.scene.initial.time_ns) or 1
        self._inertia.publish(conversions.inertia(run.scene.body, self._frames.body_frame, stamp_ns))
        if self._asked.transforms and self._frames.fixed:
            self._static.publish(conversions.static_transforms(self._frames, stamp_ns))

    def write(self, event: Event) -> None:
        """Publish a sample or a status; wrenches are not echoed."""
        if isinstance(event, Sample):
            stamp_ns = self._stamp_ns(event.time_ns)
            if stamp_ns is None:
                return
            self._newest = event, split_stamp(stamp_ns)
            for publisher, make, kept in self._samples:
                if kept or publisher.get_subscription_count():
                    publisher.publish(make(*self._newest))
        elif isinstance(event, Status) and self.status_is_read:
            status = replace(event, time_ns=self._stamp_ns(event.time_ns) or 1)
            self._diagnostics.publish(conversions.diagnostics(status, self._frames.body_frame))

    @property
    def status_is_read(self) -> bool:
        """Whether anybody reads `/diagnostics`; to put a status together takes 0.2 ms."""
        return bool(self._diagnostics.get_subscription_count())

    def close(self, result: Mapping[str, str]) -> None:
        """Wait, briefly, until readers have what was published last."""
        for publisher, _, _ in self._samples:
            publisher.wait_for_all_acked(Duration(seconds=0.2))

    def _stamp_ns(self, time_ns: int) -> int | None:
        offset_ns = self._offset_ns()
        return None if offset_ns is None else max(1, time_ns + offset_ns)

    def _prepare(self) -> None:
        """Prepare what packs messages, for the frames as they are called."""
        world, body = self._frames.world_frame, self._frames.body_frame
        self._pose = cdr.stamped_packer("geometry_msgs/msg/PoseStamped", world)
        self._twist = cdr.stamped_packer("geometry_msgs/msg/TwistStamped", body)
        self._odometry = cdr.odometry_packer(world, body)
        self._vector = cdr.stamped_packer("geometry_msgs/msg/Vector3Stamped", world)
        self._accel = cdr.stamped_packer("geometry_msgs/msg/AccelStamped", body)

    def _add_transforms(self) -> None:
        # What the broadcaster of tf2_ros sends, on the same topics; but what nobody reads is not made.
        from tf2_msgs.msg import TFMessage

        self._add(TFMessage, "/tf", lambda s, t: conversions.transform(s, t, self._frames))
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._static = self._node.create_publisher(TFMessage, "/tf_static", latched)
        self.publishers.append(self._static)

    def _add_potential(self, scene: Scene) -> None:
        if not self._has_potential and scene.combined_effects.potential() is not None:
            self._add(Float64, "energy/potential", lambda s, _: _SCALAR(s.potential_energy))
            self._has_potential = True

    def _add(self, kind: type, topic: str, make: _Make) -> None:
        def greet(event: Any) -> None:
            if event.current_count_change > 0 and self._newest is not None and self._still() and not kept:
                publisher.publish(make(*self._newest))

        publisher = self._node.create_publisher(
            kind,
            topic,
            self._asked.depth,
            event_callbacks=PublisherEventCallbacks(
                matched=greet, incompatible_qos=lambda event: self._health.mismatched(topic, event.total_count_change)
            ),
            qos_overriding_options=QoSOverridingOptions(_OVERRIDABLE),
        )
        # What is kept for readers that come later is there before they are.
        kept = publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self._samples.append((publisher, make, kept))
        self.publishers.append(publisher)


def _twist(sample: Sample) -> tuple[float, ...]:
    """Return the velocity of the body origin and the angular velocity, body axes."""
    velocity_body = rotate_inverse(sample.orientation_xyzw, sample.linear_velocity_world)
    return (*velocity_body, *sample.angular_velocity_body)
