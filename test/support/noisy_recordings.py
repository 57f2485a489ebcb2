"""Recordings of random motions of random bodies with the noise and stamps of sensors."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bag_rows import add_stamped

from rb_dynamics import State
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.formats import cdr
from rb_dynamics.logs.bag_reader import Bag, Topic
from rb_dynamics.numerics.rotation_arrays import rotate_all_inverse
from rb_dynamics.run.ensemble import driven_motion
from rb_dynamics.scene import parse_scene
from rb_dynamics.scene.model import Scene

POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"
WRENCH = "geometry_msgs/msg/WrenchStamped"
STEP_NS = 100_000_000
CHANNELS = "wrenches: [{topic: torque}, {topic: force}]"


@dataclass(frozen=True)
class Recording:
    """What `recording` made.

    Attributes:
        bag: of pose and twist with noise, and the commands.
        body: which flew.
        facts: what it was, for a person.
    """

    bag: Bag
    body: RigidBody
    facts: dict[str, Any]

    def scene(self, moments: float = 1.0, mass: float = 1.0) -> Scene:
        """Return the scene of the body, its smallest moment and its mass times these factors."""
        values, axes = np.linalg.eigh(np.array(self.body.inertia))
        values[0] *= moments
        return scene_of(self.body.mass * mass, (axes * values) @ axes.T, self.body.center_of_mass)


def scene_of(mass: float, inertia: Any, center: Any) -> Scene:
    matrix = (0.5 * (np.array(inertia) + np.array(inertia).T)).tolist()
    body = f"body: {{frame: base, mass: {mass!r}, center_of_mass: {list(center)}, inertia: {{matrix: {matrix}}}}}"
    return parse_scene(f"{body}\n{CHANNELS}\n")


@functools.cache
def recording(seed: int, uncommanded: float = 0.0) -> Recording:
    """Return a recording; `uncommanded` is an unrecorded torque about a fixed body axis, N m.

    It acts for the middle third; as a multiple of the largest moment times rad/s^2.
    """
    random = np.random.default_rng(seed)
    rate = random.uniform(50.0, 400.0)
    count = int(min(1000, rate * random.uniform(6.0, 20.0)))
    stamps = random.choice(["even", "jitter", "random"])
    commanded, with_pose = bool(random.random() < 0.6), bool(random.random() < 0.85)
    gyro, speed = 10 ** random.uniform(-4.0, np.log10(5e-3)), 10 ** random.uniform(-4.0, -2.0)
    tracker = random.choice([0.0, 1.0]) * 10 ** random.uniform(-4.0, -3.0)
    body = _body(random)
    times = _times(random, stamps, rate, count)
    changes = np.arange(0, times[-1], STEP_NS) + int(random.choice([0, 1]) * random.integers(0, STEP_NS))
    torques = commanded * random.standard_normal((len(changes), 3)) * 0.1 * max(body.principal_moments)
    forces = commanded * random.standard_normal((len(changes), 3)) * 0.05 * body.mass
    knots = np.union1d(times, changes)
    held = np.searchsorted(changes, knots, side="left") - 1  # what acts until each knot
    wrong = uncommanded * max(body.principal_moments) * _unit(random)
    thirds = (knots > times[-1] // 3) & (knots <= 2 * times[-1] // 3)
    torque = np.where(held[:, None] >= 0, torques[held], 0.0) + np.where(thirds[:, None], wrong, 0.0)
    state = State(
        position_world=(0.0, 0.0, 0.0),
        orientation_xyzw=(0.0, 0.0, 0.0, 1.0),
        linear_velocity_world=tuple((0.3 * random.standard_normal(3)).tolist()),
        angular_velocity_body=tuple((10 ** random.uniform(-1.0, 0.5) * _unit(random)).tolist()),
    )
    flown = driven_motion(
        body,
        state,
        knots,
        method="rkmk4",
        step=0.01,
        torque_body=torque,
        force_world=np.where(held[:, None] >= 0, forces[held], 0.0),
    )
    at = np.searchsorted(knots, times)
    attitude = np.asarray(flown.orientation_xyzw)[at]
    velocity = rotate_all_inverse(attitude, np.asarray(flown.linear_velocity_world)[at])
    rates = np.asarray(flown.angular_velocity_body)[at] + gyro * random.standard_normal((count, 3))
    velocity += speed * random.standard_normal((count, 3))
    position = np.asarray(flown.position_world)[at] + tracker * random.standard_normal((count, 3))
    attitude = attitude + np.pad(0.5 * tracker * random.standard_normal((count, 3)), ((0, 0), (0, 1)))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    topics = [_topic("/b/twist", TWIST, times, "base", np.hstack([velocity, rates]))]
    if with_pose:
        topics.append(_topic("/b/pose", POSE, times, "world", np.hstack([position, attitude])))
    if commanded:
        nothing = np.zeros_like(torques)
        topics.append(_topic("/torque", WRENCH, changes, "base", np.hstack([nothing, torques])))
        topics.append(_topic("/force", WRENCH, changes, "world", np.hstack([forces, nothing])))
    else:
        # That nothing acted is known, too.
        topics.append(_topic("/torque", WRENCH, times[:1], "base", np.zeros((1, 6))))
    bag = Bag(Path("noisy.mcap"), True, {topic.name: topic for topic in topics}, {}, {})
    facts = {"rate": rate, "count": count, "stamps": str(stamps), "commanded": commanded, "with_pose": with_pose}
    return Recording(bag, body, {**facts, "gyro": gyro, "speed": speed, "tracker": tracker})


def pushed(seed: int, gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Recording:
    """Return a recording of a body pushed along its x axis for 10 s, with far more noise in attitude than in speed."""
    random, times, body = np.random.default_rng(seed), np.arange(1000) * 10_000_000, _body(np.random.default_rng(seed))
    still, push = np.zeros((1000, 3)), np.array([[0.5 * body.mass, 0.0, 0.0]])
    position, velocity = (np.outer(factor, (1.0, 0.0, 0.0)) for factor in (0.25e-18 * times**2.0, 0.5e-9 * times))
    position, velocity = position + np.outer(0.5e-18 * times**2.0, gravity), velocity + np.outer(1e-9 * times, gravity)
    center = still - np.array(body.center_of_mass)
    attitude = np.hstack([1.5e-3 * random.standard_normal((1000, 3)), np.ones((1000, 1))])
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    speed = velocity + 1e-4 * random.standard_normal((1000, 3))
    rates = 1e-4 * random.standard_normal((1000, 3))
    topics = [
        _topic("/pose", POSE, times, "world", np.hstack([center + position, attitude])),
        _topic("/twist", TWIST, times, "world", np.hstack([speed, rates])),
        _topic("/force", WRENCH, times[:1], "base", np.hstack([push, still[:1]])),
    ]
    return Recording(Bag(Path("pushed.mcap"), True, {topic.name: topic for topic in topics}, {}, {}), body, {})


def spun_up(torque_world: tuple[float, float, float]) -> Recording:
    """Return a recording of a body that an unrecorded torque turns ever faster, so that attitude noise counts more."""
    body = _body(np.random.default_rng(5))
    torque = max(body.principal_moments) * np.array(torque_world)
    return _turning(body, (0.1, 0.2, 0.3), np.arange(7200) * 12_500_000, torque, 3e-3, 1e-3)


def flipping(seed: int) -> Recording:
    """Return a recording of a free body that turns over again and again, as it spins about its middle axis."""
    random = np.random.default_rng(seed)
    turn, moments = np.linalg.qr(random.standard_normal((3, 3)))[0], np.sort(random.uniform(0.5, 0.9, 3))
    body = RigidBody.from_matrix(8.0, (turn @ np.diag(moments) @ turn.T).tolist())
    axes = np.linalg.eigh(np.array(body.inertia))[1]
    rates = axes @ [1e-3 * random.standard_normal(), 1.5, 1e-3 * random.standard_normal()]
    return _turning(body, tuple(rates.tolist()), np.arange(2000) * 20_000_000, np.zeros(3), 1e-3, 2e-3)


def shaken() -> Recording:
    """Return a recording without noise of a body under an unrecorded torque that varies quickly."""
    body, times = _body(np.random.default_rng(5)), np.arange(1000) * 20_000_000
    torque = 0.3 * max(body.principal_moments) * np.sin(np.outer(1e-9 * times, (7.0, 5.0, 3.0)))
    return _turning(body, (0.5, 0.8, -0.6), times, torque, 0.0, 0.0)


def _turning(body: RigidBody, rates: Any, times: Any, torque: Any, tracker: float, gyro: float) -> Recording:
    """Return a recording of a body under a torque in world axes, or one to each time.

    `tracker` and `gyro` are noise, rad and rad/s.
    """
    random, count = np.random.default_rng(5), len(times)
    start = State(angular_velocity_body=rates)
    flown = driven_motion(
        body, start, times, method="rkmk4", step=0.01, torque_world=np.broadcast_to(torque, (count, 3))
    )
    noise = np.pad(0.5 * tracker * random.standard_normal((count, 3)), ((0, 0), (0, 1)))
    attitude = np.asarray(flown.orientation_xyzw) + noise
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    velocity = rotate_all_inverse(np.asarray(flown.orientation_xyzw), np.asarray(flown.linear_velocity_world))
    measured = np.asarray(flown.angular_velocity_body) + gyro * random.standard_normal((count, 3))
    topics = [
        _topic("/pose", POSE, times, "world", np.hstack([np.asarray(flown.position_world), attitude])),
        _topic("/twist", TWIST, times, "base", np.hstack([velocity, measured])),
    ]
    return Recording(Bag(Path("turning.mcap"), True, {topic.name: topic for topic in topics}, {}, {}), body, {})


def _topic(name: str, type_name: str, times: Any, frame: str, rows: Any) -> Topic:
    topic = Topic(name, type_name)
    add_stamped(topic, times, times, rows, lambda stamp, row: cdr.encode(type_name, stamp, frame, row))
    return topic


def _unit(random: Any) -> Any:
    vector = random.standard_normal(3)
    return vector / np.linalg.norm(vector)


def _body(random: Any) -> RigidBody:
    """Return a body of 1 to 100 kg: a cloud of points of some shape."""
    points = random.standard_normal((8, 3)) * random.uniform(0.05, 0.5, 3)
    mass = float(10 ** random.uniform(0.0, 2.0))
    points -= points.mean(axis=0)
    second = mass * points.T @ points / len(points)
    turn = np.linalg.qr(random.standard_normal((3, 3)))[0]
    inertia = turn @ (np.trace(second) * np.eye(3) - second) @ turn.T
    center = random.choice([0.0, 1.0]) * 0.1 * random.standard_normal(3)
    return RigidBody.from_matrix(mass, (0.5 * (inertia + inertia.T)).tolist(), center.tolist())


def _times(random: Any, stamps: str, rate: float, count: int) -> Any:
    even = np.arange(count) / rate
    if stamps == "jitter":
        even = even + np.concatenate([[0.0], random.uniform(-0.3, 0.3, count - 1)]) / rate
    elif stamps == "random":
        even = np.concatenate([[0.0], np.cumsum(random.exponential(0.8, count - 1) + 0.2)]) / rate
    return np.rint(even * 1e9).astype(np.int64)
