"""`onboard`: what the wheels, commands and sensors of a log of this package did: speeds, limits, measured beside true.

The true value is that of the log at an output; a sensor's sample between two outputs has none to compare with.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from rb_dynamics.analysis.track import Array, Times, TimeSeries, Track, unit_rows
from rb_dynamics.errors import WrenchError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.formats.joint_states import velocities
from rb_dynamics.formats.message_types import JOINTS
from rb_dynamics.formats.topic_messages import Topic, unread_words
from rb_dynamics.loads.actuator import Actuator
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.logs.messages import WHEELS
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.rotation_arrays import rotations_between
from rb_dynamics.numerics.vector import Vector
from rb_dynamics.scene.model import Scene
from rb_dynamics.sensors.sensor import Sensor, Truth

_UNITS = {
    "angular_velocity": "rad/s",
    "orientation_xyzw": "rad",
    "magnetic_field": "T",
    "direction": "rad",
    "position_world": "m",
}
# Comparing one sample takes some 10 us; more would not make the figures better.
_MOST = 20_000
# A wheel that is held at its limit is off it by rounding.
_AT_LIMIT = 1.0 - 1e-9


@dataclass(frozen=True)
class WheelSpeeds:
    """The speed of a reaction wheel relative to the body.

    Attributes:
        name: of the wheel.
        max_speed: rad/s; infinite for no limit.
        time_ns: times of the outputs.
        speed: rad/s, one for each.
        rate: largest angular velocity of the body, rad/s; 0 where it is not recorded.
    """

    name: str
    max_speed: float
    time_ns: Times
    speed: Array
    rate: float = 0.0

    @property
    def first(self) -> float:
        """At the first output."""
        return float(self.speed[0])

    @property
    def last(self) -> float:
        """At the last one."""
        return float(self.speed[-1])

    @property
    def largest(self) -> float:
        """The largest magnitude."""
        return float(np.abs(self.speed).max())

    @property
    def largest_ns(self) -> int:
        """When it had that magnitude."""
        return int(self.time_ns[np.abs(self.speed).argmax()])

    @property
    def at_limit_s(self) -> float:
        """How long it was at its limit, s: between two successive outputs that both show it there."""
        there = np.abs(self.speed) >= _AT_LIMIT * self.max_speed
        return int(np.diff(self.time_ns)[there[1:] & there[:-1]].sum()) / NANOSECONDS


@dataclass(frozen=True)
class ActuatorUse:
    """The commands to an actuator.

    Attributes:
        name: of the actuator.
        kind: its `type` in the scene.
        unit: of its commands.
        time_ns: when each was received.
        values: as received, one for each.
        largest: the finite command of largest size, as received; 0 without one.
        limited: how many its limits made smaller.
        rejected: how many it could not honour, such as an on-time that is too short.
    """

    name: str
    kind: str
    unit: str
    time_ns: Times
    values: Array
    largest: float
    limited: int
    rejected: int

    @property
    def commands(self) -> int:
        """How many were received."""
        return len(self.values)


@dataclass(frozen=True)
class SensorErrors:
    """What a sensor measured less what is true, in the samples taken at an output.

    Attributes:
        name: of the sensor.
        quantity: what it measured.
        unit: of the errors.
        count: its messages.
        time_ns: of the samples compared.
        measured: one row for each.
        true: likewise, what a sensor without errors would have measured.
        errors: (n, 3), in the axes of the sensor, of a position those of the world; of an attitude the turn from true
            to measured.
    """

    name: str
    quantity: str
    unit: str
    count: int
    time_ns: Times
    measured: Array
    true: Array
    errors: Array

    @property
    def words(self) -> str:
        """The quantity, with the unit of the errors."""
        return f"{self.quantity.removesuffix('_xyzw').replace('_', ' ')} [{self.unit}]"

    @property
    def compared(self) -> int:
        """How many samples are compared."""
        return len(self.time_ns)

    @property
    def mean(self) -> Array:
        """Of the errors, about each axis."""
        return np.asarray(self.errors.mean(axis=0))

    @property
    def deviation(self) -> Array:
        """Their standard deviation, estimated from the sample; NaN of a single one."""
        if self.compared < 2:
            return np.full(self.errors.shape[1], np.nan)
        return np.asarray(self.errors.std(axis=0, ddof=1))


@dataclass(frozen=True)
class Onboard:
    """What wheels, actuators and sensors did; empty if the scene has none.

    Attributes:
        wheels: their speeds.
        actuators: their commands, of those to which some came.
        sensors: their errors, of those that can be compared.
        topics: what each topic is used for, by its name in the log.
        damaged: how many of a topic's messages only this reading found damaged and left out, as text, by its name in
            the log.
    """

    wheels: tuple[WheelSpeeds, ...] = ()
    actuators: tuple[ActuatorUse, ...] = ()
    sensors: tuple[SensorErrors, ...] = ()
    topics: Mapping[str, str] = field(default_factory=dict)
    damaged: Mapping[str, str] = field(default_factory=dict)

    def warnings(self) -> list[str]:
        """Return what a user should look at, in full sentences."""
        told = [
            f"{wheel.name} was at its max_speed of {wheel.max_speed:g} rad/s for {wheel.at_limit_s:.6g} s."
            for wheel in self.wheels
            if wheel.at_limit_s > 0.0
        ]
        for each in self.actuators:
            for count, what in ((each.limited, "limited"), (each.rejected, "rejected and had no effect")):
                if count:
                    told.append(f"{each.name}: {count} of {each.commands} commands {what}.")
        return told


def onboard(track: Track) -> Onboard:
    """Return what the log of a scene with actuators or sensors says about them."""
    scene = track.scene
    if scene is None or not (scene.actuators or scene.sensors):
        return Onboard()
    called = track.bag.called
    wanted = [*(each.topic for each in scene.actuators), *(each.name for each in scene.sensors), WHEELS[0]]
    found, damaged = _numbers(track, scene, {called(name): name for name in wanted})
    # `read_bag` has told of those that it reads too.
    told = {topic.name for topic in track.bag.topics.values() if topic.damaged}
    uses = {each.topic: "command" for each in scene.actuators} | {each.name: "sensor" for each in scene.sensors}
    return Onboard(
        tuple(_wheels(scene.wheels, *found[WHEELS[0]], _largest_rate(track))) if WHEELS[0] in found else (),
        tuple(_use(each, *found[each.topic]) for each in scene.actuators if each.topic in found),
        tuple(
            part
            for each in scene.sensors
            if each.name in found
            for part in _errors(track, scene, each, *found[each.name])
        ),
        {called(name): use for name, use in (uses | {WHEELS[0]: "wheel speeds"}).items() if name in found},
        {called(name): words for name, words in damaged.items() if called(name) not in told},
    )


def pointing_error(track: Track, target_xyzw: Quaternion) -> TimeSeries | None:
    """Return the angle (rad) from an attitude to that of the body; None if no attitude is recorded."""
    if track.pose is None:
        return None
    attitude = unit_rows(track.pose.values[:, 3:])
    turn = rotations_between(np.broadcast_to(target_xyzw, attitude.shape), attitude)
    return TimeSeries(track.pose.topic, track.pose.time_ns, np.linalg.norm(turn, axis=1))


def _numbers(
    track: Track, scene: Scene, wanted: Mapping[str, str]
) -> tuple[dict[str, tuple[Times, Array]], dict[str, str]]:
    """Return times (ns) and rows of numbers of the topics `wanted`, by the name that the scene has for each.

    Damaged messages are left out; the second mapping says how many of which topic.
    """
    topics: dict[str, Topic] = {}
    speeds: list[tuple[Times, Array]] = []
    count, lost = 0, list[int]()
    names = [wheel.name for wheel in scene.wheels]
    for block in open_source(track.bag.path).blocks():
        kind, name = block.channel.type_name, wanted.get(block.channel.topic)
        if name is None:
            continue
        if kind != JOINTS:
            runs = tuple(place for place, part in enumerate(cdr.LAYOUTS[kind]) if isinstance(part, int))
            topics.setdefault(name, Topic(name, kind, bears=True, fields=runs)).take(block)
            continue
        whole, _, rows = velocities(block, names)
        speeds.append((block.log_times[whole], rows))
        lost += (count + np.flatnonzero(~whole)).tolist()
        count += len(whole)
    found = {name: (topic.stamps, topic.numbers) for name, topic in topics.items()}
    if speeds:
        found[WHEELS[0]] = (np.concatenate([times for times, _ in speeds]), np.vstack([each for _, each in speeds]))
    first_ns, last_ns = track.bag.window_ns or (-(2**63), 2**63 - 1)
    commands = {each.topic for each in scene.actuators}
    for name, (times, rows) in found.items():
        kept = (times >= first_ns) & (times <= last_ns)
        if name in commands:
            # One that is no number came too, and was rejected.
            kept[topics[name].damaged] = False
        else:
            kept &= np.isfinite(rows).all(axis=1)
        found[name] = times[kept], rows[kept]
    damaged = {name: topic.unread for name, topic in topics.items() if topic.damaged}
    damaged |= {WHEELS[0]: unread_words(len(lost), count, lost[0])} if lost else {}
    return {name: (times, rows) for name, (times, rows) in found.items() if len(times)}, damaged


def _largest_rate(track: Track) -> float:
    return 0.0 if track.twist is None else float(np.nanmax(np.abs(track.twist.values[:, 3:]), initial=0.0))


def _wheels(wheels: Iterable[ReactionWheel], times: Times, rows: Array, rate: float) -> Iterator[WheelSpeeds]:
    for place, wheel in enumerate(wheels):
        yield WheelSpeeds(wheel.name, wheel.max_speed, times, rows[:, place], rate)


def _use(actuator: Actuator, times: Times, rows: Array) -> ActuatorUse:
    values, limited, rejected = rows[:, 0], 0, 0
    different, counts = np.unique(values, return_counts=True)
    for value, count in zip(different.tolist(), counts.tolist(), strict=True):
        try:
            limited += count * actuator.accept(value).clipped
        except WrenchError:
            rejected += count
    largest = float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
    return ActuatorUse(actuator.name, actuator.kind, actuator.unit, times, values, largest, limited, rejected)


def _errors(track: Track, scene: Scene, sensor: Sensor, times: Times, rows: Array) -> Iterator[SensorErrors]:
    """Yield the errors of each quantity that pose and twist determine: a specific force needs the acceleration too."""
    if track.pose is None or track.twist is None:
        return
    outputs, at_pose, at_twist = np.intersect1d(track.pose.time_ns, track.twist.time_ns, return_indices=True)
    time_ns, at, at_output = np.intersect1d(times, outputs, return_indices=True)
    some = np.linspace(0, len(time_ns) - 1, min(len(time_ns), _MOST)).astype(int)
    time_ns, at, at_output = time_ns[some], at[some], at_output[some]
    poses, rates = track.pose.values[at_pose[at_output]], track.twist.values[at_twist[at_output], 3:]
    read = sensor.ideal.reading(scene.seed, scene.frames)
    effects = scene.combined_effects
    gravity = effects.gravity()

    def true(time: int, pose: list[float], rate: list[float]) -> tuple[float, ...]:
        (x, y, z, a, b, c, d), (p, q, r) = pose, rate
        field = effects.magnetic_field(time * 1e-9)
        return read(0, Truth((x, y, z), (a, b, c, d), (p, q, r), _unknown, gravity, field)) or ()

    found = [true(*each) for each in zip(time_ns.tolist(), poses.tolist(), rates.tolist(), strict=True)]
    # Out of its view, a sun sensor sends nothing; at the edge, rounding errors may have made it send a message.
    seen = np.array([bool(numbers) for numbers in found], dtype=bool)
    if not seen.any():
        return
    ideal = np.array([numbers for numbers in found if numbers])
    time_ns, measured = time_ns[seen], rows[at[seen]]
    for quantity, columns in sensor.values.items():
        pair = ideal[:, columns], measured[:, columns]
        if quantity not in _UNITS or not np.isfinite(pair[0]).all():
            continue
        errors = rotations_between(*pair) if quantity == "orientation_xyzw" else pair[1] - pair[0]
        yield SensorErrors(sensor.name, quantity, _UNITS[quantity], len(times), time_ns, pair[1], pair[0], errors)


def _unknown() -> tuple[Vector, Vector]:
    return (math.nan, math.nan, math.nan), (math.nan, math.nan, math.nan)
