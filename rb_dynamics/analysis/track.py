"""`Track`: the motion of one body and its wrenches from a log or a bag, as arrays over time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.formats.log_metadata import MERGED, SCENE
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.logs.bag_reader import IMUS, Bag
from rb_dynamics.logs.own_log import logged_scene, scene_of_text
from rb_dynamics.logs.stamp_order import BACK_NS, Disorder, hangs, standing
from rb_dynamics.numerics.growing_array import give_back
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation_arrays import lengths, rotate_all_inverse
from rb_dynamics.scene.model import Scene

if TYPE_CHECKING:
    from rb_dynamics.analysis.stalls import Stall
    from rb_dynamics.analysis.wheel_speeds import WheelSpeeds

Array: TypeAlias = NDArray[np.float64]
Times: TypeAlias = NDArray[np.int64]
Rows: TypeAlias = "slice | NDArray[np.intp]"

# Larger numbers are not plausible in a motion, and their squares would overflow.
LARGEST = 1e100

_BLOCK = 1 << 14
_Items = TypeVar("_Items", Array, Times)


@dataclass(frozen=True)
class Spikes:
    """Samples of a sensor far from those about them: the unit, times (n,), and how far from these (n,)."""

    unit: str
    time_ns: Times
    size: Array

    def told(self, start_ns: int) -> str:
        """Return it as text, with times from `start_ns`."""
        at = int(self.time_ns[self.size.argmax()] - start_ns) * 1e-9
        is_are = "is a spike" if len(self.size) == 1 else "are spikes"
        return (
            f"{len(self.size)} {is_are}, up to {self.size.max():.3g} {self.unit} from the samples about them, the "
            f"largest at t = {at:.6g} s: judged without them"
        )


@dataclass(frozen=True)
class TimeSeries:
    """Rows of numbers over time.

    Attributes:
        topic: as recorded; "" if computed.
        time_ns: stamps, ascending; log times if messages have no stamp.
        values: one row, or one number, per time; all finite and below `LARGEST`, except columns that nothing measures,
            such as the velocity in addition to the rates of a gyro: these are NaN throughout.
        frame: the header's frame, "" if there is none.
        disorder: stamps that do not ascend in the file; None if all do.
        unusable: number of messages left out because a number in them is not finite or too large.
        strays: number of messages left out because they are of other frames, by these, as in "map:base_link".
        far_ns: stamps that are left out because they are far from all the others.
        spikes: of which the values are those between the samples about them.
        turned_to: the frame of the body to whose axes the values of a sensor are turned; "" if they are in `frame`.
        turned_by: xyzw, if so.
    """

    topic: str
    time_ns: Times
    values: Array
    frame: str = ""
    disorder: Disorder | None = None
    unusable: int = 0
    strays: Mapping[str, int] = field(default_factory=dict)
    far_ns: tuple[int, ...] = ()
    spikes: tuple[Spikes, ...] = ()
    turned_to: str = ""
    turned_by: Array | None = None

    @property
    def partial(self) -> bool:
        """Whether there are columns that nothing measures."""
        return any(bool(np.isnan(rows).any()) for rows in in_blocks(self.values))

    @property
    def left_out(self) -> int:
        """Messages that are left out."""
        return self.unusable + len(self.far_ns) + sum(self.strays.values())

    @property
    def count(self) -> int:
        """Messages, with those that are left out."""
        return len(self.time_ns) + self.left_out

    @property
    def once(self) -> TimeSeries:
        """The same with the first sample of each stamp: stamps of a coarse clock stand for several."""
        first = np.append(True, np.diff(self.time_ns) > 0)
        return self if first.all() else replace(self, time_ns=self.time_ns[first], values=self.values[first])

    @property
    def hangs(self) -> list[tuple[int, int]]:
        """As `stamp_order.hangs`; samples that repeat the one before do not count."""
        at = np.flatnonzero(np.diff(self.time_ns) == 0)
        one, next_ = (self.values[rows] for rows in (at, at + 1))
        again = ((one == next_) | (np.isnan(one) & np.isnan(next_))).all(axis=tuple(range(1, one.ndim)))
        return hangs(np.delete(self.time_ns, at[again]))

    def faults(self, start_ns: int) -> list[str]:
        """Return what is wrong with frames and stamps, as text; times count from `start_ns`."""
        told = []
        if self.strays:
            each = ", ".join(f"{frame or '(no name)'} {count}×" for frame, count in self.strays.items())
            of = f"{sum(self.strays.values())} of {self.count} messages"
            told.append(f"{of} are of other frames than the rest, and left out: {each}")
        told += [_far(self.far_ns, self.count, start_ns)] if self.far_ns else []
        told += [self.disorder.told(start_ns)] if self.disorder is not None else []
        told += [each.told(start_ns) for each in self.spikes]
        told += [
            f"stamps stand still at t = {(at - start_ns) * 1e-9:.6g} s for {count} samples: those after are too early"
            for at, count in self.hangs
        ]
        return told + [still for still in [standing(self.time_ns)] if still]


def _far(far_ns: Sequence[int], count: int, start_ns: int, done: str = "left out") -> str:
    """Return that stamps of `count` messages are far from all the others, as text."""
    away = max(far_ns, key=lambda at: abs(at - start_ns)) - start_ns
    is_are, up_to = ("is", "") if len(far_ns) == 1 else ("are", "up to ")
    return (
        f"{len(far_ns)} of {count} stamps {is_are} far from all the others, {up_to}{abs(away) * 1e-9:.6g} s "
        f"{'before' if away < 0 else 'after'} the start, and {done}"
    )


@dataclass(frozen=True)
class RecordedWrench:
    """One wrench channel: each row is held until the next.

    Attributes:
        topic: as recorded; ends in "/applied" for an applied wrench, otherwise it is a command.
        time_ns: when each row takes effect.
        force: N, in the axes of the frame, through the centre of mass.
        torque: N m, in the axes of the frame, about the centre of mass.
        world: whether a row is in world axes; otherwise it rotates with the body.
        at_point: whether the force acts at a point of the body: the torque holds for the centre of mass that is known.
        known: False for a row with an undeclared frame or unusable numbers.
        frames: every `frame_id` met.
        disorder: times that do not ascend in the file; None if all do.
        standing: that the stamps stand still, as text; "" if they do not, or are simulation times of this package.
        channel: of the scene, whose commands these are; None for what is applied or of no channel.
        weight: whether it is the weight by the scene, which goes with the mass that is given.
        far_ns: stamps that are left out because they are far from all the others.
        moved_ns: stamps that are as far, and not those at which the rows take effect: these follow the log times.
        within_ns: how far off times may be, each by itself, as of commands without stamps or with rounded ones.
        late_ns: by how much later all rows take effect if it is on arrival.
    """

    topic: str
    time_ns: Times
    force: Array
    torque: Array
    world: NDArray[np.bool_]
    at_point: NDArray[np.bool_]
    known: NDArray[np.bool_]
    frames: tuple[str, ...]
    disorder: Disorder | None = None
    standing: str = ""
    channel: Channel | None = None
    weight: bool = False
    far_ns: tuple[int, ...] = ()
    moved_ns: tuple[int, ...] = ()
    within_ns: int = 0
    late_ns: int = 0

    def faults(self, start_ns: int) -> list[str]:
        """Return what is wrong with the stamps, as text; times count from `start_ns`."""
        count = len(self.time_ns) + len(self.far_ns)
        told = [_far(self.far_ns, count, start_ns)] if self.far_ns else []
        told += [_far(self.moved_ns, count, start_ns, "taken at the log time instead")] if self.moved_ns else []
        back = self.disorder
        if back is not None and back.most_ns > BACK_NS and not back.restarts:
            told.append(f"{back.told(start_ns)}; of some, when they acted is doubtful")
        return told + ([f"{self.standing}: when each wrench acted is not known"] if self.standing else [])

    def accepted(self) -> RecordedWrench:
        """Return the same without rows that are not known: a command that is rejected leaves the one before."""
        rows = {name: getattr(self, name)[self.known] for name in ("time_ns", "force", "torque", "world", "at_point")}
        return replace(self, known=self.known[self.known], **rows)

    def without(self, missing: Sequence[tuple[int, int]]) -> RecordedWrench:
        """Return the same, marked unknown from the start of each `missing` piece (first and last ns) to the next row.

        The missing piece may contain a change of the wrench.
        """
        begins = np.array([begin_ns for begin_ns, _ in missing], dtype=np.int64)
        at = np.searchsorted(self.time_ns, begins, side="right")
        return replace(
            self,
            time_ns=np.insert(self.time_ns, at, begins),
            force=np.insert(self.force, at, 0.0, axis=0),
            torque=np.insert(self.torque, at, 0.0, axis=0),
            world=np.insert(self.world, at, False),
            at_point=np.insert(self.at_point, at, False),
            known=np.insert(self.known, at, False),
        )


@dataclass(frozen=True)
class Track:
    """What a bag says about one body; None for what it does not contain.

    Attributes:
        bag: the source.
        own: whether this package wrote the log.
        pose: rows of position (m) and quaternion x, y, z, w.
        twist: rows of linear (m/s, of the body origin) and angular velocity (rad/s), in the axes of its frame.
        rates: a twist in body axes that is computed from the pose where none is recorded; to be shown, not to judge by.
        specific_force: of an accelerometer, m/s^2, in its axes: acceleration minus gravity.
        twist_in_world: whether those are the world's axes.
        angular_momentum: kg m^2/s, about the centre of mass, world axes.
        linear_momentum: kg m/s, world axes.
        kinetic_energy: J.
        work: J.
        energy_defect: J.
        motor_work: of the motors of reaction wheels, J; part of `work`.
        friction_heat: of reaction wheels, J; subtracted in `work`.
        momenta_from: source of momenta and kinetic energy: "the log", or what they are computed from; "" without.
        wrenches: applied wrenches; commands, if a bag has no applied wrenches.
        acted: whether `wrenches` are known to be complete.
        by_scene: what acts of commands by a scene, and what the scene itself holds; None without a scene.
        unrecorded: what moved the body beside them, as text; "" if nothing is known to.
        doubt: why it cannot be told which wrenches are the body's or when they acted, and the remedy; "" if it can.
        body: mass properties.
        body_from: source of the mass properties; "" without.
        notes: remarks on the data for the reader.
        frames_to_choose: which frames move, if there is no other pose, and the remedy; "" unless there are several.
        uses: purpose of each topic that is used.
        pointing: angle of the attitude from a target, rad, where one was given.
        wheels: speeds of the reaction wheels, by the clock of the motion, where they were given.
        missing: first and last time of each piece of the recording that is not here, by the clock of the motion.
        moved_ns: when the body was moved to another state from outside, ascending, by that clock; a sample of that
            time is from before.
        stalls: where the body stood still while the stamps went on, in a bag of another program.
    """

    bag: Bag
    own: bool
    pose: TimeSeries | None
    twist: TimeSeries | None
    twist_in_world: bool
    angular_momentum: TimeSeries | None
    linear_momentum: TimeSeries | None
    kinetic_energy: TimeSeries | None
    work: TimeSeries | None
    energy_defect: TimeSeries | None
    momenta_from: str
    wrenches: tuple[RecordedWrench, ...]
    acted: bool
    body: RigidBody | None
    body_from: str
    notes: tuple[str, ...]
    uses: Mapping[str, str] = field(default_factory=dict)
    frames_to_choose: str = ""
    unrecorded: str = ""
    doubt: str = ""
    by_scene: tuple[RecordedWrench, ...] | None = None
    rates: TimeSeries | None = None
    specific_force: TimeSeries | None = None
    pointing: TimeSeries | None = None
    motor_work: TimeSeries | None = None
    friction_heat: TimeSeries | None = None
    wheels: WheelSpeeds | None = None
    missing: tuple[tuple[int, int], ...] = ()
    moved_ns: Times = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    stalls: tuple[Stall, ...] = ()

    @property
    def breaks_ns(self) -> Times:
        """The samples, ascending, after which the motion is not that of the time until the next: moves and stalls."""
        return np.union1d(self.moved_ns, np.array([each.start_ns for each in self.stalls], dtype=np.int64))

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last time of the motion, or of the wrenches if no motion is recorded."""
        motion = [series.time_ns for series in self.motion if len(series.time_ns)]
        times = motion or [steps.time_ns for steps in self.wrenches if len(steps.time_ns)]
        if not times:
            return 0, 0
        return int(min(time[0] for time in times)), int(max(time[-1] for time in times))

    def moved_before(self, time_ns: Times) -> NDArray[np.bool_]:
        """Return for each sample whether the body was moved, or stood still, since the one before."""
        moved = np.zeros(len(time_ns) + 1, dtype=bool)
        moved[np.searchsorted(time_ns, self.breaks_ns, side="right")] = True
        return moved[:-1]

    @property
    def zero_ns(self) -> int:
        """The time from which the output counts: the start of the motion, of a part that of the whole; 0 in our log."""
        return self.span_ns[0] if self.bag.zero_ns is None else self.bag.zero_ns

    @property
    def faults(self) -> list[str]:
        """What is wrong with frames and stamps of pose, twist and wrenches, as text."""
        every: tuple[TimeSeries | RecordedWrench, ...] = (*self.motion, *self.wrenches)
        told = (f"{each.topic}: {fault}" for each in every for fault in each.faults(self.zero_ns))
        return [*dict.fromkeys(told)]

    @property
    def motion(self) -> tuple[TimeSeries, ...]:
        """Pose and twist, as far as they are recorded."""
        return tuple(series for series in (self.pose, self.twist) if series is not None)

    @cached_property
    def scene(self) -> Scene | None:
        """The scene of a log of this package."""
        return logged_scene(self.bag.attachments) if self.own else None

    @cached_property
    def at_steps(self) -> bool:
        """Whether this package logged a sample at every step, however long: long intervals are no gaps.

        A bag made of its logs has their scenes.
        """
        of_logs = self.own or MERGED in self.bag.metadata
        texts = (text for name, text in self.bag.attachments.items() if of_logs and name.endswith(SCENE))
        return any(scene is not None and scene.output_rate == 0.0 for scene in map(scene_of_text, texts))

    def from_imu(self, series: TimeSeries) -> bool:
        """Return whether an IMU measured a series: its attitude is an estimate."""
        topic = self.bag.topics.get(series.topic)
        return topic is not None and topic.type_name in IMUS

    @property
    def moving(self) -> TimeSeries | None:
        """The twist as recorded, else as computed from the pose."""
        return self.twist or self.rates

    @property
    def acting(self) -> tuple[RecordedWrench, ...]:
        """What acts as far as it is known: `by_scene`, else as recorded."""
        return self.recorded if self.by_scene is None else self.by_scene

    @property
    def recorded(self) -> tuple[RecordedWrench, ...]:
        """`wrenches`, marked unknown after a missing piece of the recording."""
        return tuple(steps.without(self.missing) for steps in self.wrenches)

    def seconds(self, time_ns: Times) -> Array:
        """Return times as s from `zero_ns`; the difference is computed in integers."""
        return (time_ns - self.zero_ns) / NANOSECONDS


@dataclass(frozen=True)
class Motion:
    """Pose and twist at their common stamps.

    Attributes:
        time_ns: the stamps, (n,).
        orientation_xyzw: (n, 4), body to world, unit length.
        linear_velocity_body: (n, 3), of the body origin, m/s, body axes.
        angular_velocity_body: (n, 3), rad/s.
    """

    time_ns: Times
    orientation_xyzw: Array
    linear_velocity_body: Array
    angular_velocity_body: Array


def in_blocks(rows: _Items, shared: int = 0) -> Iterator[_Items]:
    """Yield rows in blocks: what is computed of all rows of a long log takes as much memory as the log.

    Of two blocks that follow each other, the last rows of one, `shared` many, are the first of the next, so that all
    differences between neighbours are in one of them.
    """
    for part in parts(len(rows) - shared):
        yield rows[part.start : part.stop + shared]
        give_back(rows)


def parts(count: int, together: int = 1) -> Iterator[slice]:
    """Yield the rows of each block of `count`, which are multiples of `together`."""
    size = max(_BLOCK // together, 1) * together
    for first in range(0, count, size):
        yield slice(first, min(first + size, count))


def sizes_of(rows: Array) -> Array:
    """Return the length of each row, or the magnitude of each number."""
    blocks = [np.abs(block) if block.ndim == 1 else lengths(block) for block in in_blocks(rows)]
    return np.concatenate(blocks) if blocks else np.empty(0)


def largest(rows: Array) -> float:
    """Return the largest of `sizes_of`, 0 for none."""
    return max((float(sizes_of(part).max()) for part in in_blocks(rows)), default=0.0)


def frame_names(frames: Iterable[str]) -> str:
    """Return names of frames as text, the empty one in quotes."""
    return ", ".join(frame or '""' for frame in frames)


def motion_of(pose: TimeSeries, twist: TimeSeries, twist_in_world: bool) -> Motion:
    """Return pose and twist at their common stamps; `twist_in_world` as in `Track`."""
    return _motion(shared(pose.time_ns, twist.time_ns), pose, twist, twist_in_world)


def motion_blocks(pose: TimeSeries, twist: TimeSeries, twist_in_world: bool) -> Iterator[Motion]:
    """Yield the same in blocks."""
    time_ns, at_pose, at_twist = shared(pose.time_ns, twist.time_ns)
    for part in parts(len(time_ns)):
        one, other = (part if isinstance(rows, slice) else rows[part] for rows in (at_pose, at_twist))
        yield _motion((time_ns[part], one, other), pose, twist, twist_in_world)
        give_back(pose.values)
        give_back(twist.values)


def _motion(at: tuple[Times, Rows, Rows], pose: TimeSeries, twist: TimeSeries, twist_in_world: bool) -> Motion:
    time_ns, at_pose, at_twist = at
    attitude = unit_rows(pose.values[at_pose, 3:])
    velocity, omega = twist.values[at_twist, :3], twist.values[at_twist, 3:]
    if twist_in_world:
        velocity, omega = rotate_all_inverse(attitude, velocity), rotate_all_inverse(attitude, omega)
    return Motion(time_ns, attitude, velocity, omega)


def shared(one: Times, other: Times) -> tuple[Times, Rows, Rows]:
    """Return the times of both, and their rows in each."""
    # Mostly they are the same times: to sort those of a long log takes as much memory as the log.
    if np.array_equal(one, other) and (one[1:] > one[:-1]).all():
        return one, slice(None), slice(None)
    return np.intersect1d(one, other, return_indices=True)


def filled_in(orientation_xyzw: Array) -> NDArray[np.bool_]:
    """Return which quaternions can be normalised to an attitude: not those of zeros, which nobody filled in."""
    mask: NDArray[np.bool_] = sizes_of(orientation_xyzw) > 0.5
    return mask


def unit_rows(orientation_xyzw: Array) -> Array:
    """Return each quaternion divided by its norm; zero stays zero."""
    norms = lengths(orientation_xyzw)[:, None]
    result: Array = orientation_xyzw / np.where(norms > 0.0, norms, 1.0)
    return result
