"""Wrench channels: each holds its last command until the next one or its timeout; their wrenches add up.

This module decides when a command takes effect and which commands are too large; `wrench.py` converts a command to
force and torque about the centre of mass.
"""

from __future__ import annotations

import heapq
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError, WrenchError
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.gradual_wrench import Transient, seen_in_one_frame
from rb_dynamics.loads.number_ranges import TIME
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import HeldWrench, Wrench, WrenchFrames, largest_wrench, require_possible
from rb_dynamics.loads.wrench_command_arrays import (
    HELD,
    Changes,
    CommandBatch,
    CommandTable,
    Holding,
    Timeline,
    changes,
    timeline,
)
from rb_dynamics.numerics.argument_checks import instance, number, shown, truth, vector
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, nanoseconds
from rb_dynamics.numerics.rotation import IDENTITY, Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector, norm, scale

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Numbers = npt.NDArray[np.float64]
    Whole = npt.NDArray[np.int64]

ON_EXCESS = ("reject", "clip")
"""What a channel may do with a command beyond its limits."""

# m/s^2 and rad/s^2, more than any actuator gives. If the motion cannot continue and the accelerations are larger, the
# command is rejected; if they are smaller, the step or the accuracy is the cause, which is an error for the user.
HUGE = 1e6


# Topics that the node publishes: a channel of the same name would clash with them in the graph and in the log.
_PUBLISHED = frozenset(
    {
        "pose", "twist", "odom", "accel", "angular_momentum", "linear_momentum", "energy/kinetic", "energy/work",
        "energy/defect", "energy/potential", "wheels", "inertia", "diagnostics", "tf", "tf_static", "clock",
    }
)  # fmt: skip


NAMING = "use letters, digits and _, with / between parts that do not begin with a digit"
"""How to write a valid topic name, for error messages."""


def is_topic_name(topic: str) -> bool:
    """Return whether a ROS 2 topic may have this name, without substitutions and private parts."""
    parts = topic.removeprefix("/").split("/")
    return len(topic) <= 200 and all(re.fullmatch(r"(?!.*__)[A-Za-z_][A-Za-z0-9_]*", part) for part in parts)


def topic_fault(topic: str) -> tuple[str, str] | None:
    """Return what was expected instead of the topic of a channel, and the remedy; None if the topic is valid."""
    name = topic.removeprefix("/")
    if not is_topic_name(topic):
        return "a ROS topic name", NAMING
    if name in _PUBLISHED:
        return "a topic that rb_dynamics does not publish itself", "take another name"
    if name.startswith("effects/"):
        return "a topic outside effects/, where the log keeps what effects hold", "take another name"
    if name.endswith("/applied"):
        return "a topic that does not end in /applied, where the log keeps what acted", "take another name"
    return None


@dataclass(frozen=True, slots=True)
class Channel:
    """One wrench channel of a scene.

    Attributes:
        topic: relative topic name.
        timeout: time without a command after which the channel drops to zero, s; 0 to hold for ever.
        optional: in lockstep, time does not wait for its first command.
        max_force: largest force of a command, N; infinite for no limit.
        max_torque: largest torque of a command, N m, without the moment of the force; infinite for no limit.
        on_excess: `reject` a command beyond a limit, or `clip` it: scale the vector down to the limit.
        delay: time from a command to its effect, s.
        bias_force: N, through the centre of mass in body axes: acts from time 0 on, whatever is commanded.
        bias_torque: N m, likewise.
        lag: time constant with which the acting wrench follows the command (first order), s; 0 for at once.
    """

    topic: str = "wrench"
    timeout: float = 0.0
    optional: bool = False
    max_force: float = math.inf
    max_torque: float = math.inf
    on_excess: str = "reject"
    delay: float = 0.0
    bias_force: Vector = ZERO
    bias_torque: Vector = ZERO
    lag: float = 0.0

    def __post_init__(self) -> None:
        """Check the arguments.

        Raises:
            TypeError: a field is not of its type.
            SceneError: the topic, timeout, a limit or `on_excess` is invalid.
        """
        if not instance(self.topic, str, "topic", "write the name of a topic"):
            raise SceneError("topic is '', expected the name of a topic; write one, as 'wrench'")
        for name in ("timeout", "delay", "lag"):
            object.__setattr__(self, name, TIME.require(getattr(self, name), name))
        object.__setattr__(self, "optional", truth(self.optional, "optional"))
        for name in ("max_force", "max_torque"):
            limit = getattr(self, name)
            # Comparisons with a masked number are neither true nor false: it is not a limit.
            if getattr(limit, "mask", False) or limit != math.inf:
                expected = "a number greater than 0, infinite for no limit"
                object.__setattr__(self, name, number(limit, name, expected, SceneError, above=0.0))
        for name, what in (("bias_force", "a force (N)"), ("bias_torque", "a torque (N m)")):
            object.__setattr__(self, name, vector(getattr(self, name), name, what, SceneError))
        if self.on_excess not in ON_EXCESS:
            raise SceneError(
                f"on_excess is {shown(self.on_excess)}, expected {' or '.join(ON_EXCESS)}; write one of them"
            )

    @property
    def timeout_ns(self) -> int:
        """The timeout in ns; 0 to hold for ever."""
        return round(self.timeout * NANOSECONDS)

    @property
    def delay_ns(self) -> int:
        """The delay in ns."""
        return nanoseconds(self.delay)

    @property
    def bias(self) -> Wrench | None:
        """The bias, which acts whatever is commanded; None if there is none."""
        return (
            Wrench(self.bias_force, self.bias_torque) if (self.bias_force, self.bias_torque) != (ZERO, ZERO) else None
        )

    def limited(self, wrench: Wrench) -> Wrench:
        """Return `wrench` within the limits of the channel: itself if it is.

        Raises:
            WrenchError: it exceeds a limit, and the channel does not clip.
        """
        force = self._within("force", wrench.force, self.max_force, "N")
        torque = self._within("torque", wrench.torque, self.max_torque, "N m")
        if force is wrench.force and torque is wrench.torque:
            return wrench
        return replace(wrench, force=force, torque=torque)

    def _within(self, name: str, vector: Vector, limit: float, unit: str) -> Vector:
        if limit == math.inf:
            return vector
        size = norm(vector)
        # The norm of a command that a controller has saturated exactly at the limit may be rounded up.
        if size <= limit * (1.0 + 1e-12):
            return vector
        if self.on_excess == "clip":
            # In two factors, because the norm of finite numbers may overflow.
            direction = scale(1.0 / max(map(abs, vector)), vector)
            return scale(limit / norm(direction), direction)
        raise WrenchError(
            f"wrench {name} is {size:.9g} {unit}, expected at most max_{name} = {limit!r} {unit} of the channel "
            f"{self.topic}; command less, or set on_excess: clip in the scene"
        )


class ChannelBias(Effect):
    """The bias of a channel: held from time 0 on, and logged like the wrench of an effect."""

    def __init__(self, channel: Channel) -> None:
        """Create the bias of `channel`."""
        self.kind = f"{channel.topic.removeprefix('/')}/bias"  # type: ignore[misc]
        self._bias = channel.bias or Wrench()

    def schedule(self, body: RigidBody) -> tuple[tuple[float, Wrench], ...]:
        """Return the bias."""
        return ((0.0, self._bias),)


class ChannelLag(Effect):
    """The lag of a channel: its wrench changes inside a step, while it follows the command."""

    takes = LoadDependence.FIELD

    def __init__(self, channel: Channel) -> None:
        """Create the lag of `channel`."""
        self.kind = f"{channel.topic.removeprefix('/')}/lag"  # type: ignore[misc]


@dataclass(frozen=True, slots=True)
class AppliedWrench:
    """A channel's wrench has changed or, with a lag, is changing at an output.

    Attributes:
        time_ns: simulation time at which it took effect.
        topic: the channel's topic, as the scene writes it.
        received: the command as received; None if a timeout dropped the channel to zero, or `on_its_way`.
        frame_id: the axes of `force` and `torque`: body or world frame.
        force: N, through the centre of mass.
        torque: N m, about the centre of mass.
        clipped: whether the channel's limits reduced the command.
        delayed: whether the command was received, and reported, earlier.
        timed_out: whether a timeout dropped the channel to zero.
        on_its_way: whether this is not a new change: with a lag, the wrench still follows an earlier one.
    """

    time_ns: int
    topic: str
    received: Wrench | None
    frame_id: str
    force: Vector
    torque: Vector
    clipped: bool = False
    delayed: bool = False
    timed_out: bool = field(default=False, compare=False)
    on_its_way: bool = field(default=False, compare=False)


@dataclass(frozen=True, slots=True)
class ReceivedWrench:
    """A command was received that takes effect after the delay of its channel.

    Attributes:
        time_ns: simulation time at which it was received.
        topic: the channel's topic, as the scene writes it.
        received: the command as received.
    """

    time_ns: int
    topic: str
    received: Wrench


@dataclass(frozen=True, slots=True)
class RejectedWrench:
    """A command that was rejected.

    Attributes:
        time_ns: simulation time at which it would have taken effect.
        topic: the channel's topic, as the scene writes it.
        received: the command as received.
        reason: what was found and expected, and the remedy.
        delayed: whether the command was received, and reported, earlier.
    """

    time_ns: int
    topic: str
    received: Wrench
    reason: str
    delayed: bool = False


class CheckedWrench(NamedTuple):
    """A command after the checks of its channel.

    Attributes:
        channel: number of the channel in the order of the scene.
        received: the command as received.
        held: the wrench while the command is held; None if it is rejected.
        reason: why it is rejected.
        clipped: whether the limits of the channel reduced it.
    """

    channel: int
    received: Wrench
    held: HeldWrench | None
    reason: str = ""
    clipped: bool = False

    def require(self) -> bool:
        """Return `clipped`.

        Raises:
            WrenchError: the command is rejected.
        """
        if self.held is None:
            raise WrenchError(self.reason)
        return self.clipped


class _Hold(NamedTuple):
    held: HeldWrench = HeldWrench()
    received: Wrench | None = None
    expires_ns: int | None = None
    transient: Transient | None = None

    def at(self, time_ns: int) -> HeldWrench:
        """Return the wrench that acts."""
        return self.held if self.transient is None else self.transient.at(time_ns)


class _Pending(NamedTuple):
    """A command that waits for its time.

    At equal times the channels come in the order of the scene, whatever the order of arrival; within a channel that
    order is kept, so the last command wins. `number` is unique, so the fields after it are never compared.
    """

    time_ns: int
    channel: int
    number: int
    command: CheckedWrench
    on_its_way: bool = False


class WrenchChannels:
    """The channels of one run, in the order of the scene.

    Attributes:
        lag: whether a channel follows its commands with a lag.
        came: events of the last `apply` about commands that take effect later or never; `take_back` keeps them.
    """

    def __init__(
        self,
        channels: Sequence[Channel],
        frames: WrenchFrames,
        effects: Sequence[str] = (),
        body: RigidBody | None = None,
    ) -> None:
        """Start with every channel at zero; the channels of the scene are followed by one for each of `effects`.

        Commands are checked to be bearable for `body`; without it, any finite command is accepted.
        """
        self._channels = (*channels, *(Channel(name) for name in effects))
        self._commanded = len(channels)
        self.lag = any(channel.lag for channel in channels)
        self._index = {c.topic.lstrip("/"): i for i, c in enumerate(channels)}
        self._timeout_ns = [channel.timeout_ns for channel in self._channels]
        self._delay_ns = [channel.delay_ns for channel in self._channels]
        self._frames = frames
        self._holds = [_Hold() for _ in self._channels]
        self._queue: list[_Pending] = []
        self._number = 0
        self._body = body
        self._largest = largest_wrench(body) if body is not None else (math.inf, math.inf)
        # Commands received as arrays, and the index of the first that has not yet taken effect.
        self._table: CommandTable | None = None
        self._row = 0
        # The commands that the last `apply` handled, and the wrenches held before.
        self._done: list[_Pending] = []
        self._before = self._holds
        self.came: list[ReceivedWrench | RejectedWrench] = []

    def post(self, topic: str, wrench: Wrench, time_ns: int) -> bool:
        """Let `wrench` take effect on the channel `topic` at `time_ns`; return whether its limits clipped it.

        Raises:
            WrenchError: no such channel, a component is not finite or too large, or the frame is unknown. The command
                has no effect; on a channel of the scene it is reported as rejected when its time comes.
        """
        command = self.check(topic, wrench)
        self.take(command, time_ns)
        return command.require()

    def number(self, topic: str) -> int | None:
        """Return the number of the channel `topic` in the order of the scene; None if there is none."""
        return self._index.get(topic.lstrip("/"))

    def life_ns(self, channel: int) -> float:
        """Return the time (ns) after which a command on a channel, by its number, has ended; infinite if it holds."""
        timeout_ns = self._timeout_ns[channel]
        return self._delay_ns[channel] + timeout_ns if timeout_ns else math.inf

    def check(self, topic: str, wrench: Wrench) -> CheckedWrench:
        """Return the command after the checks of the channel `topic`, without applying it.

        Raises:
            WrenchError: no such channel.
        """
        channel = self.number(topic)
        if channel is None:
            raise WrenchError(f"wrench topic is {topic!r}, expected one of {sorted(self._index)} as in scene.wrenches")
        return self._checked(channel, wrench)

    def take(self, command: CheckedWrench, time_ns: int) -> None:
        """Let a command from `check` take effect at `time_ns`, or be reported as rejected then."""
        self._number += 1
        heapq.heappush(self._queue, _Pending(time_ns, command.channel, self._number, command))

    def regular(self, batch: CommandBatch) -> tuple[CommandTable, Whole]:
        """Return the commands of a sorted `batch` that act unchanged, and the rows of those to be checked one by one.

        The latter are those that `check` may refuse or clip, or that may be `huge`, and others of the same channel and
        time.
        """
        import numpy as np

        held, good = self._held(batch)
        for k, channel in enumerate(self._channels[: self._commanded]):
            if self._delay_ns[k] or channel.lag:
                good[batch.channel == k] = False
            # Commands close to a limit are left to `check`.
            for limit, part in ((channel.max_force, batch.wrench[:, :3]), (channel.max_torque, batch.wrench[:, 3:])):
                if limit != math.inf:
                    mine = batch.channel == k
                    with np.errstate(over="ignore"):  # an overflow is beyond every limit
                        good[mine] &= np.linalg.norm(part[mine], axis=1) < 0.999 * limit
        if good.all():
            return CommandTable(batch, held), np.empty(0, dtype=np.int64)
        for k in range(self._commanded):
            mine = batch.channel == k
            good[mine] &= ~np.isin(batch.time_ns[mine], batch.time_ns[mine & ~good])
        return CommandTable(batch.some(good.nonzero()[0]), held[good]), np.flatnonzero(~good)

    def _held(self, batch: CommandBatch) -> tuple[Numbers, npt.NDArray[np.bool_]]:
        """Return the held wrench of each command, and whether it needs no further check."""
        import numpy as np

        count = len(batch.time_ns)
        held, good = np.zeros((count, HELD)), np.zeros(count, dtype=bool)
        for k, name in enumerate(batch.frame_ids):
            if name not in self._frames.names:
                continue
            mine = (batch.frame == k).nonzero()[0]
            columns: Any = tuple(batch.wrench.take(mine, axis=0).T)
            good[mine] = True
            with np.errstate(over="ignore", invalid="ignore"):
                parts: Any = self._frames.about_center_of_mass(columns[:3], columns[3:], name)
            for i, numbers in enumerate(n for part in parts for n in part):
                if isinstance(numbers, np.ndarray):
                    held[mine, i] = numbers
        largest_force, largest_torque = self._largest
        if self._body is not None:
            largest_force = min(largest_force, 0.999 * HUGE * self._body.mass)
            largest_torque = (
                0.0 if self._body.is_particle else min(largest_torque, 0.999 * HUGE * min(self._body.principal_moments))
            )
        elif self._frames.turns is False:
            largest_torque = 0.0
        # Usually all are smaller than any limit; one by one takes longer.
        limit = min(largest_force, largest_torque)
        if not (held.max(initial=0.0) <= limit and held.min(initial=0.0) >= -limit):
            good &= (np.abs(held) <= np.repeat([largest_force, largest_torque] * 2, 3)).all(axis=1)
        return held, good

    def extend(self, table: CommandTable) -> None:
        """Let the commands of `table` take effect, each at its time; none comes before one of an earlier table."""
        self._table, self._row = table if self._table is None else self._table.followed_by(table, self._row), 0

    def hasten(self, by_ns: int | None, now_ns: int) -> list[str]:
        """Let pending commands that have a stamp act `by_ns` sooner, None: never; return the topics of these.

        Of each channel's commands that would have acted before `now_ns`, the newest acts then, and the others never.
        """
        kept: list[_Pending] = []
        newest: dict[int, _Pending] = {}
        overtaken = []
        for pending in sorted(self._queue):
            channel, command = pending.channel, pending.command
            if channel >= self._commanded or pending.on_its_way or not command.received.stamp_ns:
                kept.append(pending)
            elif by_ns is None:
                overtaken.append(self._channels[channel].topic)
            elif pending.time_ns - by_ns > now_ns or command.held is None:
                kept.append(pending._replace(time_ns=max(now_ns, pending.time_ns - by_ns)))
            else:
                if channel in newest:
                    overtaken.append(self._channels[channel].topic)
                newest[channel] = pending._replace(time_ns=now_ns)
        self._queue = [*kept, *newest.values()]
        heapq.heapify(self._queue)
        return overtaken

    @property
    def tabled(self) -> int:
        """Number of commands received as arrays that have not yet taken effect."""
        return 0 if self._table is None else len(self._table.time_ns) - self._row

    def timeline(self, until_ns: int, most: int) -> tuple[Timeline, int]:
        """Return the coming changes up to `until_ns`, and the time (ns) until which they are complete; applies nothing.

        That time is before `until_ns` if only `apply` can decide, or if there are more than `most` commands.
        """
        if self._queue:
            until_ns = min(until_ns, self._queue[0].time_ns - 1)
        for change_ns in self._lagging():
            until_ns = min(until_ns, change_ns - 1)
        if self._table is not None and self._row + most < len(self._table.time_ns):
            until_ns = min(until_ns, int(self._table.time_ns[self._row + most]) - 1)
        table = self._table or CommandTable.empty()
        return timeline(table, self._due(until_ns), self._holding, self._timeout_ns, until_ns), until_ns

    @property
    def _holding(self) -> list[Holding]:
        return [Holding([n for part in hold.held for n in part], hold.expires_ns) for hold in self._holds]

    def changes(self, until_ns: int) -> Changes:
        """Apply every change that is due by `until_ns` and return them; `timeline` has returned them all."""
        table, frames = self._table or CommandTable.empty(), (self._frames.body_frame, self._frames.world_frame)
        topics = [channel.topic for channel in self._channels]
        found = changes(table, self._due(until_ns), self._holding, self._timeout_ns, until_ns, topics, frames)
        self.skip(until_ns)
        return found

    def skip(self, until_ns: int) -> None:
        """Apply every change that is due by `until_ns`, without returning them."""
        table, rows = self._table, self._due(until_ns)
        for i, timeout in enumerate(self._timeout_ns):
            if table is not None and (mine := (table.channel[rows] == i).nonzero()[0]).size:
                row = rows.start + int(mine[-1])
                expires_ns = int(table.time_ns[row]) + timeout if timeout else None
                self._holds[i] = _Hold(table.held_wrench(row), table.received(row), expires_ns)
            if (expires_ns := self._holds[i].expires_ns) is not None and expires_ns <= until_ns:
                self._holds[i] = _Hold()
        self._row = rows.stop

    def _due(self, until_ns: int) -> slice:
        """Return the rows of the table that take effect by `until_ns` and have not done so yet."""
        if self._table is None:
            return slice(0, 0)
        return slice(self._row, int(self._table.time_ns.searchsorted(until_ns, side="right")))

    def _from_table(self, now_ns: int) -> None:
        """Queue the commands of the table that are due."""
        if self._table is None or self._row == len(self._table.time_ns) or self._table.time_ns[self._row] > now_ns:
            return
        table, rows = self._table, self._due(now_ns)
        for row in range(rows.start, rows.stop):
            command = CheckedWrench(int(table.channel[row]), table.received(row), table.held_wrench(row))
            self.take(command, int(table.time_ns[row]))
        self._row = rows.stop

    def outstanding(self) -> list[tuple[str, Wrench, int]]:
        """Return topic, command and time (ns) of each command that is held (0) or pending, in the order of effect."""
        topics = [channel.topic for channel in self._channels[: self._commanded]]
        held = [
            (topic, hold.received, 0)
            for topic, hold in zip(topics, self._holds, strict=False)
            if hold.received is not None
        ]
        waiting = [
            (topics[pending.channel], pending.command.received, pending.time_ns - self._waited(pending))
            for pending in sorted(self._queue)
            if pending.channel < self._commanded and pending.command.held is not None
        ]
        return held + waiting

    def _waited(self, pending: _Pending) -> int:
        """Return the delay (ns) between receipt and effect of a pending command."""
        return self._delay_ns[pending.channel] if pending.on_its_way else 0

    def standing(self, now_ns: int, orientation: Quaternion = IDENTITY) -> list[AppliedWrench]:
        """Return each held wrench as a change at `now_ns`, for the start of a log."""
        nothing = HeldWrench()
        acting = [i for i, hold in enumerate(self._holds) if hold.held != nothing or hold.transient is not None]
        changes = [self._applied(now_ns, i, orientation) for i in acting]
        return [replace(change, received=None) for change in changes]

    def schedule(self, effect: int, wrench: Wrench, time_ns: int) -> None:
        """Let `wrench` take effect on the channel of an effect, by its number: no command can reach it.

        Raises:
            WrenchError: a component is not finite, or the frame is unknown.
        """
        command = self._checked(self._commanded + effect, wrench)
        command.require()
        self.take(command, time_ns)

    def scheduled(self, now_ns: int) -> HeldWrench | None:
        """Return the wrench that effects hold from `now_ns` on, if none of them acts yet; None if there is none."""
        due = [p for p in sorted(self._queue) if p.channel >= self._commanded and p.time_ns <= now_ns]
        newest = {pending.channel: pending.command.held for pending in due}
        total = None
        for held in newest.values():
            if held is not None:
                total = held if total is None else total + held
        return total

    def _checked(self, channel: int, wrench: Wrench) -> CheckedWrench:
        try:
            held, clipped = self._hold(channel, wrench)
        except WrenchError as error:
            return CheckedWrench(channel, wrench, None, str(error))
        return CheckedWrench(channel, wrench, held, "", clipped)

    def _hold(self, channel: int, wrench: Wrench) -> tuple[HeldWrench, bool]:
        """Return the held wrench of a command, and whether the limits of its channel reduced it."""
        # First check that it is a wrench at all.
        held, limits = self._frames.hold(wrench), self._channels[channel]
        limited = limits.limited(wrench)
        if limited is not wrench:
            held = self._frames.hold(limited)
        if channel < self._commanded:
            force = max(map(abs, (*held.force_body, *held.force_world)))
            torque = max(map(abs, (*held.torque_body, *held.torque_world)))
            require_possible(force, torque, self._largest)
        return held, limited is not wrench

    def next_change_ns(self) -> int | None:
        """Return the next time at which the held wrench changes, by a command or a timeout; None if it never does."""
        times = [hold.expires_ns for hold in self._holds if hold.expires_ns is not None]
        if self.lag:
            times += [transient.end_ns for transient in self.transients()]
        if self._queue:
            times.append(self._queue[0].time_ns)
        if self._table is not None and self._row < len(self._table.time_ns):
            times.append(int(self._table.time_ns[self._row]))
        return min(times, default=None)

    def transients(self) -> list[Transient]:
        """Return the transients of channels that follow a change with a lag."""
        return [hold.transient for hold in self._holds if hold.transient is not None]

    def on_their_way(self, now_ns: int, orientation: Quaternion) -> list[AppliedWrench]:
        """Return the wrench at `now_ns` of each channel that still follows a change with a lag."""
        going = [
            i
            for i, hold in enumerate(self._holds)
            if hold.transient is not None and hold.transient.since_ns < now_ns < hold.transient.end_ns
        ]
        return [self._underway(now_ns, i, orientation) for i in going]

    def _underway(self, now_ns: int, channel: int, orientation: Quaternion) -> AppliedWrench:
        return replace(self._applied(now_ns, channel, orientation), received=None, on_its_way=True)

    def _lagging(self) -> list[int]:
        """Return the times (ns) at which channels with a lag change without a command."""
        holds = zip(self._channels, self._holds, strict=True)
        expiring = [hold.expires_ns for channel, hold in holds if channel.lag and hold.expires_ns is not None]
        return [*expiring, *(transient.end_ns for transient in self.transients())]

    def _follow(self, channel: int, hold: _Hold, now_ns: int) -> None:
        """Let a channel hold another wrench from now on; with a lag, starting from the present one."""
        lag = self._channels[channel].lag
        if lag:
            before = self._holds[channel].at(now_ns)
            hold = hold._replace(transient=Transient(before, hold.held, now_ns, lag) if before != hold.held else None)
        self._holds[channel] = hold

    def apply(
        self, now_ns: int, orientation: Quaternion = IDENTITY
    ) -> list[AppliedWrench | ReceivedWrench | RejectedWrench]:
        """Apply what is due at `now_ns`, up to the next command that is `huge`; return the changes, in order.

        A command exactly at the time of its channel's timeout takes precedence over it. `orientation` (principal to
        world) is needed for a wrench that changes with a lag from world to body axes.
        """
        self._from_table(now_ns)
        due: list[_Pending] = []
        self.came = []
        while self._queue and self._queue[0].time_ns <= now_ns:
            pending = heapq.heappop(self._queue)
            delay_ns = self._delay_ns[pending.channel]
            if not delay_ns or pending.on_its_way:
                due.append(pending)
                # It is tried before a later one of its time replaces it, as where they come one by one.
                if self._acceleration(pending) > HUGE:
                    break
                continue
            # In the order of arrival, rejected ones included.
            topic, (_, received, held, reason, _) = self._channels[pending.channel].topic, pending.command
            if held is None:
                self.came.append(RejectedWrench(now_ns, topic, received, reason))
                continue
            # They act in the order in which they are told, as in a replay: `hasten` may have changed that of arrival.
            self._number += 1
            later = pending._replace(time_ns=now_ns + delay_ns, number=self._number, on_its_way=True)
            heapq.heappush(self._queue, later)
            self.came.append(ReceivedWrench(now_ns, topic, received))
        told: list[AppliedWrench | ReceivedWrench | RejectedWrench] = [*self.came]
        self._done, self._before = due, self._holds.copy()
        still_due = [each for each in self._queue if each.time_ns <= now_ns] if self.is_due(now_ns) else []
        commanded = {
            each.channel
            for each in (*due, *still_due)
            if each.command.held is not None and (each.on_its_way or not self._delay_ns[each.channel])
        }
        for i, hold in enumerate(self._holds):
            if hold.transient is not None and hold.transient.end_ns <= now_ns:
                self._holds[i] = hold._replace(transient=None)
                told.append(self._underway(now_ns, i, orientation))
            if hold.expires_ns is not None and hold.expires_ns <= now_ns and i not in commanded:
                self._follow(i, _Hold(), now_ns)
                told.append(replace(self._applied(now_ns, i, orientation), timed_out=True))
        for _, channel, _, (_, received, held, reason, clipped), delayed in due:
            if held is None:
                told.append(RejectedWrench(now_ns, self._channels[channel].topic, received, reason, delayed))
                continue
            timeout = self._timeout_ns[channel]
            self._follow(channel, _Hold(held, received, now_ns + timeout if timeout else None), now_ns)
            told.append(self._applied(now_ns, channel, orientation, clipped, delayed))
        return told

    def is_due(self, now_ns: int) -> bool:
        """Return whether a command is left to `apply` at `now_ns`."""
        return bool(self._queue) and self._queue[0].time_ns <= now_ns

    @property
    def huge(self) -> bool:
        """Whether the last `apply` set a wrench larger than any actuator gives: then a step must be tried first."""
        return any(self._acceleration(pending) > HUGE for pending in self._done)

    def take_back(self, reason: str) -> RejectedWrench:
        """Undo the last `apply`; the next one rejects the largest of its commands for `reason`.

        Return that command.
        """
        largest = max(self._done, key=self._acceleration)
        self._holds = self._before
        for pending in self._done:
            refused = pending.command._replace(held=None, reason=reason) if pending is largest else pending.command
            heapq.heappush(self._queue, pending._replace(command=refused))
        return RejectedWrench(largest.time_ns, self._channels[largest.channel].topic, largest.command.received, reason)

    def _acceleration(self, pending: _Pending) -> float:
        """Return the largest number in the accelerations (m/s^2, rad/s^2) that a command gives; 0 for none."""
        held, body = pending.command.held, self._body
        if held is None or body is None or pending.channel >= self._commanded:
            return 0.0
        linear = max(map(abs, (*held.force_body, *held.force_world))) / body.mass
        if body.is_particle:
            return linear
        return max(linear, max(map(abs, (*held.torque_body, *held.torque_world))) / min(body.principal_moments))

    def total(self) -> HeldWrench:
        """Return the sum of the channels, always in the order of the scene, so that its bits do not vary.

        Channels that still follow a change are in `transients` instead.
        """
        total = HeldWrench()
        for hold in self._holds:
            total = total + hold.held if hold.transient is None else total
        return total

    def _applied(
        self,
        now_ns: int,
        channel: int,
        orientation: Quaternion = IDENTITY,
        clipped: bool = False,
        delayed: bool = False,
    ) -> AppliedWrench:
        held, received, _, _ = self._holds[channel]
        topic, frames = self._channels[channel].topic, self._frames
        if self._channels[channel].lag:
            acting = self._holds[channel].at(now_ns)
            world, force, torque = seen_in_one_frame(acting, orientation, self._body)
            frame = frames.world_frame if world else frames.body_frame
            return AppliedWrench(now_ns, topic, received, frame, force, torque, clipped, delayed)
        if received is not None and received.frame_id == frames.world_frame:
            force, torque = held.force_world, held.torque_world
            return AppliedWrench(now_ns, topic, received, frames.world_frame, force, torque, clipped, delayed)
        if received is None:
            return AppliedWrench(now_ns, topic, None, frames.body_frame, ZERO, ZERO)
        force, torque = held.force_body, held.torque_body
        return AppliedWrench(now_ns, topic, received, frames.body_frame, force, torque, clipped, delayed)
