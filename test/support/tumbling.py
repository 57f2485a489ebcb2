"""Recordings of a tumbling, drifting body, exact except for the given noise, and the results of the checks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from bag_rows import add_stamped

from rb_dynamics.analysis.checks import Check
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import RunSummary, summarize
from rb_dynamics.formats import cdr
from rb_dynamics.formats.topic_messages import Topic
from rb_dynamics.logs.bag_reader import Bag
from rb_dynamics.numerics.rotation_arrays import rotate_all, rotate_all_inverse

POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"
WRENCH = "geometry_msgs/msg/WrenchStamped"
SPIN_AXIS = np.array([0.48, 0.6, 0.64])
EVERY_NS = 10_000_000


@dataclass
class Tumble:
    """Rows over time; the velocity in world axes, the rate in body axes."""

    time_ns: Any
    position: Any
    orientation_xyzw: Any
    velocity: Any
    rate: Any

    def turned(self, angle: float) -> Any:
        """Return the attitudes turned by `angle` (rad) about the axis of the spin."""
        return _product(self.orientation_xyzw, np.array([*np.sin(0.5 * angle) * SPIN_AXIS, np.cos(0.5 * angle)]))

    def taken(self, rows: Any, *, keep_times: bool = False) -> Tumble:
        """Return only these rows, at their times or at those of the first ones."""
        times = self.time_ns[: len(rows)] if keep_times else self.time_ns[rows]
        return Tumble(times, self.position[rows], self.orientation_xyzw[rows], self.velocity[rows], self.rate[rows])

    def moved(self, by_ns: int) -> Tumble:
        """Return the same at other times."""
        return replace(self, time_ns=self.time_ns + by_ns)


def spin(
    rate: float = 2.0, speed: float = 0.3, noise: float = 0.0, stamps: str = "even", count: int = 1000, seed: int = 1
) -> Tumble:
    """Return a body that spins about `SPIN_AXIS` and flies a circle; `noise` of the pose in m, and rad of its half."""
    random = np.random.default_rng(seed)
    time_ns = EVERY_NS * np.arange(count)
    if stamps == "jitter":
        time_ns = time_ns + random.integers(-EVERY_NS // 3, EVERY_NS // 3, count)
    elif stamps == "random":
        time_ns = np.cumsum(random.exponential(EVERY_NS, count)).astype(np.int64) + np.arange(count)
    time_ns = time_ns - time_ns[0]
    t = time_ns * 1e-9
    half = 0.5 * rate * t[:, None]
    orientation = np.hstack([np.sin(half) * SPIN_AXIS, np.cos(half)])
    orientation[:, :3] += 0.5 * noise * random.standard_normal((count, 3))
    orientation /= np.linalg.norm(orientation, axis=1, keepdims=True)
    flat = np.zeros_like(t)
    return Tumble(
        time_ns,
        speed * np.column_stack([np.sin(t), -np.cos(t), flat]) + noise * random.standard_normal((count, 3)),
        orientation,
        speed * np.column_stack([np.cos(t), np.sin(t), flat]),
        np.tile(rate * SPIN_AXIS, (count, 1)),
    )


def bag_of(
    motion: Tumble,
    *,
    twist: Tumble | None = None,
    with_twist: bool = True,
    twist_frame: str = "base",
    twist_rows: Any = None,
    wrench: bool = False,
    logged_later_ns: Any = 0,
) -> Bag:
    """Return a bag of this motion.

    `twist` is the motion recorded as twist, `twist_rows` replaces its values; `wrench` adds a zero wrench.
    """
    topics = [Topic("/b/pose", POSE)]
    rows = np.hstack([motion.position, motion.orientation_xyzw])
    fill(topics[0], motion.time_ns, "world", rows, logged_later_ns)
    if with_twist:
        told = twist or motion
        body = np.hstack([rotate_all_inverse(told.orientation_xyzw, told.velocity), told.rate])
        topics.append(Topic("/b/twist", TWIST))
        fill(topics[1], told.time_ns, twist_frame, body if twist_rows is None else twist_rows, logged_later_ns)
    if wrench:
        topics.append(Topic("/w", WRENCH))
        fill(topics[-1], motion.time_ns[:1], "base", np.zeros((1, 6)), 0)
    return Bag(Path("tumble.mcap"), True, {topic.name: topic for topic in topics}, {}, {})


def fill(topic: Topic, time_ns: Any, frame: str, rows: Any, logged_later_ns: Any) -> None:
    """Add a stamped message for each row."""
    logged = time_ns + logged_later_ns
    add_stamped(topic, logged, time_ns, rows, lambda stamp, row: cdr.encode(topic.type_name, stamp, frame, row))


def summary_of(bag: Bag) -> RunSummary:
    return summarize(read_track(bag))


def checks_of(bag: Bag) -> tuple[Check, ...]:
    return summary_of(bag).checks


def failing(bag: Bag) -> dict[str, str]:
    """Return the checks that fail, and what they say."""
    return {check.name: check.detail for check in checks_of(bag) if not check.passed}


def in_world(motion: Tumble) -> Any:
    """Return the twist in world axes."""
    return np.hstack([motion.velocity, rotate_all(motion.orientation_xyzw, motion.rate)])


def _product(one: Any, other: Any) -> Any:
    axis, w = one[:, :3], one[:, 3:]
    vector = w * other[:3] + other[3] * axis + np.cross(axis, other[:3])
    return np.hstack([vector, w * other[3] - (axis @ other[:3])[:, None]])
