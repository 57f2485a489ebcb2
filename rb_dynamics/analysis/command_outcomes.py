"""`outcomes_of`: outcome of the commands on one channel of our own log: applied, rejected or timed out.

It is derived only from the messages and the scene in the log, so it works offline and for a log that was cut off.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from rb_dynamics.analysis.gaps import gaps
from rb_dynamics.analysis.track import RecordedWrench, Track
from rb_dynamics.errors import WrenchError
from rb_dynamics.formats.topic_messages import Topic
from rb_dynamics.loads.wrench import Wrench, WrenchFrames
from rb_dynamics.loads.wrench_channels import Channel


@dataclass(frozen=True)
class CommandOutcomes:
    """Outcome of the commands on one channel; None if the log does not show it.

    Attributes:
        applied: number of commands that took effect.
        timeouts: drops to zero without a command, outside missing pieces.
        timed_out_ns: time of the first; None without any.
        rejected: number of rejected commands.
        undeclared: of those, how many are in each frame that the scene does not declare.
    """

    applied: int
    timeouts: int | None = None
    timed_out_ns: int | None = None
    rejected: int | None = None
    undeclared: Mapping[str, int] = field(default_factory=dict)


def outcomes_of(
    track: Track, steps: RecordedWrench, source: Topic, declared: WrenchFrames | None, channel: Channel
) -> CommandOutcomes:
    """Return the outcome of the commands on `source`; `steps` are the applied wrenches.

    Of a part of a log only what came or acted within it counts, not what is held from before.

    Args:
        track: the log.
        steps: applied wrenches of the channel.
        source: commands received on it.
        declared: frames of the scene; None if it cannot be read: then every command counts as accepted.
        channel: as in the scene.
    """
    delay_ns = channel.delay_ns
    begin_ns, last_ns = track.bag.window_ns or (-(2**63), 2**63 - 1)
    came = [(at + delay_ns, wrench) for at, wrench in (track.bag.wrenches(source.name) if source.count else [])]
    refused = [(at, wrench) for at, wrench in came if declared and not _honoured(declared, wrench, channel)]
    honoured = Counter(at for at, _ in came if at >= begin_ns) - Counter(at for at, _ in refused)
    refused = [(at, wrench) for at, wrench in refused if at - delay_ns >= begin_ns]
    acted = Counter(at for at in steps.time_ns.tolist() if at >= begin_ns)
    if delay_ns and track.pose is not None and len(track.pose.time_ns):
        # A command that was still delayed at the end has had no effect.
        end_ns = min(track.bag.cut_ns[1], last_ns) if track.bag.cut_ns else int(track.pose.time_ns[-1])
        honoured = Counter({at: number for at, number in honoured.items() if at <= end_ns})
    pieces = track.missing

    # The effect of a command is written after it, with the same time: if a log is cut off there, the effect is lost.
    last = (
        None
        if track.bag.complete
        else max((int(t.log_times.max()) for t in track.bag.topics.values() if t.count), default=0)
    )

    def known(times: Counter[int]) -> list[int]:
        return [at for at in sorted(times.elements()) if not any(begin <= at <= end for begin, end in pieces)]

    # Every applied wrench without a command is a timeout, by the format of the log. A command without one was larger
    # than any solver could follow.
    alone = acted - honoured
    # A scene that continues a run begins with what was held, and with commands that wait for their delay: no drops.
    acts = steps.force.any(axis=1) | steps.torque.any(axis=1)
    early = steps.time_ns <= (0 if channel.lag else delay_ns)
    alone -= Counter(steps.time_ns[acts & early].tolist()) - honoured
    alone -= _zeros_before(track, channel)
    drops = known(alone)
    too_large = [at for at in known(honoured - acted) if at != last and at - delay_ns >= begin_ns]
    return CommandOutcomes(
        applied=acted.total() - alone.total(),
        # With a lag there is no drop to see.
        timeouts=len(drops) if _known(track, drops) and not channel.lag else None,
        timed_out_ns=drops[0] if drops and not channel.lag else None,
        rejected=None if declared is None else len(refused) + len(too_large),
        undeclared=Counter(
            sorted(one.frame_id for _, one in refused if declared and not _honoured(declared, _nothing(one), channel))
        ),
    )


def _zeros_before(track: Track, channel: Channel) -> Counter[int]:
    """Return when (ns) zero commands act that came before the start of a scene which continues a run."""
    past = track.scene.past if track.scene is not None else None
    if past is None:
        return Counter()
    return Counter(
        at + channel.delay_ns - past.length_ns
        for topic, wrench, at in past.commands
        if topic == channel.topic and not any((*wrench.force, *wrench.torque))
    )


def _known(track: Track, drops: list[int]) -> bool:
    """Return whether `drops` are all there were, or at least some if a piece is missing."""
    if track.bag.complete:
        return True
    if track.missing:
        return bool(drops)
    return not any(gaps(series.time_ns) for series in track.motion)


def _honoured(declared: WrenchFrames, wrench: Wrench, channel: Channel) -> bool:
    try:
        declared.hold(wrench)
        channel.limited(wrench)
    except WrenchError:
        return False
    return True


def _nothing(wrench: Wrench) -> Wrench:
    return Wrench(frame_id=wrench.frame_id)
