"""Wrench channels: each holds its last command until the next one or its timeout; channels add up.

Knows when a command takes effect; what it does about the centre of mass is `loads/wrench.py`'s.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from rb_dynamics.errors import WrenchError
from rb_dynamics.loads.wrench import HeldWrench, Wrench, WrenchFrames
from rb_dynamics.numerics.vector import ZERO, Vector


@dataclass(frozen=True, slots=True)
class Channel:
    """One wrench channel of a scene.

    Attributes:
        topic: relative topic name.
        timeout: s after which the channel drops to zero; 0 holds for ever.
        optional: in lockstep, does not hold time back before it has spoken.
    """

    topic: str = "wrench"
    timeout: float = 0.0
    optional: bool = False


@dataclass(frozen=True, slots=True)
class AppliedWrench:
    """A channel's wrench changed.

    Attributes:
        time_ns: simulation time at which it took effect.
        topic: the channel's topic, as the scene writes it.
        received: the command as it came; None where a timeout dropped the channel to zero.
        frame_id: the axes of `force` and `torque`: body or world frame.
        force: N, through the centre of mass.
        torque: N m, about the centre of mass.
    """

    time_ns: int
    topic: str
    received: Wrench | None
    frame_id: str
    force: Vector
    torque: Vector


@dataclass(frozen=True, slots=True)
class RejectedWrench:
    """A command that was not honoured.

    Attributes:
        time_ns: simulation time at which it would have taken effect.
        topic: the channel's topic, as the scene writes it.
        received: the command as it came.
        reason: what was found, expected and to be done.
    """

    time_ns: int
    topic: str
    received: Wrench
    reason: str


@dataclass(slots=True)
class _Hold:
    held: HeldWrench = HeldWrench()
    expires_ns: int | None = None


class _Pending(NamedTuple):
    """A command that waits for its time.

    At equal times the channels come in the order of the scene, however the commands arrived; within a channel the order
    of arrival is kept, so the last one wins. No two have the same `number`: what stands behind it is never compared.
    `held` is None for a rejected command.
    """

    time_ns: int
    channel: int
    number: int
    wrench: Wrench
    held: HeldWrench | None
    reason: str = ""


class WrenchChannels:
    """The channels of one run, in the order of the scene."""

    def __init__(self, channels: Sequence[Channel], frames: WrenchFrames, effects: Sequence[str] = ()) -> None:
        """Start with every channel at zero; behind those of the scene comes one for each of `effects`."""
        self._channels = (*channels, *(Channel(name) for name in effects))
        self._commanded = len(channels)
        self._index = {c.topic.lstrip("/"): i for i, c in enumerate(channels)}
        # A timeout below 1 ns is short, not the 0 that holds for ever.
        self._timeout_ns = [max(1, round(c.timeout * 1e9)) if c.timeout else 0 for c in self._channels]
        self._frames = frames
        self._holds = [_Hold() for _ in self._channels]
        self._queue: list[_Pending] = []
        self._number = 0

    def post(self, topic: str, wrench: Wrench, time_ns: int) -> None:
        """Let `wrench` take effect on the channel `topic` at `time_ns`.

        Raises:
            WrenchError: no such channel, a component is not finite, or the frame is unknown. The command has no effect;
                on a channel of the scene it is reported as rejected when its time comes.
        """
        self._post(self._channel(topic), wrench, time_ns)

    def check(self, topic: str, wrench: Wrench) -> None:
        """Do nothing but refuse what `post` refuses."""
        self._channel(topic)
        self._frames.hold(wrench)

    def schedule(self, effect: int, wrench: Wrench, time_ns: int) -> None:
        """Let `wrench` take effect on the channel of an effect, by its number: no command can reach it.

        Raises:
            WrenchError: a component is not finite, or the frame is unknown.
        """
        self._post(self._commanded + effect, wrench, time_ns)

    def _channel(self, topic: str) -> int:
        channel = self._index.get(topic.lstrip("/"))
        if channel is None:
            raise WrenchError(f"wrench topic is {topic!r}, expected one of {sorted(self._index)} as in scene.wrenches")
        return channel

    def _post(self, channel: int, wrench: Wrench, time_ns: int) -> None:
        self._number += 1
        try:
            held = self._frames.hold(wrench)
        except WrenchError as error:
            heapq.heappush(self._queue, _Pending(time_ns, channel, self._number, wrench, None, str(error)))
            raise
        heapq.heappush(self._queue, _Pending(time_ns, channel, self._number, wrench, held))

    def next_change_ns(self) -> int | None:
        """Return when the held wrench changes next: a command or a timeout; None if it never does."""
        times = [hold.expires_ns for hold in self._holds if hold.expires_ns is not None]
        if self._queue:
            times.append(self._queue[0].time_ns)
        return min(times, default=None)

    def apply(self, now_ns: int) -> list[AppliedWrench | RejectedWrench]:
        """Make every change that is due at `now_ns` and return what changed, in order.

        A command that comes at the very time of its channel's timeout wins over it.
        """
        due: list[_Pending] = []
        while self._queue and self._queue[0].time_ns <= now_ns:
            due.append(heapq.heappop(self._queue))
        commanded = {pending.channel for pending in due if pending.held is not None}
        changes: list[AppliedWrench | RejectedWrench] = []
        for i, hold in enumerate(self._holds):
            if hold.expires_ns is not None and hold.expires_ns <= now_ns:
                hold.expires_ns = None
                if i not in commanded:
                    hold.held = HeldWrench()
                    changes.append(self._applied(now_ns, i, None))
        for pending in due:
            if pending.held is None:
                topic = self._channels[pending.channel].topic
                changes.append(RejectedWrench(now_ns, topic, pending.wrench, pending.reason))
                continue
            hold = self._holds[pending.channel]
            hold.held = pending.held
            timeout = self._timeout_ns[pending.channel]
            hold.expires_ns = now_ns + timeout if timeout else None
            changes.append(self._applied(now_ns, pending.channel, pending.wrench))
        return changes

    def total(self) -> HeldWrench:
        """Return the sum of the channels, always in the order of the scene, so that its bits do not vary."""
        total = HeldWrench()
        for hold in self._holds:
            total = total + hold.held
        return total

    def _applied(self, now_ns: int, channel: int, received: Wrench | None) -> AppliedWrench:
        held, frames = self._holds[channel].held, self._frames
        topic = self._channels[channel].topic
        if received is not None and received.frame_id == frames.world_frame:
            return AppliedWrench(now_ns, topic, received, frames.world_frame, held.force_world, held.torque_world)
        if received is None:
            return AppliedWrench(now_ns, topic, None, frames.body_frame, ZERO, ZERO)
        return AppliedWrench(now_ns, topic, received, frames.body_frame, held.force_body, held.torque_body)
