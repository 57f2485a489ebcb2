"""`TopicSink`: the node's publishers behind the same interface as the logs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import AccelStamped, InertiaStamped, PoseStamped, TwistStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64

from rb_dynamics.diagnostics import Sample
from rb_dynamics.loads.wrench import WrenchFrames
from rb_dynamics.recording.sink import Event, RunInfo, Status
from rb_dynamics.ros import conversions
from rb_dynamics.vector import Vector

_DEPTH = 10


_Make = Callable[[Sample], object]


class TopicSink:
    """Publishes every sample on the topics of the node; a topic that nobody reads costs nothing.

    While time stands still, a reader that joins is greeted with the newest sample, so that it sees where the body is.
    """

    def __init__(self, node: Node, frames: WrenchFrames, publish_clock: bool, stands_still: Callable[[], bool]) -> None:
        """Create the publishers on `node`; `stands_still` says whether readers are to be greeted."""
        self._node, self._frames, self._stands_still = node, frames, stands_still
        self._newest: Sample | None = None
        transient = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._inertia = node.create_publisher(InertiaStamped, "inertia", transient)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 1)
        self._samples: list[tuple[Publisher, _Make]] = []
        if publish_clock:
            self._add(Clock, "/clock", lambda s: Clock(clock=conversions.to_stamp(s.time_ns)))
        self._add(PoseStamped, "pose", lambda s: conversions.pose(s, frames))
        self._add(TwistStamped, "twist", lambda s: conversions.twist(s, frames))
        self._add(Odometry, "odom", lambda s: conversions.odometry(s, frames))
        world = frames.world_frame
        self._add(
            Vector3Stamped,
            "angular_momentum",
            lambda s: conversions.vector(s.angular_momentum_world, s.time_ns, world),
        )
        self._add(
            Vector3Stamped, "linear_momentum", lambda s: conversions.vector(s.linear_momentum_world, s.time_ns, world)
        )
        self._add(Float64, "energy/kinetic", lambda s: Float64(data=s.kinetic_energy))
        self._add(Float64, "energy/work", lambda s: Float64(data=s.work))
        self._add(Float64, "energy/defect", lambda s: Float64(data=s.energy_defect))

    def add_potential(self) -> None:
        """Publish `energy/potential` too."""
        self._add(Float64, "energy/potential", lambda s: Float64(data=s.potential_energy))

    def add_acceleration(self, acceleration: Callable[[], tuple[Vector, Vector]]) -> None:
        """Publish `accel` too; `acceleration` tells it for the time of the sample that is being written."""
        self._add(AccelStamped, "accel", lambda s: conversions.accel(*acceleration(), s.time_ns, self._frames))

    def open(self, run: RunInfo) -> None:
        """Publish what is simulated; late subscribers get it too (transient local)."""
        self._inertia.publish(conversions.inertia(run.scene.body, self._frames.body_frame))

    def write(self, event: Event) -> None:
        """Publish a sample or a status; wrenches are not echoed."""
        if isinstance(event, Sample):
            self._newest = event
            for publisher, make in self._samples:
                if publisher.get_subscription_count():
                    publisher.publish(make(event))
        elif isinstance(event, Status):
            self._diagnostics.publish(conversions.diagnostics(event, self._frames.body_frame))

    def close(self, result: Mapping[str, str]) -> None:
        """Wait, briefly, until readers have what was published last."""
        for publisher, _ in self._samples:
            publisher.wait_for_all_acked(Duration(seconds=0.2))

    def _add(self, kind: type, topic: str, make: _Make) -> None:
        def greet(event: Any) -> None:
            if event.current_count_change > 0 and self._newest is not None and self._stands_still():
                publisher.publish(make(self._newest))

        publisher = self._node.create_publisher(
            kind,
            topic,
            _DEPTH,
            event_callbacks=PublisherEventCallbacks(matched=greet),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        self._samples.append((publisher, make))
