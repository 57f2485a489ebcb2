"""Warnings about a recorded run, in whole sentences; none of them fails a check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rb_dynamics.analysis.checks import cut, missing
from rb_dynamics.analysis.clocks import remarks
from rb_dynamics.analysis.gaps import gaps
from rb_dynamics.analysis.track import Track, frame_names

# Commands that came this often came regularly; who sends fewer may mean the last one to stay.
_REGULAR = 5
# The last of regular commands is held long where it is held for more than this many usual gaps, and this many seconds.
_LONG_GAPS, _LONG_S = 10.0, 1.0


@dataclass(frozen=True)
class ChannelHistory:
    """What came on one wrench channel and what became of it; None where the log does not say.

    Attributes:
        topic: as recorded, without "/applied".
        frames: every `frame_id` met.
        received: commands that came, honoured or not.
        applied: changes of what acted, those at a timeout left out.
        timeouts: drops to zero.
        timed_out_s: when the first of them was, s from the start of the motion.
        rejected: commands that were not honoured.
        undeclared: every `frame_id` of theirs that the scene does not declare.
        late: commands whose time had passed when they came.
        lost: commands that the middleware lost.
        first_s: when the first command took effect, s from the start of the motion.
        last_s: the last one.
        usual_s: median of the times from one command to the next, s.
        held_s: how long what the last command set was still held at the end of the run; 0 where nothing acts then.
        largest_force: N.
        largest_torque: N m.
    """

    topic: str
    frames: tuple[str, ...]
    received: int | None
    applied: int | None
    timeouts: int | None
    timed_out_s: float | None
    rejected: int | None
    undeclared: tuple[str, ...]
    late: int | None
    lost: int | None
    first_s: float | None
    last_s: float | None
    usual_s: float | None
    held_s: float | None
    largest_force: float
    largest_torque: float


@dataclass(frozen=True)
class WorstStatus:
    """The last diagnostics status, and the worst level of all: 0 OK, 1 WARN, 2 ERROR, 3 STALE."""

    worst_level: int
    message: str
    values: tuple[tuple[str, str], ...]

    @property
    def level(self) -> str:
        """The worst level as a word."""
        return ("ok", "warning", "error", "stale")[min(self.worst_level, 3)]


def warnings(track: Track, channels: Sequence[ChannelHistory], health: WorstStatus | None) -> list[str]:
    """Return warnings about commands, time and health; none for a run in which all went as it should."""
    found = []
    if when := cut(track):
        found.append(f"The run was {when}: what came later is lost.")
    if pieces := missing(track):
        found.append(f"{pieces[0].upper()}{pieces[1:]}: what came and acted there is not known.")
    found += _commands(track, channels)
    for series in (track.pose, track.twist):
        if series is not None and (count := gaps(series.time_ns)):
            found.append(f"{series.topic} has {count} gap{'s' if count > 1 else ''}.")
    found += remarks(track)
    if health is not None:
        values = dict(health.values)
        if values.get("overruns", "0") != "0":
            dropped = values.get("time dropped", "some time")
            found.append(f"The machine was too slow {values['overruns']}×; {dropped} was dropped.")
        if health.worst_level > 0:
            found.append(f"The diagnostics came to level {health.level}.")
    return found


def _commands(track: Track, channels: Sequence[ChannelHistory]) -> list[str]:
    found = []
    for channel in channels:
        if channel.timeouts:
            least = "at least " if track.bag.missing else ""
            first = "" if channel.timed_out_s is None else f", first at t = {channel.timed_out_s:.6g} s"
            found.append(f"{channel.topic} timed out {least}{channel.timeouts}×{first}.")
        if _fell_silent(channel):
            found.append(
                f"{channel.topic} fell silent: its last command, at t = {channel.last_s:.6g} s, was held for the "
                f"remaining {channel.held_s:.6g} s; commands had come every {channel.usual_s:.3g} s."
            )
        frames = frame_names(channel.undeclared)
        unknown = f" (the scene declares no frame {frames})" if frames else ""
        for count, what in (
            (channel.rejected, f"rejected and had no effect{unknown}"),
            (channel.late, "late and took effect at once"),
            (channel.lost, "lost before they arrived"),
        ):
            if count:
                found.append(f"{channel.topic}: {count} command{'s' if count > 1 else ''} {what}.")
    return found


def _fell_silent(channel: ChannelHistory) -> bool:
    if channel.usual_s is None or channel.held_s is None or (channel.received or 0) < _REGULAR:
        return False
    return channel.held_s > max(_LONG_GAPS * channel.usual_s, _LONG_S)
