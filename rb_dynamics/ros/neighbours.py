"""`Neighbours`: other nodes that publish our topics, and readers that hear nothing because of their QoS."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSCompatibility, ReliabilityPolicy, qos_check_compatible

from rb_dynamics.ros.health import Health

# What is offered, and what a reader may ask beyond it, by the name of the parameter.
_WEAKER = {
    "reliability": (ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE),
    "durability": (DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL),
}
# Where every node may publish.
_SHARED = ("/diagnostics", "/tf", "/tf_static")
# Topics that a warning names.
_NAMED = 3
# How the middleware calls a participant that has not said its name, or is no node.
_UNKNOWN = "_NODE_NAME_UNKNOWN_"


class Neighbours:
    """Looks at each of our topics once a second, one at a time: 40 µs each, and only where something is amiss more."""

    def __init__(
        self,
        node: Node,
        publishers: Sequence[Publisher],
        health: Health,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin to look at `publishers`, which may grow, and tell `health`; `clock` is steady, s."""
        self._node, self._publishers, self._health, self._clock = node, publishers, health, clock
        self._shared = {node.resolve_topic_name(topic) for topic in _SHARED}
        self._waiting: list[Publisher] = []
        self._next = clock()
        # What this round has found: by a node what it publishes of ours, by what is said of a reader its topics.
        self._rivals: dict[str, list[str]] = {}
        self._unfit: list[str] = []

    def look(self) -> None:
        """Look at one topic, where it is time to, and after the last say what is so now."""
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
        # A reader that is there and not matched may be on its way still.
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
        offered = publisher.qos_profile
        readers = self._node.get_subscriptions_info_by_topic(topic)
        return [
            f"{topic}: the QoS of the reader {_name(reader)} does not fit, it hears nothing: "
            f"{_remedy(self._node, topic, offered, reader.qos_profile)}"
            for reader in readers
            if qos_check_compatible(offered, reader.qos_profile)[0] == QoSCompatibility.ERROR
        ]


def _remedy(node: Node, topic: str, offered: Any, asked: Any) -> str:
    """Return what there is to do for a reader that asks more than is offered."""
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
        return "a node whose name is not known"
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def _some(topics: Iterable[str]) -> str:
    named = list(topics)
    more = len(named) - _NAMED
    return ", ".join(named[:_NAMED]) + (f" and {more} more" if more > 0 else "")
