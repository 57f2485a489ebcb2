"""Warnings about a recorded run, in full sentences; they do not make a check fail."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rb_dynamics.analysis.checks import cut, missing
from rb_dynamics.analysis.clocks import remarks
from rb_dynamics.analysis.gaps import LONG_INTERVALS, LONG_S, gaps, listed
from rb_dynamics.analysis.track import Track, frame_names

# At least this many commands count as regular; with fewer, the last may be meant to be held.
_REGULAR = 5


@dataclass(frozen=True)
class ChannelHistory:
    """Commands on one wrench channel and their outcome; None if the log does not show it.

    Attributes:
        topic: as recorded, without "/applied".
        frames: every `frame_id` met.
        received: number of commands, rejected ones included.
        applied: changes of the applied wrench, without timeouts.
        timeouts: number of drops to zero.
        timed_out_s: time of the first, s as t in the output.
        rejected: number of rejected commands.
        undeclared: of those, how many are in each frame that the scene does not declare.
        late: number of commands that arrived after their stamp.
        superseded: number of commands that came after a newer one had taken effect; they are not in the log.
        lost: number of commands lost by the middleware.
        first_s: when the first command took effect, s as t in the output.
        last_s: the same of the last one.
        usual_s: median interval between commands, s.
        held_s: how long the last command was held until the end of the run; 0 if nothing acts then.
        largest_force: N.
        largest_torque: N m.
        silences: when commands of a steady stream stopped for a while, their last one not zero, and for how long, s.
    """

    topic: str
    frames: tuple[str, ...]
    received: int | None
    applied: int | None
    timeouts: int | None
    timed_out_s: float | None
    rejected: int | None
    undeclared: Mapping[str, int]
    late: int | None
    superseded: int | None
    lost: int | None
    first_s: float | None
    last_s: float | None
    usual_s: float | None
    held_s: float | None
    largest_force: float | None
    largest_torque: float | None
    silences: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class WorstStatus:
    """The last diagnostics status, and the worst level: 0 OK, 1 WARN, 2 ERROR, 3 STALE."""

    worst_level: int
    message: str
    values: tuple[tuple[str, str], ...]

    @property
    def level(self) -> str:
        """The worst level as a word."""
        return ("ok", "warning", "error", "stale")[min(self.worst_level, 3)]


def warnings(track: Track, channels: Sequence[ChannelHistory], health: WorstStatus | None) -> list[str]:
    """Return warnings about commands, time and health; empty for a regular run."""
    found = []
    if when := cut(track):
        found.append(f"The run was {when}: everything later is lost.")
    if pieces := missing(track):
        found.append(f"{pieces[0].upper()}{pieces[1:]}: what came and acted there is not known.")
    found += _commands(track, channels)
    holes = {each.topic: gaps(each.time_ns) for each in track.motion if not track.at_steps}
    found += [f"{topic} has {count} gap{'s' * (count > 1)}." for topic, count in holes.items() if count]
    found += remarks(track)
    if health is not None:
        values = dict(health.values)
        if values.get("overruns", "0") != "0" and not track.bag.begins_later:
            dropped = values.get("time dropped", "some time")
            found.append(f"The machine was too slow, or busy, {values['overruns']}×; {dropped} was dropped.")
        if health.worst_level > 0:
            found.append(f"The diagnostics came to level {health.level}.")
    return found


def _commands(track: Track, channels: Sequence[ChannelHistory]) -> list[str]:
    found = []
    for channel in channels:
        if channel.timeouts:
            least = "at least " if track.missing else ""
            first = "" if channel.timed_out_s is None else f", first at t = {channel.timed_out_s:.6g} s"
            found.append(f"{channel.topic} timed out {least}{channel.timeouts}×{first}.")
        if channel.silences and not channel.timeouts:
            when = listed([f"for {length:.6g} s from t = {at:.6g} s" for at, length in channel.silences], 0)
            found.append(
                f"{channel.topic} received no commands {when}, its last one held; otherwise they came every "
                f"{channel.usual_s:.3g} s."
            )
        if _fell_silent(channel):
            found.append(
                f"{channel.topic} received no more commands: the last one, at t = {channel.last_s:.6g} s, was held for "
                f"the remaining {channel.held_s:.6g} s; before, they came every {channel.usual_s:.3g} s."
            )
        frames, strange = frame_names(channel.undeclared), sum(channel.undeclared.values())
        some = "" if strange == channel.rejected else f"{strange} of them as "
        unknown = f" ({some}the scene declares no frame {frames})" if frames else ""
        for count, what in (
            (channel.rejected, f"rejected and had no effect{unknown}"),
            (channel.late, "late and took effect at once"),
            (channel.superseded, "superseded by a newer one, without effect and not in the log"),
            (channel.lost, "lost before they arrived"),
        ):
            if count:
                found.append(f"{channel.topic}: {count} command{'s' if count > 1 else ''} {what}.")
    return found


def _fell_silent(channel: ChannelHistory) -> bool:
    # Commands to a node that is paused come all at one time, at no rate.
    if not channel.usual_s or channel.held_s is None or (channel.received or 0) < _REGULAR:
        return False
    return channel.held_s > max(LONG_INTERVALS * channel.usual_s, LONG_S)
