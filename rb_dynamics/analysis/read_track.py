"""`read_track`: find the topics of one body in a bag, by message type, and put them into a `Track`.

Works on our own logs and on any bag of pose, twist and wrench. Numbers are taken as they are: unusable ones are left
out and counted, stamps out of order are sorted and counted. Mass properties are not guessed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rb_dynamics.analysis.clocks import APART, clock
from rb_dynamics.analysis.track import LARGEST, Array, RecordedWrench, Times, TimeSeries, Track, frame_names, motion_of
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import BodyError, LogError, WrenchError
from rb_dynamics.formats.bag_reader import Bag
from rb_dynamics.formats.messages import (
    APPLIED,
    INERTIA,
    ODOMETRY,
    PLAIN_WRENCH,
    POSE,
    SCALAR,
    TWIST,
    VECTOR,
    WRENCH,
)
from rb_dynamics.loads.wrench import WORLD, HeldWrench, Wrench, WrenchFrames
from rb_dynamics.numerics.rotation_arrays import rotate_all
from rb_dynamics.run.provenance import RUN
from rb_dynamics.scene.model import Scene

WRENCHES = (WRENCH, PLAIN_WRENCH)


def read_track(bag: Bag, scene: Scene | None = None) -> Track:
    """Return what `bag` says about one body; `scene` gives mass properties and frames that a bag does not have.

    Raises:
        LogError: nothing in the bag is a pose, a twist or a wrench, or a message is damaged.
    """
    return _TrackReader(bag, scene).track()


@dataclass(frozen=True)
class Momenta:
    """What pose, twist and mass properties give, at the times which pose and twist share."""

    time_ns: Times
    angular: Array
    linear: Array
    kinetic: Array


def momenta(pose: TimeSeries, twist: TimeSeries, twist_in_world: bool, body: RigidBody) -> Momenta:
    """Return L = R I w (about the centre of mass) and p = m R (v + w x c), world axes, and T; v, w, c in body axes."""
    motion = motion_of(pose, twist, twist_in_world)
    attitude, omega = motion.orientation_xyzw, motion.angular_velocity_body
    velocity = motion.linear_velocity_body + np.cross(omega, np.array(body.center_of_mass))
    spin = omega @ np.array(body.inertia)
    kinetic: Array = np.sum(0.5 * (body.mass * velocity**2 + omega * spin), axis=1)
    linear: Array = body.mass * rotate_all(attitude, velocity)
    return Momenta(motion.time_ns, rotate_all(attitude, spin), linear, kinetic)


class _TrackReader:
    """Looks up topics by type; among several, those next to the ones found, then those named as this package does."""

    def __init__(self, bag: Bag, scene: Scene | None) -> None:
        self.notes: list[str] = []
        if scene is not None and RUN in bag.metadata:
            self.notes.append(
                "The scene given is not used: this log was written by rb_dynamics and brings the body, the frames and "
                "the momenta with which it ran."
            )
            scene = None
        self.bag, self.scene = bag, scene
        self.uses: dict[str, str] = {}
        self.parent = ""

    def track(self) -> Track:
        pose = self._series(("pose", "odom"), (POSE, ODOMETRY), self.bag.poses)
        twist = self._series(("twist", "odom"), (TWIST, ODOMETRY), self.bag.twists, child=True)
        pose, twist = self._on_one_clock(pose), self._on_one_clock(twist)
        own = RUN in self.bag.metadata
        world = self.scene.frames.world_frame if self.scene else pose.frame if pose else "world"
        twist_in_world = twist is not None and twist.frame == world
        frames = self._frames(world, "" if twist is None or twist_in_world else twist.frame)
        wrenches, acted = self._wrenches(frames, own)
        facts = self.bag.metadata.get(RUN, {})
        if unlogged := facts.get("effects_not_logged_as_wrench", ""):
            acted = False
            self.notes.append(
                f"Effects acted whose force and torque are not in the log ({unlogged}): momentum is not judged; energy "
                "is, as the run booked their work."
            )
        if pose is None and twist is None and not wrenches:
            found = ", ".join(f"{t.name} ({t.type_name})" for t in self.bag.topics.values()) or "no topics"
            raise LogError(
                f"{self.bag.path}: found {found}, expected at least one topic of PoseStamped, TwistStamped, Odometry, "
                "WrenchStamped or Wrench with messages; "
                + (
                    "record the topics of the body"
                    if self.bag.complete
                    else "the file was cut off or damaged: record it again"
                )
            )
        body, body_from = self._body()
        logged = [self._vector("angular_momentum"), self._vector("linear_momentum"), self._scalar("energy/kinetic")]
        angular, linear, kinetic = logged
        momenta_from = "the log" if any(logged) else ""
        if not momenta_from and pose and twist and body:
            angular, linear, kinetic = self._computed(pose, twist, twist_in_world, body)
            momenta_from = f"pose, twist and the mass properties of {body_from}" if angular else ""
        self._note_unused()
        return Track(
            bag=self.bag,
            own=own,
            pose=pose,
            twist=twist,
            twist_in_world=twist_in_world,
            angular_momentum=angular,
            linear_momentum=linear,
            kinetic_energy=kinetic,
            work=self._scalar("energy/work"),
            energy_defect=self._scalar("energy/defect"),
            momenta_from=momenta_from,
            wrenches=wrenches,
            acted=acted,
            body=body,
            body_from=body_from,
            notes=tuple(self.notes),
            uses=self.uses,
        )

    def _series(
        self,
        names: Sequence[str],
        types: Sequence[str],
        read: Callable[[str], tuple[Times, Array]],
        *,
        child: bool = False,
    ) -> TimeSeries | None:
        """Return the best topic of the first of `types` that is there; `child` means Odometry's child frame."""
        for type_name in types:
            topics = [t.name for t in self.bag.topics.values() if t.type_name == type_name and t.count]
            if not topics:
                continue
            topic = min(topics, key=lambda name: (self._distance(name), not name.endswith(tuple(names)), name))
            self.parent = self.parent or topic.rpartition("/")[0] + "/"
            frame = self._one_frame(topic, self.bag.frame_ids(topic, child and type_name == ODOMETRY))
            return self._cleaned("twist" if child else "pose", topic, *read(topic), frame)
        return None

    def _distance(self, topic: str) -> bool:
        return bool(self.parent) and not topic.startswith(self.parent)

    def _one_frame(self, topic: str, frames: set[str]) -> str:
        if len(frames) > 1:
            raise LogError(
                f"{self.bag.path}: topic {topic!r} has the frames {sorted(frames)}, expected one; "
                "a topic that mixes bodies or axes cannot be inspected, record them apart"
            )
        return next(iter(frames))

    def _cleaned(self, use: str, topic: str, time_ns: Times, values: Array, frame: str = "") -> TimeSeries:
        self.uses[topic] = ", ".join(filter(None, (self.uses.get(topic), use)))
        if len(time_ns) > 1 and not time_ns.any():
            self.notes.append(f"{topic}: no message has a stamp; the log times are used.")
            time_ns = self.bag.topics[topic].log_times
        rows = values.reshape(len(time_ns), -1)
        usable = (np.abs(rows) < LARGEST).all(axis=1)
        # A bag may be large: what need not be copied is not.
        if not usable.all():
            time_ns, values = time_ns[usable], values[usable]
        backwards = int((np.diff(time_ns) < 0).sum())
        if backwards:
            order = np.argsort(time_ns, kind="stable")
            time_ns, values = time_ns[order], values[order]
        return TimeSeries(topic, time_ns, values, frame, backwards, int((~usable).sum()))

    def _vector(self, name: str) -> TimeSeries | None:
        topic = self._named(name, VECTOR)
        return None if topic is None else self._cleaned("momentum", topic, *self.bag.vectors(topic))

    def _scalar(self, name: str) -> TimeSeries | None:
        topic = self._named(name, SCALAR)
        return None if topic is None else self._cleaned("energy", topic, *self.bag.scalars(topic))

    def _named(self, name: str, type_name: str) -> str | None:
        """Return the topic of this name, at whatever depth, next to the pose."""
        topics = [t.name for t in self.bag.topics.values() if t.type_name == type_name and t.count]
        fitting = [topic for topic in topics if f"/{topic}".endswith(f"/{name}")]
        return min(fitting, key=lambda topic: (self._distance(topic), topic), default=None)

    def _computed(
        self, pose: TimeSeries, twist: TimeSeries, twist_in_world: bool, body: RigidBody
    ) -> tuple[TimeSeries | None, TimeSeries | None, TimeSeries | None]:
        found = momenta(pose, twist, twist_in_world, body)
        if not len(found.time_ns):
            self.notes.append(f"{pose.topic} and {twist.topic} share no stamp, so momenta are not computed.")
            return None, None, None
        angular, linear, kinetic = (
            TimeSeries("", found.time_ns, values) for values in (found.angular, found.linear, found.kinetic)
        )
        return angular, linear, kinetic

    def _frames(self, world: str, body: str) -> WrenchFrames:
        if self.scene:
            return self.scene.frames
        # A bag need not name its frames: no wrench is in one that has no name.
        return WrenchFrames(world or "\0world", "\0body" if body in ("", WORLD) else body)

    def _wrenches(self, frames: WrenchFrames, own: bool) -> tuple[tuple[RecordedWrench, ...], bool]:
        """Return what acted: the applied topics, else every command held until the next of its topic."""
        topics = [t.name for t in self.bag.topics.values() if t.type_name in WRENCHES]
        applied = [topic for topic in topics if topic.endswith(APPLIED)]
        if not own and not applied:
            topics = [topic for topic in topics if self.bag.topics[topic].count]
        if topics and not (own or applied):
            self.notes.append(
                "The bag says what was commanded, not what acted: each wrench is taken to act from its stamp until the "
                "next of its topic, and nothing else to act."
            )
        chosen = applied if own or applied else topics
        self.uses |= {topic: "wrench" if topic in chosen else "commands" for topic in topics}
        steps = tuple(_steps(self.bag, topic, frames, self._later(topic)) for topic in sorted(chosen))
        for held in steps:
            if not held.known.all():
                self.notes.append(
                    f"{held.topic}: {int((~held.known).sum())} of {len(held.known)} wrenches are not usable numbers or "
                    f"in an undeclared frame (frames: {frame_names(held.frames)}); their effect is unknown. "
                    "Declare frames in a scene and give it with --scene SCENE."
                )
        return steps, own or bool(chosen)

    def _later(self, topic: str) -> int:
        """Return by how much (ns) the log times of a topic without stamps are later than the stamps of the motion.

        What is of the same clock, but for the time that messages are under way, is left as it is.
        """
        motion = [name for name, use in self.uses.items() if use.startswith(("pose", "twist"))]
        stamped = next((name for name in motion if self.bag.topics[name].stamps_given), "")
        source = self.bag.topics[topic]
        if RUN in self.bag.metadata or not stamped or not source.count or source.stamps_given:
            return 0
        offset = clock(self.bag.topics[stamped]).offset_s
        if abs(offset) <= APART:
            return 0
        self.notes.append(
            f"{topic} has no stamps, and {stamped} is stamped by another clock than that of the log times: {topic} is "
            f"put {abs(offset):.6g} s {'earlier' if offset > 0.0 else 'later'} than it was logged, as {stamped} is."
        )
        return round(offset * 1e9)

    def _on_one_clock(self, series: TimeSeries | None) -> TimeSeries | None:
        later = 0 if series is None else self._later(series.topic)
        return replace(series, time_ns=series.time_ns - later) if series is not None and later else series

    def _body(self) -> tuple[RigidBody | None, str]:
        if self.scene is not None:
            return self.scene.body, self.scene.source
        topics = [t for t in self.bag.topics.values() if t.type_name == INERTIA and t.count]
        if not topics:
            return None, ""
        topic = min(topics, key=lambda t: (self._distance(t.name), t.name))
        self.uses[topic.name] = "mass"
        mass, x, y, z, xx, xy, xz, yy, yz, zz = topic.numbers[-1].tolist()
        try:
            if xx == yy == zz == 0.0:
                return RigidBody.particle(mass), topic.name
            body = RigidBody.from_matrix(mass, ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)), (x, y, z))
        except BodyError as error:
            self.notes.append(f"{topic.name}: {error}; these mass properties are not used.")
            return None, ""
        return body, topic.name

    def _note_unused(self) -> None:
        kinds = (POSE, TWIST, *WRENCHES, *(() if RUN in self.bag.metadata else (ODOMETRY,)))
        named = {topic.name for topic in self.bag.topics.values() if topic.type_name in kinds and topic.count}
        if others := sorted(named - {*self.uses}):
            self.notes.append(f"One body is inspected; these topics are left out: {', '.join(others)}.")


def _steps(bag: Bag, topic: str, frames: WrenchFrames, later_ns: int) -> RecordedWrench:
    commands = bag.wrenches(topic)
    stamped = bag.topics[topic].stamps_given
    times = [wrench.stamp_ns if stamped else log_time - later_ns for log_time, wrench in commands]
    held = [_held(wrench, frames) for _, wrench in commands]
    order = np.argsort(np.array(times, dtype=np.int64), kind="stable")

    def rows(vectors: Sequence[Sequence[float]]) -> Array:
        return np.array(vectors, dtype=np.float64).reshape(-1, 3)[order]

    zero = HeldWrench()
    parts = [zero if part is None else part for part in held]
    world = np.array([wrench.frame_id == frames.world_frame for _, wrench in commands], dtype=bool)[order]
    return RecordedWrench(
        topic=topic,
        time_ns=np.array(times, dtype=np.int64)[order],
        force=rows([p.force_body for p in parts]) + rows([p.force_world for p in parts]),
        torque=rows([p.torque_body for p in parts]) + rows([p.torque_world for p in parts]),
        world=world,
        known=np.array([part is not None for part in held], dtype=bool)[order],
        frames=tuple(sorted({wrench.frame_id for _, wrench in commands})),
    )


def _held(wrench: Wrench, frames: WrenchFrames) -> HeldWrench | None:
    if not all(abs(number) < LARGEST for number in (*wrench.force, *wrench.torque)):
        return None
    try:
        return frames.hold(wrench)
    except WrenchError:
        return None
