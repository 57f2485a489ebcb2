"""`read_track`: find the topics of one body in a bag, by message type, and put them into a `Track`.

Works on our own logs and on any bag of pose, twist and wrench; `TopicChoice` selects other topics. Numbers are
taken as they are: unusable ones are left out and counted, stamps out of order are sorted and counted. Mass properties
are not guessed.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.acting_wrenches import acting_wrenches, channels_of, waiting, which_channel
from rb_dynamics.analysis.clocks import APART
from rb_dynamics.analysis.gaps import strays
from rb_dynamics.analysis.spikes import without_spikes
from rb_dynamics.analysis.stalls import Stall, stalls
from rb_dynamics.analysis.thruster_pushes import pushes
from rb_dynamics.analysis.track import (
    LARGEST,
    Array,
    Motion,
    RecordedWrench,
    Times,
    TimeSeries,
    Track,
    frame_names,
    in_blocks,
    motion_blocks,
    shared,
)
from rb_dynamics.analysis.transform_tree import is_fixed, other_ways, pairs, pose_between
from rb_dynamics.analysis.velocities_from_poses import rates_of
from rb_dynamics.analysis.wheel_speeds import WheelSpeeds
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import BodyError, LogError, WrenchError
from rb_dynamics.formats.log_metadata import RUN, part_ns, unlogged
from rb_dynamics.formats.mcap_records import END_OF_TIME
from rb_dynamics.formats.message_types import COMMAND, INERTIA, JOINTS, ODOMETRY, SCALAR, VECTOR
from rb_dynamics.formats.topic_messages import Topic
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.loads.wrench import HeldWrench, Wrench, WrenchFrames, frame_name
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.logs.bag_reader import ATTITUDES, IMUS, POSES, TWISTS, WRENCHES, Bag
from rb_dynamics.logs.messages import APPLIED, SET_STATE, is_state_change
from rb_dynamics.logs.own_log import logged_scene
from rb_dynamics.logs.stamp_clock import APART_NS, ClockLine, StampClock, in_bursts
from rb_dynamics.logs.stamp_order import Disorder, disorder, standing
from rb_dynamics.logs.stray_stamps import StrayStamps
from rb_dynamics.logs.topics_of_channels import foreign_to, of_one_body
from rb_dynamics.logs.unset_stamps import WHEN
from rb_dynamics.numerics.growing_array import stored
from rb_dynamics.numerics.rotation_arrays import lengths, product, rotate_all
from rb_dynamics.scene.model import Scene

# ns by which a command without a stamp may have been recorded too late beside others.
_LATE_NS = 20_000_000
# Stamps that are all whole multiples of a shorter time, ns, are rounded to it; of a longer one, a clock ticks so.
_TICK_NS = 10_000_000
OF_SCENE = "the scene has"
"""How a note begins that says what of the scene acts, but is not recorded."""

# Largest part of the messages of a topic that may be of other frames, and are left out.
STRAYS = 0.1


@dataclass(frozen=True)
class TopicChoice:
    """Which topics describe the body; what is empty is found by type and name.

    Attributes:
        pose: topic of the pose.
        twist: topic of the twist.
        wrenches: topics of the wrenches; of commands also as TOPIC=CHANNEL, with their channel in the scene.
        frames: the pose is that of the second frame in the first, from /tf and /tf_static.
        alone: of the motion, only what these topics contain counts: the twist of an Odometry whose pose is chosen, but
            not what another topic contains.
        near: topic of the motion, in another bag, of the body whose wrenches these are.
    """

    pose: str = ""
    twist: str = ""
    wrenches: tuple[str, ...] = ()
    frames: tuple[str, str] | None = None
    alone: bool = False
    near: str = ""

    @property
    def moving(self) -> bool:
        """Whether it says what the motion is, which an Odometry may repeat."""
        return bool(self.pose or self.twist)


SENSED = "rb_dynamics.sensed"
"""The record that `as_measured` makes of that of the run: the frame of each sensor of the scene, by its topic."""


def as_measured(bag: Bag, choice: TopicChoice) -> tuple[Bag, TopicChoice]:
    """Return a log of this package as a bag of the sensors that `choice` names, without the true motion of its run."""
    motion = {bag.called(name) for name in ("pose", "twist")}
    chosen = {f"/{each.lstrip('/')}" for each in (choice.pose, choice.twist) if each}
    if RUN not in bag.metadata or not chosen - motion:
        return bag, choice
    scene = logged_scene(bag.attachments)
    frames = {bag.called(each.name): each.frame for each in scene.sensors} if scene else {}
    # What is missing, and what topics are called, holds for the sensors, too; so does time 0 of the run.
    metadata = {name: facts for name, facts in bag.metadata.items() if name != RUN}
    return replace(bag, metadata={**metadata, SENSED: frames}, zero_ns=0), replace(choice, alone=True)


def read_track(
    bag: Bag,
    scene: Scene | None = None,
    choice: TopicChoice | None = None,
    *,
    spikes: bool = False,
    wheels: WheelSpeeds | None = None,
    thrusters: bool = True,
    beside: Topic | None = None,
) -> Track:
    """Return what `bag` says about one body; `scene` gives mass properties and frames that a bag does not have.

    Spikes of a twist are named, and left out unless `spikes` are wanted. The reaction wheels of the scene turn as
    `wheels` say; its thrusters push as commanded, if `thrusters` are wanted. Of a bag of commands alone, log times
    follow its stamps, if it has any, else those of `beside`, of another bag recorded at that time.

    Raises:
        LogError: nothing in the bag is a pose, a twist or a wrench, a topic of `choice` is not there, or a message is
            damaged.
    """
    return _TrackReader(bag, scene, choice or TopicChoice(), wheels, thrusters, beside).track(spikes)


@dataclass(frozen=True)
class Momenta:
    """What pose, twist and mass properties give, at the times which pose and twist share."""

    time_ns: Times
    angular: Array
    linear: Array
    kinetic: Array


def momenta(motion: Motion, body: RigidBody) -> Momenta:
    """Return L = R I w (about the centre of mass) and p = m R (v + w x c), world axes, and T; v, w, c in body axes."""
    attitude, omega = motion.orientation_xyzw, motion.angular_velocity_body
    velocity = motion.linear_velocity_body + np.cross(omega, np.array(body.center_of_mass))
    spin = omega @ np.array(body.inertia)
    kinetic: Array = np.sum(0.5 * (body.mass * velocity**2 + omega * spin), axis=1)
    linear: Array = body.mass * rotate_all(attitude, velocity)
    return Momenta(motion.time_ns, rotate_all(attitude, spin), linear, kinetic)


def _whole_rows(true: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which rows are true throughout; all at once where all are, as rows one by one take ten times as long."""
    whole = np.ones(len(true), dtype=bool)
    return whole if true.all() else np.logical_and.reduce(true, axis=1, out=whole)


@dataclass(frozen=True)
class _Mount:
    """A frame that is fixed to the body.

    Attributes:
        body: the frame of the body, in words.
        source: what says so.
        turn: rotation from the axes of the frame to those of the body, xyzw.
        place: its origin from that of the body, m, body axes.
    """

    body: str
    source: str
    turn: Array
    place: Array


class _TrackReader:
    """Looks up topics by type; among several, those next to the ones found, then those named as this package does."""

    def __init__(
        self,
        bag: Bag,
        scene: Scene | None,
        choice: TopicChoice,
        wheels: WheelSpeeds | None,
        thrusters: bool,
        beside: Topic | None,
    ) -> None:
        self.notes: list[str] = []
        if scene is not None and RUN in bag.metadata:
            self.notes.append(
                "The scene given is not used: this log was written by rb_dynamics and brings the body, the frames and "
                "the momenta with which it ran."
            )
            scene = None
        self.bag, self.scene, self.choice = bag, scene, choice
        self.turning, self.wheels, self.thrusters = wheels, wheels.topic if wheels else "", thrusters
        self.beside = beside
        self.uses: dict[str, str] = {}
        self.parent = self.doubt = self.frames_to_choose = ""
        self.specific_force: TimeSeries | None = None
        self.sampled_ns: Times = np.empty(0, dtype=np.int64)

    def track(self, spikes: bool) -> Track:
        found = self._pose(), self._twist()
        pose, twist = map(self._on_one_clock, found)
        own = RUN in self.bag.metadata
        rates = self._rates(pose) if twist is None else None
        world = self.scene.frames.world_frame if self.scene else frame_name(pose.frame) if pose else "world"
        # Without a name it is that of the body, as for a wrench.
        of_twist = "" if twist is None else frame_name(twist.frame)
        twist_in_world = of_twist == world != ""
        if twist is not None and pose is not None and not (own or spikes):
            twist = without_spikes(twist, pose, twist_in_world)
        wheels = self.turning
        if wheels is not None and not wheels.stamped:
            line = self._line(wheels.topic, stamped=False)
            wheels = wheels._replace(time_ns=line.stamps(wheels.time_ns))
        frames = self._frames(world, "" if twist_in_world else of_twist)
        moving = pose or twist
        sampled = [each.time_ns for each in (pose, twist) if each is not None]
        if not sampled and self.beside is not None:
            sampled = [self.beside.stamps]
        if sampled:
            self.sampled_ns = np.unique(np.concatenate(sampled))
        wrenches, acted = self._wrenches(frames, own)
        effects = unlogged(self.bag.metadata, moving.topic if moving else "")
        if own and effects:
            acted = False
            self.notes.append(
                f"Effects acted whose force and torque are not in the log ({effects}): momentum is not checked; "
                "energy is, with the work that the run recorded."
            )
        unrecorded = [] if own else self._unrecorded(wrenches, effects)
        if unrecorded:
            acted = False
            self.notes += (f"What moved the body is not all known: {each}." for each in unrecorded)
        if pose is None and twist is None and not wrenches:
            raise self._nothing()
        body, body_from = self._body()
        angular, linear = self._vector("angular_momentum"), self._vector("linear_momentum")
        kinetic = self._scalar("energy/kinetic")
        momenta_from = "the log" if angular or linear or kinetic else ""
        if not momenta_from and pose and twist and body:
            angular, linear, kinetic = self._computed(pose, twist, twist_in_world, body)
            momenta_from = f"pose, twist and the mass properties of {body_from}" if angular else ""
        self._note_unused()
        track = Track(
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
            motor_work=self._scalar("energy/motor_work"),
            friction_heat=self._scalar("energy/friction_heat"),
            momenta_from=momenta_from,
            wrenches=wrenches,
            acted=acted,
            unrecorded="; ".join(unrecorded),
            doubt=self.doubt,
            body=body,
            body_from=body_from,
            notes=tuple(self.notes),
            frames_to_choose=self.frames_to_choose,
            uses=self.uses,
            rates=rates,
            specific_force=self.specific_force,
            wheels=wheels,
            missing=self._missing(own),
            moved_ns=self._moved(pose),
            stalls=() if own or pose is None else stalls(pose),
        )
        start = track.span_ns[0]
        # A run begins at 0; a later file of a bag, alone, does not.
        if own and start > 0 and not self.bag.cut_ns and not any(begin < start for begin, _ in track.missing):
            track = replace(track, missing=((0, start), *track.missing))
        if self.scene is not None:
            sent = [_over_stalls(waiting(steps, self.bag, steps.channel), track.stalls) for steps in wrenches]
            whole = part_ns(self.bag.metadata) is None
            held = acting_wrenches(sent, self.scene, track.missing, track.zero_ns, whole)
            track = replace(track, by_scene=held)
        if twist is not None and pose is None and not (own or spikes):
            pushes = ((each.time_ns, np.hstack([each.force, each.torque])) for each in track.by_scene or wrenches)
            track = replace(track, twist=without_spikes(twist, None, twist_in_world, pushes))
        return track

    def _nothing(self) -> LogError:
        """Return the error of a bag without anything to inspect, with the table of its topics."""
        remedy = (
            " ".join([*self.notes, "record the topics of the body"])
            if self.bag.complete
            else "the file was cut off or damaged: record it again"
        )
        return LogError(
            f"{self.bag.path}: found nothing to inspect, expected at least one topic of a pose, a twist, an IMU or a "
            f"wrench with messages; {remedy}\n{topic_table(self.bag)}"
        )

    def _pose(self) -> TimeSeries | None:
        frames, topic = self.choice.frames, self.choice.pose
        if frames is None and not topic and self.choice.alone:
            topic = self._also(self.choice.twist, (*POSES, *IMUS))
            if not topic:
                return None
        if frames is None and not topic:
            topic = self._best(("pose", "odom"), POSES)
            if not topic:
                moving = [pair for pair, each in pairs(self.bag).items() if not is_fixed(each)]
                if len(moving) == 1:
                    (frames,) = moving
                elif moving:
                    listed = ", ".join(f"{parent}:{child}" for parent, child in sorted(moving))
                    self.frames_to_choose = (
                        f"There is no topic of a pose, and several frames move ({listed}): choose the body's with "
                        "--frames WORLD:BODY"
                    )
                    self.notes.append(f"{self.frames_to_choose}.")
        if frames is not None:
            return self._of_frames(*frames)
        # A QuaternionStamped may as well be an attitude that is wanted: it has to be named.
        kinds = (*POSES, *ATTITUDES, *IMUS)
        topic = self._given(topic, kinds, "--pose-topic") if topic else self._best(("imu",), IMUS)
        if not topic:
            return None
        if self.bag.topics[topic].type_name in IMUS:
            return self._of_imu("pose", topic, slice(0, 4), slice(3, 7), 7)
        return self._read("pose", topic, self.bag.attitudes if self._tells_attitude(topic) else self.bag.poses)

    def _tells_attitude(self, topic: str) -> bool:
        """Return whether a topic tells the attitude and nothing else."""
        return self.bag.topics[topic].type_name in ATTITUDES

    def _twist(self) -> TimeSeries | None:
        topic = self.choice.twist
        if self.choice.alone:
            topic = topic or self._also(self.choice.pose, (*TWISTS, *IMUS))
        else:
            topic = topic or self._best(("twist", "odom"), TWISTS) or self._best(("imu",), IMUS)
        if not topic:
            return None
        topic = self._given(topic, (*TWISTS, *IMUS), "--twist-topic")
        if self.bag.topics[topic].type_name in IMUS:
            found = self._of_imu("twist", topic, slice(4, 7), slice(3, 6), 6)
            self.specific_force = self._of_imu("accel", topic, slice(7, 10), slice(0, 3), 3)
            return found
        return self._read("twist", topic, self.bag.twists)

    def _best(self, names: Sequence[str], types: Iterable[str]) -> str:
        """Return the best topic of the first of `types` that is there; "" for none.

        A topic that is named like a command is never taken for a measurement, nor a pair of frames for the body.
        """
        for type_name in types:
            topics = [
                t.name
                for t in self.bag.topics.values()
                if t.type_name == type_name and t.count and t.name not in self.bag.pairs and not _commanded(t.name)
            ]
            if topics:
                return min(topics, key=lambda name: (self._distance(name), not name.endswith(tuple(names)), name))
        return ""

    def _also(self, name: str, types: Sequence[str]) -> str:
        """Return the topic called `name`, chosen for something else, if it is of one of `types`, too; else ""."""
        found = self._called(name)
        return found.name if found is not None and found.type_name in types else ""

    def _called(self, name: str) -> Topic | None:
        """Return the topic called `name`, with or without its first slash."""
        return next((t for t in self.bag.topics.values() if t.name.lstrip("/") == name.lstrip("/")), None)

    def _given(self, name: str, types: Sequence[str], option: str) -> str:
        """Return the topic called `name`, with or without its first slash.

        Raises:
            LogError: there is none with messages of one of `types`.
        """
        usable = {t.name: t for t in self.bag.topics.values() if t.type_name in types and t.count}
        for each in (name, f"/{name}"):
            if each in usable:
                return each
        there = self._called(name)
        found = "no such topic" if there is None else f"{there.type_name}, {there.count} messages"
        listed = ", ".join(f"{t.name} ({t.type_name}, {t.count} messages)" for t in usable.values()) or "none"
        raise LogError(f"{self.bag.path}: {option} {name}: found {found}, expected one of: {listed}; name one of these")

    def _read(self, use: str, topic: str, read: Callable[[str], tuple[Times, Array]]) -> TimeSeries:
        """Return the series of a topic; of an Odometry as twist with its child frame."""
        self.parent = self.parent or topic.rpartition("/")[0] + "/"
        child = use == "twist" and self.bag.topics[topic].type_name == ODOMETRY
        frame, others, kept = self._main_frame(self.bag.topics[topic], child)
        time_ns, values = read(topic)
        if others:
            time_ns, values = time_ns[kept], values[kept]
        series = replace(self._cleaned(use, topic, time_ns, values, frame), strays=others)
        if self.bag.topics[topic].type_name in IMUS:
            return series
        if self._tells_attitude(topic):
            nowhere = np.full((len(series.time_ns), 3), np.nan)
            series = replace(series, values=np.hstack([nowhere, series.values]))
        if use == "pose":
            kinds = self.bag.topics[topic].kinds[0]
            frame = self._main_frame(self.bag.topics[topic], True)[0] if any(len(each) > 1 for each in kinds) else ""
        return self._of_body(use, series, frame or self._frame_of_sensor(topic))

    def _frame_of_sensor(self, topic: str) -> str:
        """Return the frame whose pose a sensor of the scene measures, which its messages do not say; "" without one."""
        told, kind = self.bag.metadata.get(SENSED, {}), self.bag.topics[topic].type_name
        sensors = self.scene.sensors if self.scene and topic not in told else ()
        named = (each.frame for each in sensors if each.message == kind and f"/{topic}".endswith(f"/{each.name}"))
        return told.get(topic, "") or next(named, "")

    def _of_imu(self, use: str, topic: str, part: slice, places: slice, width: int) -> TimeSeries | None:
        """Return what an IMU measures, in the `places` of rows of `width`, the others NaN; None if it does not."""
        times, rows = self.bag.imus(topic)
        measured = rows[:, part]
        # A driver that does not say so leaves the quaternion zero.
        if np.isnan(measured).all() or (use == "pose" and not measured.any()):
            return None
        found = self._read(use, topic, lambda _: (times, measured))
        values = np.full((len(found.time_ns), width), np.nan)
        mounting, body = self._mounting(topic, found.frame)
        if use == "pose":
            values[:, places] = product(found.values, mounting * np.array([-1.0, -1.0, -1.0, 1.0]))
        else:
            values[:, places] = rotate_all(mounting, found.values)
        # The frame is that of the sensor, not the one in which its attitude is.
        found = replace(found, values=values, frame="" if use == "pose" else found.frame)
        return replace(found, turned_to=body, turned_by=mounting) if body else found

    def _mounting(self, topic: str, frame: str) -> tuple[Array, str]:
        """Return the rotation from the axes of an IMU to those of the body, as scene or /tf_static says, and its frame.

        The frame is "" where nothing says so.
        """
        found, note = self._mount(frame), ""
        if found is not None:
            note = f"The axes of {topic} ({frame}) are turned to those of {found.body}, as {found.source} says."
        elif frame not in {"", *self._bodies()}:
            note = (
                f"The axes of {topic} ({frame}) are taken for those of the body: nothing here says how the sensor is "
                "mounted."
            )
        self._note_once(note)
        return (np.array([0.0, 0.0, 0.0, 1.0]), "") if found is None else (found.turn, self._named_body(found))

    def _mount(self, frame: str) -> _Mount | None:
        """Return how a frame is fixed to that of the body; None if it is the body's, or nothing says so."""
        fixed = (self.scene.frames.fixed or {}).get(frame) if self.scene else None
        if fixed is not None:
            return _Mount("the body", "the scene", np.array(fixed.orientation_xyzw), np.array(fixed.position))
        known = frame and frame not in self._worlds() and RUN not in self.bag.metadata
        for body in self._bodies() if known else ():
            if frame.lstrip("/") == body.lstrip("/"):
                return None
            with contextlib.suppress(LogError):
                found = pose_between(self.bag, body, frame)
                if all(is_fixed(self.bag.topics[name]) for name in found.topics):
                    return _Mount(body, "/tf_static", found.values[-1, 3:], found.values[-1, :3])
        return None

    def _bodies(self) -> list[str]:
        """Return what the frame of the body may be called: as scene, user and pose say."""
        asked = self.choice.frames[1] if self.choice.frames else ""
        return [name for name in dict.fromkeys((self._body_frame(), asked, *self._child_frames())) if name]

    def _of_body(self, use: str, series: TimeSeries, frame: str) -> TimeSeries:
        """Return the pose or the twist of the body origin, in body axes, of that of a frame fixed to the body."""
        mount = self._mount(frame)
        if mount is None:
            self._note_unknown_mount(frame)
            return series
        values = np.empty_like(series.values)
        if use == "pose":
            values[:, 3:] = product(series.values[:, 3:], mount.turn * np.array([-1.0, -1.0, -1.0, 1.0]))
            values[:, :3] = series.values[:, :3] - rotate_all(values[:, 3:], mount.place)
        else:
            values[:, 3:] = rotate_all(mount.turn, series.values[:, 3:])
            values[:, :3] = rotate_all(mount.turn, series.values[:, :3]) - np.cross(values[:, 3:], mount.place)
        note = (
            f"{series.topic} tells of {frame}: its {use} is converted to that of {mount.body}, as {mount.source} says "
            "how the two are fixed to each other."
        )
        self._note_once(note)
        return replace(series, values=values, frame=series.frame if use == "pose" else self._named_body(mount))

    def _named_body(self, mount: _Mount) -> str:
        """Return the name of the frame of the body to which something is fixed."""
        return mount.body if mount.source != "the scene" else self._body_frame()

    def _note_unknown_mount(self, frame: str) -> None:
        """Note that a frame is taken for the body's although the scene names another."""
        body = self._body_frame()
        held = [
            parent
            for (parent, child), topic in pairs(self.bag).items()
            if child == frame.lstrip("/") and is_fixed(topic)
        ]
        if not frame or frame.lstrip("/") == body.lstrip("/") or not body:
            return
        taken = f"{frame} is taken for the frame of the body"
        if held:
            self._note_once(
                f"{taken}: /tf_static says that it is fixed to {held[0]}, but not how to {body!r}, as the scene calls "
                "that of the body; name it there, as body.frame."
            )
        # A scene that does not name the frame, or without its namespace, leaves that to the recording.
        elif body != WrenchFrames().body_frame and frame.rpartition("/")[2] != body.rpartition("/")[2]:
            self._note_once(
                f"{taken}, which the scene calls {body!r}: nothing says how the two are fixed to each other; declare "
                "it under body.frames, or name it there, as body.frame."
            )

    def _note_once(self, note: str) -> None:
        """Add a note, unless it is there or empty."""
        if note and note not in self.notes:
            self.notes.append(note)

    def _child_frames(self) -> set[str]:
        """Return the frame of the body as the topic of the pose names it."""
        return {texts[1] for texts in self._pose_frames() if len(texts) > 1}

    def _worlds(self) -> set[str]:
        """Return what the world frame may be called: as scene and pose say."""
        return {texts[0] for texts in self._pose_frames()} | ({self.scene.frames.world_frame} if self.scene else set())

    def _pose_frames(self) -> list[tuple[str, ...]]:
        """Return the frames that the topics of the pose name first; an IMU names none but its own."""
        topics = [self.bag.topics[name] for name, use in self.uses.items() if "pose" in use]
        return [texts for topic in topics if topic.type_name not in IMUS for texts in topic.kinds[0][:1] if texts]

    def _body_frame(self) -> str:
        return self.scene.frames.body_frame if self.scene else ""

    def _of_frames(self, world: str, body: str) -> TimeSeries:
        self.notes += other_ways(self.bag, world, body)
        direct = pairs(self.bag).get((world.lstrip("/"), body.lstrip("/")))
        if direct is not None:
            return self._read("pose", direct.name, self.bag.poses)
        found = pose_between(self.bag, world, body)
        self.uses |= dict.fromkeys(found.topics, "pose")
        self.parent = self.parent or "/"
        self.notes.append(f"The pose is that of {body} in {world}, from {', '.join(found.topics)}.")
        fastest = max(found.topics, key=lambda name: self.bag.topics[name].count)
        others: dict[str, int] = {}
        for name in found.topics:
            others |= self._main_frame(self.bag.topics[name], child=False)[1]
        unusable = found.unusable + len(self.bag.topics[fastest].damaged)
        series = TimeSeries(
            fastest, found.time_ns, found.values, world, unusable=unusable, strays=others, far_ns=found.far_ns
        )
        return self._of_body("pose", series, body.lstrip("/"))

    def _rates(self, pose: TimeSeries | None) -> TimeSeries | None:
        """Return the rates that the pose gives; None without, and with a position that is not known."""
        found = rates_of(pose) if pose is not None and not np.isnan(pose.values).any() else None
        if pose is None or found is None:
            return None
        linear, angular = found.noise
        self.notes.append(
            f"No topic of a twist: velocities are computed from {pose.topic}, as differences over "
            f"{found.interval_s:.3g} s, with a noise of about {angular:.2g} rad/s and {linear:.2g} m/s; they are "
            "shown, and nothing is judged by them."
        )
        return replace(found.twist, frame=self._body_frame())

    def _distance(self, topic: str) -> bool:
        return bool(self.parent) and not topic.startswith(self.parent)

    def _main_frame(self, topic: Topic, child: bool) -> tuple[str, dict[str, int], NDArray[np.bool_]]:
        """Return the frame of nearly all messages, how many are of which others, and which are not of these.

        A pose is of another body or in other axes where one of its two frames differs, a twist where its axes do.

        Raises:
            LogError: there is no such frame.
        """
        kinds, of_row = topic.kinds
        names = [(text[-1:] if child else text) or ("",) for text in kinds]
        counts: dict[tuple[str, ...], int] = {}
        for name, count in zip(names, np.bincount(of_row[of_row >= 0], minlength=len(kinds)).tolist(), strict=True):
            counts[name] = counts.get(name, 0) + count
        main = max(counts, key=counts.__getitem__)
        others = {":".join(name): count for name, count in counts.items() if name != main}
        if sum(others.values()) > STRAYS * sum(counts.values()):
            raise LogError(
                f"{self.bag.path}: topic {topic.name!r} has the frames {sorted([':'.join(main), *others])}, expected "
                f"one in {100.0 * (1.0 - STRAYS):g} % of its messages or more; a topic that mixes bodies or axes "
                "cannot be inspected, record them apart"
            )
        return main[0], others, np.array([*(name == main for name in names), True])[of_row]

    def _cleaned(self, use: str, topic: str, time_ns: Times, values: Array, frame: str = "") -> TimeSeries:
        self.uses[topic] = ", ".join(filter(None, (self.uses.get(topic), use)))
        if len(time_ns) > 1 and not time_ns.any():
            self.notes.append(f"{topic}: no message has a stamp; the log times are used.")
            time_ns = self.bag.topics[topic].log_times
        if topic in self.bag.topics and (damaged := len(self.bag.topics[topic].damaged)):
            self.notes.append(f"{topic}: {damaged} messages are cut short or damaged, and left out.")
        rows = values.reshape(len(time_ns), -1)
        usable = np.concatenate([_whole_rows(np.abs(block) < LARGEST) for block in in_blocks(rows)])
        # A bag may be large: what need not be copied is not.
        if not usable.all():
            time_ns, values = time_ns[usable], values[usable]
        far = np.empty(0, np.int64) if RUN in self.bag.metadata else strays(time_ns)
        if len(far):
            usual = ~np.isin(time_ns, far)
            time_ns, values = time_ns[usual], values[usual]
        unordered = disorder(time_ns)
        if unordered is not None:
            order = np.argsort(time_ns, kind="stable")
            unordered = _without_repeats(unordered, time_ns, values, order)
            time_ns, values = time_ns[order], values[order]
        unusable = int((~usable).sum())
        return TimeSeries(topic, time_ns, values, frame, unordered, unusable, far_ns=tuple(far.tolist()))

    def _vector(self, name: str) -> TimeSeries | None:
        topic = self._named(name, VECTOR)
        return None if topic is None else self._cleaned("momentum", topic, *self.bag.vectors(topic))

    def _scalar(self, name: str) -> TimeSeries | None:
        topic = self._named(name, SCALAR)
        if topic is None:
            return None
        log_times, values = self.bag.scalars(topic)
        times = self._by_motion(topic, log_times)
        told = "Energies have no stamps, and log times are of another clock than those of the motion: they follow it."
        if times is not log_times and told not in self.notes:
            self.notes.append(told)
        return self._cleaned("energy", topic, times, values)

    def _moved(self, pose: TimeSeries | None) -> Times:
        """Return when the body was moved to another state from outside, ascending, by the clock of the motion.

        Another program may log it some milliseconds before or after: where the pose leaps near, it was then.
        """
        found = [each for each in self.bag.topics.values() if is_state_change(each.name, each.type_name) and each.count]
        times = [self._by_motion(each.name, each.log_times) for each in found]
        moved = np.sort(np.concatenate([np.zeros(0, dtype=np.int64), *times]))
        if pose is None or RUN in self.bag.metadata:
            return moved
        return np.unique(np.array([_leap(pose, each) for each in moved.tolist()], dtype=np.int64))

    def _by_motion(self, topic: str, log_times: Times) -> Times:
        """Return when messages were that count as they are logged, by the stamps of the motion beside them."""
        clock = self._clock(topic)
        if RUN in self.bag.metadata or clock is None or standing(clock.stamps):
            return log_times
        line = StampClock.of(clock.log_times, clock.stamps).line
        if line.one_clock or (line.straight and line.bounded):
            return log_times if line.one_clock else line.stamps(log_times)
        order = np.argsort(clock.log_times, kind="stable")
        logged, late = clock.log_times[order], (clock.log_times - clock.stamps)[order]
        # Nanoseconds since 1970 are no floats.
        more = np.interp(log_times - logged[0], logged - logged[0], late - late[0])
        by_motion: Times = log_times - late[0] - np.rint(more).astype(np.int64)
        return by_motion

    def _named(self, name: str, type_name: str) -> str | None:
        """Return the topic of this name, at whatever depth, next to the pose; None if the motion alone counts."""
        if self.choice.alone:
            return None
        topics = [t.name for t in self.bag.topics.values() if t.type_name == type_name and t.count]
        fitting = [topic for topic in topics if f"/{topic}".endswith(f"/{name}")]
        return min(fitting, key=lambda topic: (self._distance(topic), topic), default=None)

    def _computed(
        self, pose: TimeSeries, twist: TimeSeries, twist_in_world: bool, body: RigidBody
    ) -> tuple[TimeSeries | None, TimeSeries | None, TimeSeries | None]:
        blocks = (momenta(motion, body) for motion in motion_blocks(pose, twist, twist_in_world))
        rows = stored((np.column_stack([found.angular, found.linear, found.kinetic]) for found in blocks), 7)
        if not len(rows):
            self.notes.append(f"{pose.topic} and {twist.topic} share no stamp, so momenta are not computed.")
            return None, None, None
        time_ns, *_ = shared(pose.time_ns, twist.time_ns)
        angular, linear, kinetic = (
            None if series.partial else series
            for series in (TimeSeries("", time_ns, rows[:, columns]) for columns in (slice(0, 3), slice(3, 6), 6))
        )
        return angular, linear, kinetic

    def _frames(self, world: str, body: str) -> WrenchFrames:
        if self.scene:
            return self.scene.frames
        # Of a log of which a pose alone is chosen, as its scene has it.
        if not body and RUN in self.bag.metadata and (scene := logged_scene(self.bag.attachments)) is not None:
            return scene.frames
        # A bag need not name its frames: no wrench is in one that has no name.
        return WrenchFrames(world or "\0world", body or "\0body")

    def _wrenches(self, frames: WrenchFrames, own: bool) -> tuple[tuple[RecordedWrench, ...], bool]:
        """Return what acted: the applied topics, else every command held until the next of its topic."""
        topics = [t.name for t in self.bag.topics.values() if t.type_name in WRENCHES]
        if self.thrusters and not own:
            topics = [topic for topic in topics if topic not in self._by_ramps()]
        chosen_for = {}
        if asked := [each.partition("=") for each in self.choice.wrenches]:
            topics = [self._given(name, (*WRENCHES,), "--wrench-topic") for name, *_ in asked]
            chosen_for = {topic: each[2] for topic, each in zip(topics, asked, strict=True) if each[1]}
        applied = [topic for topic in topics if topic.endswith(APPLIED)]
        # In a bag of several bodies, the wrenches on each body are next to its pose.
        applied = [topic for topic in applied if own or not self._distance(topic)] or applied
        if not own and not applied:
            topics = [topic for topic in topics if self.bag.topics[topic].count]
        if not own and not asked:
            applied = self._of_body_here(applied)
            topics = applied or self._of_body_here(topics)
        chosen = applied if (own or applied) and not asked else topics
        channels = channels_of(chosen, self.scene, chosen_for)
        if topics and not (own or applied):
            self.notes.append(
                "The bag says what was commanded, not what acted: each wrench is assumed to act from its stamp until "
                f"the next of its topic{self._as_in_scene(channels)}."
            )
        self.uses |= {topic: "wrench" if topic in chosen else "commands" for topic in topics}
        self.notes += (
            f"{topic}: {self.bag.unset[topic]} of {self.bag.topics[topic].count} commands have no stamp: {WHEN}."
            for topic in sorted({*chosen} & {*self.bag.unset})
        )
        steps = (
            *(
                _steps(self.bag, topic, frames, channels.get(topic), self._line(topic), self.notes)
                for topic in sorted(chosen)
            ),
            *(self._thrusters(frames, {*chosen}) if self.thrusters and not own else ()),
        )
        for held in steps:
            if not held.known.all() and not held.standing:
                self.notes.append(
                    f"{held.topic}: {int((~held.known).sum())} of {len(held.known)} wrenches are not usable numbers or "
                    f"in an undeclared frame (frames: {frame_names(held.frames)}); their effect is unknown. "
                    "A scene says what frames are, with body.frame, world_frame and body.frames: "
                    + ("declare these there." if self.scene else "give it with --scene SCENE.")
                )
        return steps, own or bool(steps)

    def _by_ramps(self) -> set[str]:
        """Return the topics of what thrusters with ramps did, where their commands are recorded.

        A log of this package has it at outputs alone; a command says all of it.
        """
        thrusters = () if self.scene is None else self.scene.actuators
        ramps = (each for each in thrusters if isinstance(each, Thruster) and (each.rise or each.fall))
        commands = (name for each in ramps for name in self.bag.actuated_of(each) if self.bag.topics[name].count)
        return {name.removesuffix(COMMAND) + APPLIED for name in commands}

    def _thrusters(self, frames: WrenchFrames, told: set[str]) -> Iterator[RecordedWrench]:
        """Yield what the thrusters of the scene did by their commands, but for those of which `told` says it."""
        if self.scene is None:
            return
        for thruster in self.scene.actuators:
            mine = [name for name in self.bag.actuated_of(thruster) if self.bag.topics[name].count]
            mine = [name for name in mine if not self._distance(name)] or mine
            if not isinstance(thruster, Thruster) or not mine or mine[0].removesuffix(COMMAND) + APPLIED in told:
                continue
            motion, bodies = self._motion_and_others()
            mine, doubt = of_one_body(mine, [thruster.topic], motion, bodies)
            if doubt:
                which = f"which of {', '.join(mine)} commands" if len(mine) > 1 else f"whether {mine[0]} commands"
                self.doubt = self.doubt or (
                    f"cannot tell {which} {thruster.name} of the body of {motion or 'the scene'}: choose the motion "
                    "beside it with --pose-topic, or leave thrusters that did not push out of the scene"
                )
                continue
            log_times, values = self.bag.scalars(mine[0])
            times, rows = pushes(thruster, self.scene, self._line(mine[0]).stamps(log_times), values, self.sampled_ns)
            self.uses[mine[0]] = "commands"
            self.notes.append(f"{mine[0]}: {thruster.name} is taken to have pushed as commanded.")
            yes = np.ones(len(times), dtype=bool)
            yield RecordedWrench(
                mine[0], times, rows[:, :3], rows[:, 3:], ~yes, yes, yes, (frames.body_frame,), channel=Channel(),
                within_ns=_LATE_NS,
            )  # fmt: skip

    def _motions(self) -> tuple[str, list[str]]:
        """Return the topic of the motion whose namespace counts, and all that may be of a motion."""
        moving = [
            topic.name
            for topic in self.bag.topics.values()
            if topic.type_name in {*POSES, *TWISTS, *IMUS} and topic.count and not _commanded(topic.name)
        ]
        return self.choice.near or next((name for name in moving if name in self.uses), ""), moving

    def _of_another_body(self, topic: str) -> bool:
        """Return whether a topic is in the namespace of another motion, and shares none with that which is used."""
        motion, moving = self._motions()
        others = [name for name in moving if name not in self.uses and "/" in name[1:]]
        return bool(foreign_to(motion, [topic])) and not all(foreign_to(name, [topic]) for name in others)

    def _motion_and_others(self) -> tuple[str, list[str]]:
        """Return the topic of the motion whose namespace counts, and those of the motions of other bodies."""
        motion, moving = self._motions()
        # An IMU or a twist of another name may be that of the same body, in the namespace of what measures it.
        return motion, [
            name
            for name in moving
            if name not in self.uses
            and (self.bag.topics[name].type_name in POSES or name.rpartition("/")[2] == motion.rpartition("/")[2])
        ]

    def _of_body_here(self, topics: Sequence[str]) -> list[str]:
        """Return those of wrench `topics` that act on the body whose motion is used."""
        motion, bodies = self._motion_and_others()
        names = [channel.topic for channel in self.scene.channels] if self.scene else []
        kept, self.doubt = of_one_body(topics, names, motion, bodies)
        foreign = [topic for topic in foreign_to(motion, kept) if topic.lstrip("/") not in names]
        if foreign and not self.doubt:
            self.notes.append(
                f"{', '.join(foreign)}: taken for wrenches on the body of {motion}, in another namespace; "
                "--wrench-topic chooses others."
            )
        if others := [topic for topic in topics if topic not in kept]:
            why = "" if self.doubt else f", by their names and namespaces those of the body of {motion}"
            self.notes.append(
                f"Of the wrenches, {', '.join(kept)} are taken{why}, and not {', '.join(others)}; --wrench-topic "
                "chooses others."
            )
        return kept

    def _as_in_scene(self, channels: Mapping[str, Channel]) -> str:
        """Return what else is assumed of commands by their topics and of what acts, as the end of a sentence."""
        if self.scene is None:
            return ", and nothing else is assumed to act"
        told = [
            f"{topic} with its {name} of {value:g} s"
            for topic, channel in channels.items()
            for name, value in (("delay", channel.delay), ("timeout", channel.timeout))
            if value
        ]
        acting = self.scene.combined_effects.effects
        others = ", ".join(dict.fromkeys(each.kind for each in acting if each not in self.scene.actuators))
        besides = f"the scene adds {others}" if others else "nothing else is assumed to act"
        return f"{', as the scene says: ' if told else ''}{', '.join(told)}; {besides}"

    def _unrecorded(self, wrenches: Sequence[RecordedWrench], effects: str) -> list[str]:
        """Return what acts on the body or has momentum inside it, by the scene or the topics, but is not in a bag.

        What a fit may model, that which the scene has, is apart.
        How commands of `wrenches` act is not in a bag either, if it depends on their channel. Nor is what `effects` did
        that the log of which it was made has in no topic.
        """
        found, doubt = list[str](), ""
        if self.scene is not None:
            known = {each.topic for each in wrenches}
            known |= {each.removesuffix(APPLIED) + COMMAND for each in known if each.endswith(APPLIED)}
            told_wheels = self.scene.wheels if self.wheels else ()
            unknown = [
                each.kind
                for each in self.scene.actuators
                if each not in told_wheels and known.isdisjoint(self.bag.actuated_of(each))
            ]
            kinds = {each.kind for each in self.scene.actuators}
            varying = [kind for kind in self.scene.combined_effects.varying if kind not in kinds]
            found = [*dict.fromkeys([*varying, *unknown])]
            told = {each.topic: each.channel for each in wrenches if not each.topic.endswith(APPLIED)}
            doubt = which_channel(told, self.scene)
        joints = [
            each.name
            for each in self.bag.topics.values()
            if each.type_name == JOINTS and each.count and each.name != self.wheels
            if not self._of_another_body(each.name)
        ]
        modelled = () if self.scene is None else self.scene.combined_effects.varying
        untold = [each for each in filter(None, effects.split(", ")) if each not in modelled]
        others = [
            *[f"the force and torque of {', '.join(untold)} are in no topic"] * bool(untold),
            *[self.doubt] * bool(self.doubt),
            *[f"{doubt} (choose it with --wrench-topic TOPIC=CHANNEL)"] * bool(doubt),
            *[f"what turns by {', '.join(joints)} has angular momentum, too"] * bool(joints),
        ]
        return [*["; ".join(others)] * bool(others), *[f"{OF_SCENE} {', '.join(found)}"] * bool(found)]

    def _line(self, topic: str, stamped: bool = True) -> ClockLine:
        """Return how the log times of a topic without stamps, such as one not `stamped`, follow those of the motion.

        Topics of the same clock, up to the transport delay, are left as they are.
        """
        source, clock = self.bag.topics[topic], self._clock(topic)
        if RUN in self.bag.metadata or not source.count or (stamped and source.stamps_given):
            return ClockLine()
        if source.type_name in (*WRENCHES, SCALAR) and (told := in_bursts(topic, source.log_times)):
            self.doubt = self.doubt or f"cannot tell when {topic} acted: {told}"
        if clock is None or standing(clock.stamps):
            return ClockLine()
        by, line = clock.name, StampClock.of(clock.log_times, clock.stamps).line
        off_s = max(line.error_s, line.ends_s)
        if not (line.straight and off_s * 1e9 <= APART_NS) and source.type_name in (*WRENCHES, SCALAR, JOINTS):
            self.doubt = self.doubt or (
                f"cannot tell when {topic} acted, which has no stamps: log times leave a line against the stamps of "
                f"{by} by {off_s:.3g} s; record by the clock of the stamps, or commands with stamps"
            )
        if line.drift == 0.0 and abs(line.behind_ns) <= APART * 1e9:
            return ClockLine()
        offset = line.behind_ns / 1e9
        rate = f", at first, and {1.0 / (1.0 - line.drift):.6g} times as slowly" if line.drift else ""
        self.notes.append(
            f"{topic} has no stamps, and {by} is stamped by another clock than that of the log times: {topic} is "
            f"put {abs(offset):.6g} s {'earlier' if offset > 0.0 else 'later'} than it was logged{rate}, as {by} "
            "is."
        )
        return line

    def _clock(self, topic: str) -> Topic | None:
        """Return what has both log times and stamps, by which those of a topic without stamps are understood."""
        motion = [name for name, use in self.uses.items() if use.startswith(("pose", "twist"))]
        if found := next((self.bag.topics[name] for name in motion if self.bag.topics[name].stamps_given), None):
            return found
        if motion or self.beside is None:
            return None
        wrenches = (each for each in self.bag.topics.values() if each.type_name in WRENCHES and each.count)
        if found := next((each for each in wrenches if each.stamps_given), None):
            return found
        mine, others = self.bag.topics[topic].log_times, self.beside.log_times
        return self.beside if len(mine) and mine.min() <= others.max() and mine.max() >= others.min() else None

    def _on_one_clock(self, series: TimeSeries | None) -> TimeSeries | None:
        return None if series is None else replace(series, time_ns=self._line(series.topic).stamps(series.time_ns))

    def _missing(self, own: bool) -> tuple[tuple[int, int], ...]:
        """Return each piece that the bag lacks by the clock of the motion: the last stamp before it, the first after.

        The bag knows log times, which may be those of another clock.
        """
        if own or not self.bag.missing:
            return tuple(self.bag.missing)
        stamped = []
        for name, use in self.uses.items():
            topic = self.bag.topics[name]
            if topic.count and use.startswith(("pose", "twist", "wrench")) and not standing(topic.stamps):
                stamps = topic.stamps if topic.stamps_given else self._line(name).stamps(topic.log_times)
                near = ~np.isin(stamps, strays(stamps))
                stamped.append((topic.log_times[near], stamps[near]))
        if not stamped:
            return tuple(self.bag.missing)
        log_times, stamps = map(np.concatenate, zip(*stamped, strict=True))
        late = log_times - stamps

        def least(side: NDArray[np.bool_]) -> int:
            # There may be nothing on a side: a lost piece of unknown times may be all of the time.
            return int((late[side] if side.any() else late).min())

        def told(begin: int, end: int) -> tuple[int, int]:
            before, after = log_times <= begin, log_times >= end
            first = int(stamps[before].max()) if before.any() else begin - least(after)
            last = int(stamps[after].min()) if after.any() else min(end - least(before), END_OF_TIME - 1)
            return first, max(first, last)

        return tuple(told(begin, end) for begin, end in self.bag.missing)

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
        kinds = {*POSES, *TWISTS, *WRENCHES} - ({ODOMETRY} if RUN in self.bag.metadata else set())
        named = {
            topic.name
            for topic in self.bag.topics.values()
            if topic.type_name in kinds and topic.count and topic.name not in self.bag.pairs
            if topic.name.rpartition("/")[2] != SET_STATE[0]
        }
        commands = sorted(
            name
            for name in named - {*self.uses}
            if _commanded(name) and self.bag.topics[name].type_name not in WRENCHES
        )
        if commands:
            self.notes.append(
                f"{', '.join(commands)}: named like a command, and so not taken for a measurement; --pose-topic and "
                "--twist-topic choose it all the same."
            )
        named -= {*commands}
        if RUN in self.bag.metadata and (scene := logged_scene(self.bag.attachments)) is not None:
            # What a pose sensor of the scene measures is compared, not left out.
            named -= {self.bag.called(each.name) for each in scene.sensors}
        if others := sorted(named - {*self.uses}):
            self.notes.append(f"One body is inspected; these topics are left out: {', '.join(others)}.")


def _without_repeats(found: Disorder, time_ns: Times, values: Array, order: NDArray[np.intp]) -> Disorder | None:
    """Return the disorder of the messages that are no exact repeats, as of a sender that sends again.

    Where half of all are, a whole run is in the file twice.
    """
    one, next_ = order[:-1], order[1:]
    same = (values[one] == values[next_]) | (np.isnan(values[one]) & np.isnan(values[next_]))
    again = next_[(time_ns[one] == time_ns[next_]) & same.reshape(len(one), -1).all(axis=1)]
    return disorder(np.delete(time_ns, again)) if 0 < 2 * len(again) < len(time_ns) else found


def _leap(pose: TimeSeries, moved_ns: int) -> int:
    """Return the sample near a time after which the pose leaps, three times as far as elsewhere; else that time."""
    first, end = np.searchsorted(pose.time_ns, [moved_ns - APART_NS, moved_ns + APART_NS])
    times, rows = pose.time_ns[first:end], np.nan_to_num(pose.values[first:end])
    if len(times) < 4:
        return moved_ns
    q = rows[:, 3:]
    turns = np.minimum(lengths(q[1:] - q[:-1]), lengths(q[1:] + q[:-1]))
    rates = np.stack([lengths(np.diff(rows[:, :3], axis=0)), turns]) / np.maximum(np.diff(times), 1)
    least, most = np.sort(rates, axis=1)[:, -2:].T
    for each in np.flatnonzero(most > 3.0 * least).tolist():
        return int(times[rates[each].argmax()])
    return moved_ns


def _over_stalls(steps: RecordedWrench, stalls: Sequence[Stall]) -> RecordedWrench:
    """Return commands that are not known where their channel delays them, or lets them expire, over a stall.

    It keeps the time of its simulator, which stood still, too.
    """
    channel = steps.channel
    if channel is None or not (channel.timeout or channel.delay or channel.lag):
        return steps
    stood = [each[:2] for each in stalls]
    within = [(begin < steps.time_ns) & (steps.time_ns < end) for begin, end in stood]
    return replace(steps, known=~np.any([*within, ~steps.known], axis=0)).without(stood)


def _commanded(topic: str) -> bool:
    """Return whether a topic is named like a command rather than a measurement."""
    return (
        re.search(
            r"(?:^|[/_])(?:cmd|commands?|goal|set_?point|set_state|desired|reference|initialpose)(?:[/_]|$)", topic
        )
        is not None
    )


def topic_table(bag: Bag) -> str:
    """Return the topics of a bag as lines: name, type, messages and mean rate by log time."""
    rows = [
        (topic.name, topic.type_name, f"{topic.count} messages", f"{rate:.4g} Hz" if rate else "")
        for _, topic in sorted(bag.topics.items())
        for rate in [mean_rate(topic.log_times)]
    ]
    if not rows:
        return "  no topics"
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def mean_rate(time_ns: Times) -> float:
    """Return the mean rate of messages, Hz; 0 for fewer than two, and for those of one time."""
    span = int(time_ns[-1] - time_ns[0]) if len(time_ns) else 0
    return (len(time_ns) - 1) / (span * 1e-9) if span > 0 else 0.0


def _steps(
    bag: Bag, topic: str, frames: WrenchFrames, limits: Channel | None, line: ClockLine, notes: list[str]
) -> RecordedWrench:
    commands = bag.wrenches(topic)
    if limits is not None:
        commands = _within(commands, topic, limits, notes)
    stamped = bag.topics[topic].stamps_given
    times = np.array([wrench.stamp_ns if stamped else log_time for log_time, wrench in commands], dtype=np.int64)
    times = times if stamped else line.stamps(times)
    if bag.topics[topic].stamped and len(times) == 1 and 0 < times[0] <= APART_NS and RUN not in bag.metadata:
        # At the beginning of a simulation the stamp of 0 of a single command is one.
        times = np.array([commands[0][1].stamp_ns], dtype=np.int64)
    moved = np.empty(0, np.int64)
    logged = np.array([log_time for log_time, _ in commands], dtype=np.int64)
    if stamped and RUN not in bag.metadata:
        lags = StrayStamps()
        lags.add(logged, times)
        if found := lags.found:
            moved, times = times[found.among(logged, times)], found.placed(logged, times)
    by_log = (bag.unset.get(topic, 0) + len(moved)) / max(len(times), 1) if stamped else 1.0
    late_ns, spread_ns = (0, 0) if RUN in bag.metadata or by_log else _arrival(logged, times)
    within_ns = 0 if RUN in bag.metadata else max(spread_ns, _within_ns(logged, times, by_log, line))
    far = np.empty(0, np.int64) if RUN in bag.metadata else strays(times)
    if len(far):
        near = np.flatnonzero(~np.isin(times, far))
        times, commands = times[near], [commands[row] for row in near.tolist()]
    held = [_held(wrench, frames) for _, wrench in commands]
    order = np.argsort(times, kind="stable")
    # A node that is paused takes all commands at one simulation time.
    still = "" if RUN in bag.metadata else standing(times)

    def rows(vectors: Sequence[Sequence[float]]) -> Array:
        return np.array(vectors, dtype=np.float64).reshape(-1, 3)[order]

    zero = HeldWrench()
    parts = [zero if part is None else part for part in held]
    world = np.array([wrench.frame_id == frames.world_frame for _, wrench in commands], dtype=bool)[order]
    return RecordedWrench(
        topic=topic,
        time_ns=times[order],
        force=rows([p.force_body for p in parts]) + rows([p.force_world for p in parts]),
        torque=rows([p.torque_body for p in parts]) + rows([p.torque_world for p in parts]),
        world=world,
        at_point=np.array([wrench.frame_id in (frames.fixed or {}) for _, wrench in commands], dtype=bool)[order],
        known=np.array([part is not None for part in held], dtype=bool)[order] & (not still),
        frames=tuple(sorted({wrench.frame_id for _, wrench in commands})),
        disorder=disorder(times),
        standing=still,
        channel=limits,
        far_ns=tuple(far.tolist()),
        moved_ns=tuple(moved.tolist()),
        within_ns=within_ns,
        late_ns=late_ns,
    )


def _within_ns(logged: Times, times: Times, by_log: float, line: ClockLine) -> int:
    """Return how far off the times of commands may be, of which the part `by_log` is from log times; see `_LATE_NS`."""
    if by_log == 1.0:
        return max(_LATE_NS, round(1e9 * max(line.error_s, line.ends_s)))
    if by_log:
        return round(min(_LATE_NS, int(np.abs(logged - times).max())) * math.sqrt(by_log))
    tick = int(np.gcd.reduce(times)) if len(times) else 0
    return tick if tick < _TICK_NS else 0


def _arrival(logged: Times, times: Times) -> tuple[int, int]:
    """Return how much later than their stamps commands were logged, usually, and how much that varies; ns.

    What takes commands on arrival takes them about then.
    """
    if not len(times):
        return 0, 0
    line = StampClock.of(logged, times).line
    late = (logged if line.one_clock else line.stamps(logged)) - times
    least, usual, most = np.quantile(late, (0.1, 0.5, 0.9))
    return round(min(usual, _LATE_NS)), round(min(most - least, _LATE_NS))


def _within(
    commands: Sequence[tuple[int, Wrench]], topic: str, limits: Channel, notes: list[str]
) -> list[tuple[int, Wrench]]:
    """Return the commands as the channel of the scene takes them, without those that it rejects."""
    taken, clipped = [], 0
    for log_time, wrench in commands:
        try:
            limited = limits.limited(wrench) if _usable(wrench) else wrench
        except WrenchError:
            continue
        clipped += limited is not wrench
        taken.append((log_time, limited))
    if changed := clipped or len(commands) - len(taken):
        done = "clipped to" if clipped else "rejected by"
        notes.append(f"{topic}: {changed} of {len(commands)} commands are {done} the limits of the scene's channel.")
    return taken


def _usable(wrench: Wrench) -> bool:
    return all(abs(number) < LARGEST for number in (*wrench.force, *wrench.torque))


def _held(wrench: Wrench, frames: WrenchFrames) -> HeldWrench | None:
    if not _usable(wrench):
        return None
    try:
        return frames.hold(wrench)
    except WrenchError:
        return None
