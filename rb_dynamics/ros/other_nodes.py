"""`Neighbours`: finds other nodes that publish our topics, and readers with incompatible QoS; `unconnected` readers.

`unheard_commands` finds commands to actuators that are not there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from rclpy.duration import Infinite
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSCompatibility, ReliabilityPolicy, qos_check_compatible

from rb_dynamics.formats.message_types import COMMAND, SCALAR
from rb_dynamics.ros.health import Health

# By parameter name: the policy offered, and the one a reader may request beyond it.
_WEAKER = {
    "reliability": (ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE),
    "durability": (DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL),
}
# Topics that every node may publish.
_SHARED = ("/diagnostics", "/tf", "/tf_static")
# Number of topics named in a warning.
_NAMED = 3
# Names that the middleware reports for a participant that has no name yet, or is not a node.
_UNKNOWN = "_NODE_NAME_UNKNOWN_"


class Neighbours:
    """Checks our topics once a second, one at a time: 40 µs each, and more only if something is wrong."""

    def __init__(
        self,
        node: Node,
        publishers: Sequence[Publisher],
        health: Health,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Check `publishers`, which may grow, and report to `health`; `clock` is steady, s."""
        self._node, self._publishers, self._health, self._clock = node, publishers, health, clock
        self._shared = {node.resolve_topic_name(topic) for topic in _SHARED}
        self._waiting: list[Publisher] = []
        self._next = clock()
        # Results of this round: our topics by node that also publishes them, and topics by problem of a reader.
        self._rivals: dict[str, list[str]] = {}
        self._unfit: list[str] = []

    def look(self) -> None:
        """Check one topic if it is time, and after the last one report the result."""
        now = self._clock()
        if now < self._next:
            return
        if not self._waiting:
            self._waiting = list(reversed(self._publishers))
        self._next = now + 1.0 / len(self._publishers)
        publisher = self._waiting.pop()
        topic = publisher.topic_name
        if topic not in self._shared and self._node.count_publishers(topic) > 1:
            for rival in self._others(topic):
                self._rivals.setdefault(rival, []).append(topic)
        # An unmatched reader may still be connecting.
        if self._node.count_subscribers(topic) > publisher.get_subscription_count():
            self._unfit += self._misfits(topic, publisher)
        if not self._waiting:
            self._say()

    def _say(self) -> None:
        rivals = "; ".join(f"{_some(topics)} by {name}" for name, topics in self._rivals.items())
        remedy = "stop one, give one a namespace (-r __ns:=/NAME), or, where it is the clock, set publish_clock once"
        self._health.holds(
            "rivals", rivals and f"another publisher of what this node publishes: {rivals}; expected one: {remedy}"
        )
        self._health.holds("unfit", "; ".join(self._unfit))
        self._rivals, self._unfit = {}, []

    def _others(self, topic: str) -> list[str]:
        names = [_name(each) for each in self._node.get_publishers_info_by_topic(topic)]
        own = self._node.get_fully_qualified_name()
        if own in names:
            names.remove(own)
        return [f"{name} (of the same name)" if name == own else name for name in names]

    def _misfits(self, topic: str, publisher: Publisher) -> list[str]:
        readers = self._node.get_subscriptions_info_by_topic(topic)
        return [
            f"{topic}: the QoS of the reader {_name(reader)} is incompatible, it receives nothing: "
            f"{_remedy(self._node, topic, publisher.qos_profile, reader.qos_profile)}"
            for reader in readers
            if not _suits(publisher, reader)
        ]


def unconnected(node: Node, publishers: Iterable[Publisher]) -> dict[str, tuple[int, int]]:
    """Return how many readers are connected, and how many could be, for each topic where these are more."""
    found = {}
    for publisher in publishers:
        kind = f"{publisher.msg_type.__module__.partition('.')[0]}/msg/{publisher.msg_type.__name__}"
        readers = node.get_subscriptions_info_by_topic(publisher.topic_name)
        fitting = sum(reader.topic_type == kind and _suits(publisher, reader) for reader in readers)
        if (connected := publisher.get_subscription_count()) < fitting:
            found[publisher.topic_name] = connected, fitting
    return found


def unheard_commands(node: Node) -> list[str]:
    """Return the topics NAME/command in the namespace of `node` that are published as Float64 and that no node reads.

    The node cannot hear what it does not subscribe to, but the graph tells of it.
    """
    start = node.get_namespace().rstrip("/") + "/"
    return [
        topic
        for topic, kinds in node.get_topic_names_and_types()
        if SCALAR in kinds
        and topic.startswith(start)
        and topic.endswith(COMMAND)
        and topic.count("/") == start.count("/") + 1
        and not node.count_subscribers(topic)
    ]


def _suits(publisher: Publisher, reader: Any) -> bool:
    """Return whether the QoS of a publisher offers what a reader asks for."""
    offered = publisher.qos_profile
    # What is not set is 0 there, and infinite where the graph tells of it.
    for name in ("deadline", "lifespan", "liveliness_lease_duration"):
        if not getattr(offered, name).nanoseconds:
            setattr(offered, name, Infinite)
    return bool(qos_check_compatible(offered, reader.qos_profile)[0] != QoSCompatibility.ERROR)


def _remedy(node: Node, topic: str, offered: Any, asked: Any) -> str:
    """Return the remedy for a reader that requests more than is offered."""
    less, more = [], []
    for policy, (weak, strong) in _WEAKER.items():
        if (getattr(offered, policy), getattr(asked, policy)) == (weak, strong):
            less.append(weak.name)
            name = f"qos_overrides.{topic}.publisher.{policy}"
            more += [f"-p {name}:={strong.name.lower()}"] if node.has_parameter(name) else []
    let = f"let it ask {' and '.join(less) or 'for no more deadline, lifespan or liveliness than is offered'}"
    return f"{let}, or start this node with {' '.join(more)}" if more else let


def _name(endpoint: Any) -> str:
    if endpoint.node_name == _UNKNOWN:
        return "a node of unknown name"
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def _some(topics: Iterable[str]) -> str:
    named = list(topics)
    more = len(named) - _NAMED
    return ", ".join(named[:_NAMED]) + (f" and {more} more" if more > 0 else "")
