"""`RecordedWrenches`: the wrench commands of one or several bags, for the channels of a scene and in the time of a run.

Commands are read as the run needs them and not kept. `Start` says which time of the bags is time 0 of the run.
"""

from __future__ import annotations

import logging
import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.errors import LogError, WrenchError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import Source, open_source
from rb_dynamics.formats.log_metadata import INTERRUPTED, MISSING_FILES, RUN, in_simulation_time, next_file, part_ns
from rb_dynamics.formats.mcap_records import McapChannel, MessageBlock
from rb_dynamics.formats.message_types import COMMAND, SCALAR, WRENCH
from rb_dynamics.formats.topic_messages import KEPT, Times, Topic
from rb_dynamics.loads.actuator import Actuator, Setpoint
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.loads.wrench_channels import WrenchChannels
from rb_dynamics.loads.wrench_command_arrays import CommandBatch
from rb_dynamics.logs import unset_stamps
from rb_dynamics.logs.bag_reader import IMUS, POSES, TWISTS, WRENCHES, named_type
from rb_dynamics.logs.messages import APPLIED, decode_setpoint, is_state_change
from rb_dynamics.logs.recorded_commands import commands_of
from rb_dynamics.logs.stamp_clock import APART_NS, ClockLine, StampClock, in_bursts
from rb_dynamics.logs.stamp_order import BACK_NS, disorder
from rb_dynamics.logs.stray_stamps import Strays, StrayStamps
from rb_dynamics.logs.topics_of_channels import names_in_scene
from rb_dynamics.logs.unset_stamps import ALWAYS, FAR_NS, Unset, UnsetStamps

_logger = logging.getLogger(__name__)

Start: TypeAlias = Literal["auto", "bag", "first", "stamp"] | int
"""Which time is time 0 of the run.

stamp: 0 of the stamps. first: the first command. bag: the first message of any topic, or the first command where that
is stamped up to 1 s earlier, for it takes time to be recorded (not of a part, whose first may be held from before), or
the first stamp of commands and motion where log times do not follow the stamps, as over a link that stalls. Log times
that are of another clock than the stamps are moved to theirs. An integer: that stamp, ns. auto: as with stamp for each
bag of which some commands lie within the run so, as with bag for the others, unless they begin less than 1e6 s after a
run that some bag reaches: these are later in the same time. Several bags are of one time: the earliest of their starts
is that of all. Except with stamp, commands of a bag without any stamp, and of a log of ours, which says when each took
effect, go by their log times. Commands to actuators, and Wrench, have no stamps and always do. These log times are put
on the clock of the stamps of the motion beside them.
"""

_NANOSECONDS = 1_000_000_000
_LATENCY_NS = _NANOSECONDS
# Every command is recorded later than its stamp by more than APART_NS, or before it, only if these are of two clocks;
# then the mean is about the same, of which a link that delivers in bursts leaves more than this part of it.
_UNEVEN = 0.25
# Of a file written in order, few log times are before the one above: those where the clock begins again.
_SORTED = 0.05

FEW = 1000
"""Number of commands on a channel that tell how often it is commanded."""
# Commands that begin later than this after the end of the run are of another clock than those within it.
_ONE_CLOCK_NS = FAR_NS


def read_wrenches(
    path: str | os.PathLike[str], topics: Sequence[str], mapping: Mapping[str, str] | None = None
) -> list[tuple[str, Wrench]]:
    """Return all of `RecordedWrenches` of one bag, at their stamps.

    Args:
        path: a bag, see `open_source`.
        topics: names of the scene's channels.
        mapping: the channel that each topic of the bag drives, where their names differ.

    Raises:
        LogError: the bag cannot be read or is damaged, `mapping` names what is not there, or none of its wrench topics
            is one of `topics`.
    """
    return list(RecordedWrenches([path], topics, mapping=mapping))


@dataclass
class _Span:
    """Times (ns) of the commands in a bag by one clock; a command may come up to `delay_ns` after a later one."""

    first_ns: int | None = None
    last_ns: int | None = None
    delay_ns: int = 0

    def __str__(self) -> str:
        """Return the first and the last time."""
        return f"at {_seconds(self.first_ns or 0)} to {_seconds(self.last_ns or 0)} s"

    def by(self, line: ClockLine) -> _Span:
        """Return this by the clock of stamps."""
        if self.first_ns is None or self.last_ns is None:
            return self
        last_ns = line.stamp(self.last_ns)
        # Rounding adds less than 1 ns.
        delay_ns = self.delay_ns and last_ns - line.stamp(self.last_ns - self.delay_ns) + 1
        return _Span(line.stamp(self.first_ns), last_ns, delay_ns)

    def add(self, times_ns: Times) -> None:
        """Count times, in the order in which they were recorded on one topic."""
        newest = np.maximum.accumulate(times_ns)
        if self.last_ns is not None:
            newest = np.maximum(newest, self.last_ns)
        self.first_ns, self.last_ns = _first(self.first_ns, int(times_ns.min())), int(newest[-1])
        self.delay_ns = max(self.delay_ns, int((newest - times_ns).max()))


@dataclass
class _Recording:
    """What is known about one bag.

    Attributes:
        path: of the bag.
        by_log: commands go by their log times.
        offset_ns: of time 0 of the run, by the clock that counts.
        found: commands on each of its wrench topics.
        count: commands for channels of the scene.
        begin_ns: the earliest log time of any message, but of what a part has from before.
        part: whether it is a part of a recording.
        behind_ns: how far its commands are recorded behind their stamps, at least; None without any.
        sum_ns: that of each of them, summed.
        stamped: how many these are.
        unset_ns: the same as `behind_ns`, of those whose stamp is 0; None without any.
        lags: how far the stamps of the commands on each topic are from their log times.
        strays: the topics of which a few commands go by their log times, as they are stamped far from these.
        zeros: which commands on each topic have a stamp of 0.
        fills: topics of which commands without a stamp go by their log times, put on the clock of the others, and the
            log time after which a stamp of 0 is none.
        still: commands that have the stamp of an earlier one on their channel: of these only the last acts. At first
            only those that have the stamp of the one before.
        ascends: whether each stamp on a topic is after all before it.
        reached: the latest stamp on each topic.
        back_ns: how far stamps of one topic go back, from one command to the next.
        newest: the last stamp on each of its channels.
        earliest: the two earliest times by stamps on each of its channels.
        moves_ns: the first stamp of its motion; None without any.
        clocks: log times and stamps of its motion, by topic; of other messages only where there is no motion.
        beside: the same of another bag, for one without any stamp.
        known: how its log times follow the stamps, where that was found before.
        bare: how many commands are of a type without stamps.
        bare_times: log times of commands without stamps, of either kind, by topic.
        within: commands between start and end of the run.
        early: commands before its start, on each channel: the last acts from the start on, unless another is there.
        expired: commands whose timeout ends before the start, on each channel.
        prompt: channels that have a command at the start.
        first: times in the run of the first commands on each channel, `FEW` or more.
        acting: those within that can be honoured.
        refused: why the first that cannot be honoured cannot.
        lost: what is missing of the bag; "" if it is whole.
        ours: a log of a run, or made of such logs: log times say when commands took effect.
        origin: of such a log, the bags that its own commands came from: name and time 0 of each.
        driven: of such a log, the channel that each topic of those drove.
        moves: states in it to which the body was moved from outside.
        drives: topics of commands to the scene's actuators.
        drives_nothing: topics that look like such commands, but are those of no actuator.
        missed: log times of the commands on those of them that are not mapped away from an actuator, by topic.
        unused: topics of other wrenches, and of the scene's actuators with another type, each with its type.
    """

    path: Path
    by_log: bool = False
    offset_ns: int = 0
    found: Counter[str] = field(default_factory=Counter)
    count: int = 0
    begin_ns: int | None = None
    part: bool = False
    behind_ns: int | None = None
    sum_ns: float = 0.0
    stamped: int = 0
    unset_ns: int | None = None
    lags: dict[str, StrayStamps] = field(default_factory=dict)
    strays: Mapping[str, Strays] = field(default_factory=dict)
    zeros: dict[str, UnsetStamps] = field(default_factory=dict)
    fills: Mapping[str, Unset] = field(default_factory=dict)
    still: int = 0
    ascends: bool = True
    reached: dict[str, int] = field(default_factory=dict)
    back_ns: int = 0
    newest: dict[int, int] = field(default_factory=dict)
    earliest: dict[int, list[int]] = field(default_factory=dict)
    moves_ns: int | None = None
    clocks: dict[tuple[bool, str], StampClock] = field(default_factory=dict)
    beside: ClockLine | None = None
    known: ClockLine | None = None
    bare: int = 0
    bare_times: dict[str, list[Times]] = field(default_factory=dict)
    within: int = 0
    early: Counter[int] = field(default_factory=Counter)
    expired: Counter[int] = field(default_factory=Counter)
    prompt: set[int] = field(default_factory=set)
    first: dict[int, list[int]] = field(default_factory=dict)
    acting: int = 0
    refused: str = ""
    lost: str = ""
    ours: bool = False
    origin: list[tuple[str, int]] = field(default_factory=list)
    driven: dict[str, str] = field(default_factory=dict)
    moves: int = 0
    drives: set[str] = field(default_factory=set)
    drives_nothing: set[str] = field(default_factory=set)
    missed: dict[str, list[Times]] = field(default_factory=dict)
    unused: dict[str, str] = field(default_factory=dict)
    stamps: _Span = field(default_factory=_Span)
    log_times: _Span = field(default_factory=_Span)
    setpoints: _Span = field(default_factory=_Span)

    @property
    def span(self) -> _Span:
        """The commands by the clock that counts: wrenches, or if there are none, commands to actuators."""
        if not self.count:
            return self.setpoints.by(self.line)
        return self.log_times.by(self.line) if self.by_log else self.stamps

    @property
    def first_ns(self) -> int | None:
        """The first command of either kind."""
        return _first(self.span.first_ns, self.setpoints.by(self.line).first_ns)

    @property
    def line(self) -> ClockLine:
        """How its log times follow the stamps of its motion, or of what else has some."""
        if self.known is not None or self.ours:
            return self.known or ClockLine()
        line = self._of_others
        if not self.count or self.by_log:
            return self._unless_one(line or self.beside or ClockLine())
        # Of commands that come in bursts, no delay is as little as those of a motion that comes steadily.
        if line is not None and self.behind_ns is not None and line.bounded and line.count > 1:
            ends = np.array([self.log_times.first_ns, self.log_times.last_ns])
            more_ns = self.behind_ns - int(line.behind(ends).min())
            uneven_ns = 2 * (self.sum_ns / self.stamped - self.behind_ns)
            if -APART_NS * bool(line.drift) <= more_ns <= max(APART_NS, uneven_ns):
                return self._unless_one(line)
        found = () if self.uneven else (self.behind_ns, None if self.partly_unset else self.unset_ns)
        return self._unless_one(ClockLine(behind_ns=_first(*found) or 0))

    @property
    def _of_others(self) -> ClockLine | None:
        """How its log times follow the stamps of its motion, or of what else has some; None without any."""
        of_motion = max((motion for motion, _ in self.clocks), default=False)
        lines = [clock.line for (motion, _), clock in self.clocks.items() if motion == of_motion]
        return min(lines, key=lambda each: abs(each.behind_ns), default=None)

    @staticmethod
    def _unless_one(line: ClockLine) -> ClockLine:
        return replace(line, behind_ns=0) if line.one_clock else line

    @property
    def apart_ns(self) -> int:
        """By how much its first log time is later than the stamps, if these are of two clocks."""
        return (self.begin_ns or 0) - self.line.stamp(self.begin_ns or 0)

    @property
    def times_unstamped(self) -> bool:
        """Whether the clock of the log times matters to its commands."""
        return not self.ours and (self.setpoints.first_ns is not None or self.by_log or bool(self.fills))

    @property
    def stray(self) -> dict[str, Strays]:
        """The `strays` that its commands need."""
        found = {} if self.ours else {name: each.found for name, each in self.lags.items()}
        return {name: strays for name, strays in found.items() if strays is not None}

    @property
    def partly_unset(self) -> dict[str, Unset]:
        """The `fills` that its commands need: some have a stamp, and some a stamp of 0 only because nobody set it."""
        if self.ours or self.behind_ns is None or self.unset_ns is None:
            return {}
        far = abs(self.unset_ns - self.behind_ns) > _ONE_CLOCK_NS
        found = {name: Unset(ALWAYS, each.delay_ns) if far else each.found for name, each in self.zeros.items()}
        return {name: each for name, each in found.items() if each is not None}

    @property
    def start_ns(self) -> int:
        """Where it begins, see `Start`."""
        first_ns, begin_ns = self.span.first_ns or 0, (self.begin_ns or 0) - self.apart_ns
        if self.stalls:
            moves_ns = first_ns if self.moves_ns is None else self.moves_ns
            return min(first_ns, moves_ns) if abs(moves_ns - first_ns) < _ONE_CLOCK_NS else first_ns
        # Of a part, the first command may be one that is held from before.
        return first_ns if not self.part and begin_ns - _LATENCY_NS <= first_ns < begin_ns else begin_ns

    @property
    def stalls(self) -> bool:
        """Whether log times do not follow the stamps, or two commands of one channel are stamped before the bag."""
        begin_ns, stamps = (self.begin_ns or 0) - self.apart_ns, self.earliest.values()
        before = any(first[0] < begin_ns - _LATENCY_NS and first[-1] < begin_ns for first in stamps if len(first) > 1)
        return not (self.by_log or self.stands) and (before or (self.uneven and abs(self.behind_ns or 0) > APART_NS))

    @property
    def uneven(self) -> bool:
        """Whether the log times are no constant time behind the stamps."""
        behind_ns = self.behind_ns or 0
        return self.sum_ns - behind_ns * self.stamped > _UNEVEN * abs(behind_ns) * self.stamped

    def take(self, block: MessageBlock, kind: str) -> None:
        """Take messages that are no wrenches."""
        log_times, stamps = _stamped(block, kind)
        if len(stamps):
            self.clocks.setdefault((kind in KEPT, block.channel.topic), StampClock()).add(log_times, stamps)
            if kind in KEPT:
                self.moves_ns = _first(self.moves_ns, int(stamps.min()))

    def take_metadata(self, source: Source) -> None:
        """Take what a bag that has been read to its end says of itself."""
        absent = source.metadata.get(INTERRUPTED, {}).get(MISSING_FILES) or next_file(source.metadata)
        self.lost = "was cut off" if not source.complete else f"is without {absent}" if absent else ""
        # What is held from before is older than the part.
        if (part := part_ns(source.metadata)) is not None:
            self.begin_ns, self.part = part[0], True
        self.ours = in_simulation_time(source.metadata)
        self.origin = list(origin_of(source.metadata).items())
        self.driven = driven_of(source.metadata)

    def goes_on(self, of: McapChannel, batch: _Batch) -> None:
        """Take the times of further commands of a channel."""
        channel, stamps_ns, bare = id(of), batch.stamps, batch.log_times
        if named_type(of) == WRENCH:
            self.lags.setdefault(of.topic, StrayStamps()).add(batch.log_times, stamps_ns)
            self.zeros.setdefault(of.topic, UnsetStamps()).add(batch.log_times, stamps_ns)
            bare = bare[batch.unset]
        else:
            self.bare += len(bare)
        self.bare_times.setdefault(of.topic, []).append(bare)
        changes = np.diff(np.append(self.newest.get(channel, stamps_ns[0] - 1), stamps_ns))
        self.still += int((changes == 0).sum())
        self.back_ns = max(self.back_ns, int(-changes.min()))
        self.newest[channel] = int(stamps_ns[-1])
        reached_ns = self.reached.get(of.topic, int(stamps_ns[0]) - 1)
        self.ascends = self.ascends and int(stamps_ns.min()) > reached_ns and int(changes.min()) > 0
        self.reached[of.topic] = max(reached_ns, int(stamps_ns.max()))
        self.earliest[channel] = sorted([*self.earliest.get(channel, []), *np.sort(stamps_ns)[:2].tolist()])[:2]

    @property
    def stands(self) -> bool:
        """Whether most of its stamps are those of another command of their channel."""
        return 2 * self.still > self.count

    @property
    def unstamped(self) -> bool:
        """Whether stamps do not show the time although log times do; of one command, beside other stamps."""
        first_ns, last_ns, line = self.log_times.first_ns, self.log_times.last_ns, self._of_others
        if first_ns is None or not self.stamps.first_ns == self.stamps.last_ns == 0:
            return False
        return first_ns != last_ns or (line is not None and abs(line.stamp(first_ns)) > APART_NS)

    def reaches(self, end_ns: float, margin_ns: int = 0) -> bool:
        """Whether commands lie from 0 to before `end_ns` of their clock, or `margin_ns` later; or there are none."""
        first_ns, last_ns = self.span.first_ns or 0, self.span.last_ns or 0
        return first_ns < end_ns + margin_ns and last_ns >= 0


class RecordedWrenches:
    """The commands in bags for the wrench channels of a scene, by time; equal times in the order of the bags.

    A command's stamp is its time in the run. Read anew each time they are gone through, never kept: a bag of any length
    takes little memory. One that is written in the order of its stamps takes least; a command that comes late is waited
    for.

    Attributes:
        first_ns: the earliest time; None if there is no command.
        late: how many lie after `end_ns`.
        superseded: how many lie before time 0 and do not act, as another of their channel follows by then.
        early: channels of which a command before time 0 may still act then.
        prolonged: those with a timeout, and without a command at time 0.
        two_clocks: whether a bag with commands within the run has others of another clock.
        notes: what a person should know of how the bags were read, one line each.
        facts: which bags, which time of each is time 0 of the run, and the channel that each topic drives whose name is
            another: for the metadata of a log. Where a bag is a log, those that its commands came from follow.
    """

    def __init__(
        self,
        paths: Sequence[str | os.PathLike[str]],
        topics: Sequence[str],
        end_ns: float = math.inf,
        mapping: Mapping[str, str] | None = None,
        start: Start = "stamp",
        channels: WrenchChannels | None = None,
        actuators: Sequence[Actuator] = (),
    ) -> None:
        """Search the bags for the commands on `topics`, by the rule of `names_in_scene`.

        A Wrench without header has its log time as stamp and frame "".

        Args:
            paths: bags, see `open_source`.
            topics: names of the scene's channels.
            end_ns: of the run.
            mapping: the channel or actuator that each topic of the bags drives, where their names differ.
            start: which time of the bags is time 0 of the run.
            channels: say which commands cannot be honoured.
            actuators: of the scene; their commands are of type Float64.

        Raises:
            LogError: a bag cannot be read or is damaged or has commands of several runs, `mapping` names what is not
                there, or none of a bag's topics is one of `topics` or `actuators`.
        """
        self._topics, self._commanded = topics, {each.topic: each for each in actuators}
        self._take(mapping or {})
        self._end_ns, self._channels = end_ns, channels
        self._bags = [self._looked_through(_Recording(Path(path))) for path in paths]
        in_namespace = self._in_namespace()
        if in_namespace:
            self._take({**self._mapping, **in_namespace})
            self._bags = [self._looked_through(bag) for bag in self._bags]
        self._bags = [
            self._looked_through(replace(bag, strays=stray)) if (stray := bag.stray) else bag for bag in self._bags
        ]
        self._bags = [
            self._looked_through(replace(bag, fills=found)) if (found := bag.partly_unset) else bag
            for bag in self._bags
        ]
        self._require_topics()
        for bag in self._bags:
            bag.by_log = bag.bare == bag.count > 0
            beside = [each for each in self._bags if each.count and _pause_ns(bag, each) < _ONE_CLOCK_NS]
            if beside and not bag.count:
                bag.beside = min(beside, key=lambda each: _pause_ns(bag, each)).line
        self.notes: list[str] = [unset_stamps.told(bag.path) for bag in self._bags if bag.fills]
        self.notes += (each.told(bag.path, topic) for bag in self._bags for topic, each in bag.strays.items())
        self.notes += (f"{topic} is taken for {name} of the scene" for topic, name in in_namespace.items())
        if start != "stamp":
            self._begin(start)
        else:
            self.notes += (
                f"{bag.path}: its commands have no stamps, so all of them ({bag.count}) act at time 0; --wrench-start "
                "bag lets each act at its log time"
                for bag in self._bags
                if bag.unstamped
            )
        self._bags = [
            self._looked_through(bag) if bag.by_log or bag.offset_ns or bag.beside else bag for bag in self._bags
        ]
        self.notes += self._out_of_order()
        self.notes += self._of_one_time()
        self.notes += filter(None, map(_clock_note, self._bags))
        self.notes += (
            f"{bag.path}: {told}; each acts at its log time"
            for bag in self._bags
            if bag.times_unstamped
            for topic, blocks in bag.bare_times.items()
            if (told := in_bursts(topic, np.concatenate(blocks)))
        )
        spans = [(bag, bag.span.first_ns) for bag in self._bags]
        self.first_ns = min((first - bag.offset_ns for bag, first in spans if first is not None), default=None)
        self.late = sum(bag.count - bag.within - bag.early.total() - bag.expired.total() for bag in self._bags)
        early, expired, prompt = Counter[int](), Counter[int](), set[int]().union(*(bag.prompt for bag in self._bags))
        for bag in self._bags:
            early.update(bag.early)
            expired.update(bag.expired)
        self.notes += (
            f"{topics[channel]}: {count} commands before time 0 never act, as their timeout ends before it"
            for channel, count in sorted(expired.items())
        )
        self.early = [topics[channel] for channel in sorted(early)]
        self.prolonged = [
            topics[channel]
            for channel in sorted({*early} - prompt)
            if channels is not None and channels.life_ns(channel) < math.inf
        ]
        self.superseded = sum(count - (channel not in prompt) for channel, count in early.items())
        came = [(bag.path.name, bag.offset_ns) for bag in self._bags]
        came += [(name, start_ns + bag.offset_ns) for bag in self._bags for name, start_ns in bag.origin]
        ends = [bag.span.last_ns - bag.offset_ns for bag in self._bags if bag.within and bag.span.last_ns is not None]
        self.two_clocks = max(ends, default=0) - end_ns > _ONE_CLOCK_NS
        self.facts = {
            "wrench_bags": ", ".join(name for name, _ in came),
            "wrench_start_ns": ", ".join(str(start_ns) for _, start_ns in came),
        }
        driven = {key: value for bag in self._bags for key, value in bag.driven.items()} | dict(self._mapping)
        if driven:
            self.facts["wrench_topics"] = ", ".join(f"{topic}={channel}" for topic, channel in driven.items())
        self.notes += (
            f"{bag.path}: {bag.moves} states to which the body was moved (set_state) are left out: only replay has them"
            for bag in self._bags
            if bag.ours and bag.moves
        )
        self.notes += (
            f"{bag.path}: {_drive_nothing(bag, [*self._commanded])}"
            for bag in self._bags
            if actuators and bag.drives_nothing
        )
        self.notes += (
            f"{bag.path}: no channel or actuator of the scene takes {_several(bag.unused)}; map with --topic "
            "TOPIC=CHANNEL; actuators take Float64"
            for bag in self._bags
            if bag.unused
        )
        if late := self._late_setpoints():
            self.notes.append(
                f"{late} of {len(self.setpoints)} commands to actuators lie after the end of the run at "
                f"{_seconds(int(self._end_ns))} s and have no effect"
            )
        for bag in self._bags:
            if bag.lost:
                _logger.warning("%s %s; the %d commands in it are used", bag.path, bag.lost, bag.count)

    def _take(self, mapping: Mapping[str, str]) -> None:
        """Let topics drive the channels and actuators of their names, and those of `mapping` what it says."""
        self._mapping = mapping
        known = _wanted((*self._topics, *self._commanded), mapping)
        self._actuators = {name: topic for name, topic in known.items() if topic in self._commanded}
        self._wanted = {name: topic for name, topic in known.items() if topic in self._topics}

    def _in_namespace(self) -> dict[str, str]:
        """Return what topics drive that have the name of a channel or actuator, but in a namespace."""
        found = sum((bag.found for bag in self._bags), Counter[str]())
        wrenches = [*found] or [name for bag in self._bags for name in bag.found]
        scalars = {name for bag in self._bags for name in (*bag.drives, *bag.drives_nothing)}
        known = names_in_scene(wrenches, self._topics, self._mapping)
        known |= names_in_scene(scalars, self._commanded, self._mapping)
        taken = {name.removeprefix("/") for name in (*self._wanted, *self._actuators)}
        return {topic: name for topic, name in known.items() if topic.removeprefix("/") not in taken}

    def require_some(self, continues: bool = False) -> None:
        """Refuse a bag that has commands, but none that takes effect.

        Between two commands, the first of them is held; after the last, a run is taken for another's. So is a bag
        without commands, unless it is a whole log of a run without any, or another bag has some. A scene that
        `continues` a run has the commands before time 0 itself, and the run may have had none since; in its log, those
        since may all have been rejected or have come at its end.

        Raises:
            LogError: gives the times of its commands, and why.
        """
        for bag in self._bags:
            if not (bag.count or self.setpoints) and (bag.lost or not (bag.ours or any(b.count for b in self._bags))):
                found = f"{bag.path} {bag.lost}: no command is left in it" if bag.lost else f"{bag.path} has no command"
                raise LogError(
                    f"{found}, expected at least one; give a bag with some, or leave out --wrench to let the body coast"
                )
            if continues and (bag.early or bag.expired or bag.ours):
                continue
            if bag.count and not bag.acting and not (0 < bag.early.total() < bag.count and not bag.refused):
                raise LogError(self._no_effect(bag))
        if self.setpoints and self._late_setpoints() == len(self.setpoints) and not any(b.acting for b in self._bags):
            raise LogError(
                f"{', '.join(str(bag.path) for bag in self._bags)}: none of its {len(self.setpoints)} commands to "
                f"actuators acts: the run {self._run()}; let the run begin at a time of the bag by --wrench-start "
                "SECONDS, or make it longer with --duration"
            )

    @property
    def superseded_words(self) -> str:
        """How many commands are superseded before time 0, and what to do if most are."""
        told = f"{self.superseded} of {len(self)} commands lie before time 0 and never act: later ones supersede them"
        if 2 * self.superseded <= len(self):
            return told
        return f"{told}; let the run begin with the first by --wrench-start first, or at another time of the bag"

    def _late_setpoints(self) -> int:
        return sum(command.stamp_ns > self._end_ns for _, command in self.setpoints)

    def __len__(self) -> int:
        """Return how many there are, those in `to_absent` too."""
        return sum(bag.count for bag in self._bags) + len(self.setpoints) + sum(map(len, self.to_absent.values()))

    @property
    def first_stamps(self) -> list[tuple[str, int]]:
        """Topic, as the scene writes it, and stamp (ns) of the first `FEW` or more commands on each channel."""
        return [(self._topics[k], at) for bag in self._bags for k, first in bag.first.items() for at in first]

    def __iter__(self) -> Iterator[tuple[str, Wrench]]:
        """Yield topic, as the scene writes it, and command."""
        for batch, _ in self.batches():
            for row, channel in enumerate(batch.channel.tolist()):
                yield self._topics[channel], batch.received(row)

    @cached_property
    def setpoints(self) -> list[tuple[str, Setpoint]]:
        """Commands to actuators, each at the time at which it was recorded: they have no stamps."""
        found: list[tuple[str, Setpoint]] = []
        for bag in self._bags:
            for message in open_source(bag.path).messages() if bag.drives else ():
                if (topic := self._drives(message.channel)) is not None:
                    value, at_ns = decode_setpoint(message.data), bag.line.stamp(message.log_time) - bag.offset_ns
                    value = self._commanded[topic].rest(value, -at_ns / 1e9) if at_ns < 0 else value
                    found.append((topic, Setpoint(value, at_ns)))
        return found

    @cached_property
    def to_absent(self) -> dict[str, Times]:
        """When commands to actuators come that the scene does not have, by topic: they are rejected."""
        found: dict[str, list[Times]] = {}
        for bag in self._bags:
            for topic, blocks in bag.missed.items():
                found.setdefault(topic, []).append(bag.line.stamps(np.concatenate(blocks)) - bag.offset_ns)
        return {topic: np.concatenate(times) for topic, times in found.items()}

    def _drives(self, channel: McapChannel) -> str | None:
        """Return the topic of an actuator, as the scene writes it, that the messages of a channel command."""
        return self._actuators.get(channel.topic.removeprefix("/")) if named_type(channel) == SCALAR else None

    def batches(self) -> Iterator[tuple[CommandBatch, int | None]]:
        """Yield commands in the order in which they take effect, and the time (ns) before which all have come.

        The last time is None: no more come.
        """
        waiting: list[CommandBatch] = []
        sources = [self._in_blocks(number, bag) for number, bag in enumerate(self._bags)]
        reached = dict.fromkeys(range(len(sources)), -math.inf)
        while reached:
            # From the bag that has been read least far.
            number = min(reached, key=lambda k: reached[k])
            found = next(sources[number], None)
            if found is None:
                del reached[number]
            else:
                waiting.append(found[0])
                reached[number] = found[1]
            until_ns = min(reached.values(), default=None)
            if waiting and (until_ns is None or until_ns > -math.inf):
                batch = CommandBatch.of(waiting)
                last = len(batch.time_ns) if until_ns is None else int(batch.time_ns.searchsorted(until_ns))
                waiting = [batch.some(slice(last, None))] if last < len(batch.time_ns) else []
                yield batch.some(slice(last)), None if until_ns is None else int(until_ns)

    def _looked_through(self, bag: _Recording) -> _Recording:
        """Fill in what is needed about a bag, with its commands timed as known by now.

        Raises:
            LogError: it cannot be read or is damaged.
        """
        known = bag.line if bag.by_log or bag.fills or bag.offset_ns or bag.beside else None
        bag = _Recording(bag.path, bag.by_log, bag.offset_ns, strays=bag.strays, fills=bag.fills, known=known)
        source = open_source(bag.path)
        for block in source.blocks():
            bag.begin_ns = _first(bag.begin_ns, int(block.log_times.min()))
            kind, name = named_type(block.channel), block.channel.topic
            if is_state_change(name, kind):
                bag.moves += len(block.log_times)
            if kind == SCALAR:
                self._count_setpoints(bag, block)
            if kind not in WRENCHES:
                bag.take(block, kind)
            if kind in WRENCHES:
                bag.found[name] += len(block.log_times)
                if (topic := self._wanted.get(name.removeprefix("/"))) is not None:
                    batch = _batch(source, bag, block, kind, self._topics.index(topic))
                    self._count(bag, batch)
                    bag.goes_on(block.channel, batch)
        for channel in source.channels.values():
            name, kind = channel.topic.removeprefix("/"), named_type(channel)
            wrench = kind in WRENCHES and name not in self._wanted and not name.endswith(APPLIED)
            if RUN not in source.metadata and (wrench or (name in self._actuators and kind != SCALAR)):
                bag.unused[channel.topic] = kind
            if named_type(channel) in WRENCHES:
                bag.found[channel.topic] += 0
            if self._drives(channel) is not None:
                bag.drives.add(channel.topic)
            elif kind == SCALAR and (name.endswith(COMMAND) or name + COMMAND in self._actuators):
                bag.drives_nothing.add(channel.topic)
        bag.take_metadata(source)
        return bag

    def _out_of_order(self) -> list[str]:
        """Count the commands that repeat a stamp; returns what a person should know of stamps that do not ascend.

        Raises:
            LogError: a bag has commands of several runs.
        """
        bags = [bag for bag in self._bags if not (bag.ascends or bag.by_log)]
        back = [bag for bag in bags if bag.back_ns > BACK_NS]
        for bag in back:
            self._require_one_run(bag)
        for bag in bags:
            bag.still = self._repeated(bag)
        return [
            f"{bag.path}: the stamps of its commands go back by {_seconds(bag.back_ns)} s while it was recorded; they "
            "act in the order of their stamps"
            for bag in back
        ] + [
            f"{bag.path}: {bag.still} of its {bag.count} commands have the stamp of an earlier one on their channel: "
            "of commands of one stamp only the last acts"
            for bag in bags
            if bag.still and not bag.unstamped
        ]

    def _of_one_time(self) -> list[str]:
        """Return what a person should know of commands for the same time from several topics or bags."""
        counts = [(name.removeprefix("/"), count) for bag in self._bags for name, count in bag.found.items()]
        sources = Counter(self._wanted[name] for name, count in counts if count and name in self._wanted)
        if max(sources.values(), default=0) < 2:
            return []
        pairs = (np.stack((batch.time_ns, batch.channel)) for batch, _ in self.batches())
        repeats = sum(each.shape[1] - np.unique(each, axis=1).shape[1] for each in pairs)
        repeats -= sum(bag.still for bag in self._bags if not bag.by_log)
        what = "commands come at the time of another one on their channel, from another topic or bag"
        return [f"{repeats} {what}: of commands of one time only the last acts"] if repeats > 0 else []

    def _repeated(self, bag: _Recording) -> int:
        """Return how many commands have the stamp of an earlier one on their channel."""
        source, stamps = open_source(bag.path), dict[str, list[Times]]()
        for block in source.blocks():
            kind, topic = named_type(block.channel), self._wanted.get(block.channel.topic.removeprefix("/"))
            if kind in WRENCHES and topic is not None:
                stamps.setdefault(topic, []).append(_batch(source, bag, block, kind, 0).stamps)
        return sum(len(each) - len(np.unique(each)) for each in map(np.concatenate, stamps.values()))

    def _require_one_run(self, bag: _Recording) -> None:
        """Refuse commands of several runs.

        Raises:
            LogError: the stamps of a channel begin again.
        """
        stamped: dict[int, list[tuple[Times, Times]]] = {}
        # The first message of all, and that of the motion: as `convert` counts, --from and --to are from the latter.
        begin_ns = motion_ns = None
        for block in open_source(bag.path).blocks():
            kind, earliest_ns = named_type(block.channel), int(block.log_times.min())
            begin_ns = _first(begin_ns, earliest_ns)
            if kind in {*POSES, *TWISTS, *IMUS}:
                motion_ns = _first(motion_ns, earliest_ns)
            if kind == WRENCH and block.channel.topic.removeprefix("/") in self._wanted:
                stamped.setdefault(id(block.channel), []).append(_stamped(block, kind))
        for blocks in stamped.values():
            log_times, stamps = map(np.concatenate, zip(*blocks, strict=True))
            if np.count_nonzero(np.diff(log_times) < 0) > 3 + _SORTED * len(log_times):
                # Not the order in which they came.
                order = np.argsort(log_times, kind="stable")
                log_times, stamps = log_times[order], stamps[order]
            found = disorder(stamps)
            if found is not None and found.restarts:
                end_ns, next_ns = found.restarts[0]
                of_next = np.flatnonzero(stamps == next_ns)
                row = of_next[of_next > np.flatnonzero(stamps == end_ns)[0]][0]
                zero_ns = begin_ns if motion_ns is None else motion_ns
                at_s = (int(log_times[row]) - (zero_ns or 0)) / _NANOSECONDS
                raise LogError(
                    f"{bag.path}: the stamps of its commands begin again, {_seconds(next_ns)} s after "
                    f"{_seconds(end_ns)} s, expected those of one run, as they would act together; cut one out: "
                    f"convert {bag.path} part.mcap --to {at_s - 1e-6:.6f}, or --from {at_s:.6f}"
                )

    def _count(self, bag: _Recording, batch: _Batch) -> None:
        bag.count += len(batch.stamps)
        bag.stamps.add(batch.stamps)
        bag.log_times.add(batch.log_times)
        behind, unset = batch.log_times - batch.stamps, batch.stamps == 0
        bag.behind_ns = _least(bag.behind_ns, behind[~unset])
        bag.sum_ns += float(behind[~unset].sum(dtype=np.float64))
        bag.stamped += int((~unset).sum())
        bag.unset_ns = _least(bag.unset_ns, behind[unset])
        commands = batch.commands
        times, first = commands.time_ns, bag.first.setdefault(int(commands.channel[0]), [])
        if len(first) < FEW:
            first += times.tolist()
        within = (times >= 0) & (times <= self._end_ns)
        bag.within += int(within.sum())
        expired = self._expired(commands)
        bag.expired.update(commands.channel[expired].tolist())
        bag.early.update(commands.channel[(times < 0) & ~expired].tolist())
        bag.prompt.update(commands.channel[times == 0].tolist())
        # A command at the very end has no time to act.
        bag.acting += int((within & (times < self._end_ns)).sum())
        if self._channels is None:
            return
        batch_in_order = CommandBatch.of([commands])
        _, doubtful = self._channels.regular(batch_in_order)
        for row in doubtful.tolist():
            wrench = batch_in_order.received(row)
            try:
                self._channels.check(self._topics[int(batch_in_order.channel[row])], wrench).require()
            except WrenchError as error:
                bag.acting -= 0 <= wrench.stamp_ns < self._end_ns
                bag.refused = bag.refused or str(error)

    def _count_setpoints(self, bag: _Recording, block: MessageBlock) -> None:
        name, own = block.channel.topic, {topic.removeprefix("/") for topic in self._commanded}
        if self._drives(block.channel) is not None:
            bag.setpoints.add(block.log_times)
            bag.bare_times.setdefault(name, []).append(block.log_times)
        elif name.endswith(COMMAND) and name.removeprefix("/") not in own:
            bag.missed.setdefault(name, []).append(block.log_times)

    def _expired(self, commands: CommandBatch) -> NDArray[np.bool_]:
        """Return which commands have ended before time 0 by the timeouts of their channels."""
        if self._channels is None:
            return np.zeros(len(commands.time_ns), dtype=bool)
        life_ns = np.array([self._channels.life_ns(channel) for channel in range(len(self._topics))])
        found: NDArray[np.bool_] = commands.time_ns + life_ns[commands.channel] <= 0
        return found

    def _require_topics(self) -> None:
        """Refuse bags without what they are given for.

        Raises:
            LogError: `mapping` names what is not there, or no wrench topic of a bag is a channel.
        """
        found = sum((bag.found for bag in self._bags), Counter[str]())
        found.update({name: 0 for bag in self._bags for name in bag.found})
        known = (*found, *(name for bag in self._bags for name in bag.drives))
        missing = {name.removeprefix("/") for name in self._mapping} - {name.removeprefix("/") for name in known}
        if missing:
            raise LogError(
                f"{', '.join(str(bag.path) for bag in self._bags)}: mapped are {sorted(missing)}, expected wrench "
                f"topics of the bag: {_listed(found)}; map one of these"
            )
        for bag in self._bags:
            if not bag.drives and not any(name.removeprefix("/") in self._wanted for name in bag.found):
                raise LogError(_no_commands(bag, self._topics, [*self._commanded]))

    def _begin(self, start: Start) -> None:
        """Find time 0 of the run, and search again the bags whose times are not as stamped."""
        for bag in self._bags:
            bag.by_log = bag.by_log or bag.ours or bag.unstamped
            if bag.unstamped and not bag.ours:
                self.notes.append(f"{bag.path}: its commands have no stamps, so each acts at its log time")
        moved = self._bags
        if start == "auto":
            # A later part of a recording is not to begin at time 0, on top of an earlier one.
            margin_ns = (
                _ONE_CLOCK_NS
                if any(bag.span.first_ns is not None and bag.reaches(self._end_ns) for bag in self._bags)
                else 0
            )
            moved = [bag for bag in self._bags if not bag.reaches(self._end_ns, margin_ns)]
        if moved:
            time_0 = self._time_0(start, moved)
            for bag in moved:
                bag.offset_ns = time_0
                if start in ("auto", "bag") and bag.stalls:
                    self.notes.append(
                        f"{bag.path}: its log times do not follow the stamps of its commands, as over a link that "
                        "stalls: its start is the first stamp of commands and motion"
                    )
                elif start in ("auto", "bag") and bag.apart_ns:
                    self.notes.append(
                        f"{bag.path}: its log times are {_seconds(abs(bag.apart_ns))} s "
                        f"{'later' if bag.apart_ns > 0 else 'earlier'} than its stamps: the start of the bag is taken "
                        "by the stamps"
                    )
                if start == "auto":
                    told = "stamped" if bag.count and not bag.by_log else "recorded"
                    self.notes.append(
                        f"{bag.path}: its commands are {told} {bag.span}, outside of the run, which {self._run()}: so "
                        f"time 0 is the start of the bag, {_seconds(time_0)} s; choose another with --wrench-start"
                    )

    def _time_0(self, start: Start, bags: Sequence[_Recording]) -> int:
        """Return what is time 0 of the run for `bags`."""
        if isinstance(start, int):
            return start
        if start == "first":
            return _first(*(bag.first_ns for bag in bags)) or 0
        return min(bag.start_ns for bag in bags)

    def _run(self) -> str:
        """Return the first and the last time of the run."""
        return "begins at 0 s" if math.isinf(self._end_ns) else f"goes from 0 to {_seconds(int(self._end_ns))} s"

    def _no_effect(self, bag: _Recording) -> str:
        """Return the times of the commands of a bag if none has an effect, and what to do."""
        if bag.within and bag.refused:
            return (
                f"{bag.path}: of its {bag.count} wrench commands each that the run reaches is rejected: {bag.refused}"
            )
        zero = f", with time 0 at {_seconds(bag.offset_ns)} s of the bag" if bag.offset_ns else ""
        return (
            f"{bag.path}: none of its {bag.count} wrench commands acts: they lie {bag.span}, the run {self._run()}"
            f"{zero}; let the run begin with the first one by --wrench-start first, or at a time of the bag by "
            "--wrench-start SECONDS, or make it longer with --duration"
        )

    def _in_blocks(self, number: int, bag: _Recording) -> Iterator[tuple[CommandBatch, int]]:
        """Yield the commands of a bag as they were recorded, and the time (ns) before which none is still to come."""
        source, chunk, data, newest_ns = open_source(bag.path), 0, None, -(2**63)
        for block in source.blocks():
            if block.data is not data:
                # Blocks of one channel come in order; two channels of one topic by their places in a chunk.
                chunk, data = chunk + (1 << 32), block.data
            kind, topic = named_type(block.channel), self._wanted.get(block.channel.topic.removeprefix("/"))
            if kind in WRENCHES and topic is not None:
                commands = _batch(source, bag, block, kind, self._topics.index(topic), (number, chunk)).commands
                newest_ns = max(newest_ns, int(commands.time_ns.max()))
                yield commands.some(np.flatnonzero(~self._expired(commands))), newest_ns - bag.span.delay_ns


class _Batch(NamedTuple):
    """Commands of one block, with the times by both clocks."""

    stamps: Times
    unset: NDArray[np.bool_]
    log_times: Times
    commands: CommandBatch


def _batch(
    source: Source, bag: _Recording, block: MessageBlock, kind: str, channel: int, place: tuple[int, int] = (0, 0)
) -> _Batch:
    """Return the commands in a block of messages.

    Raises:
        LogError: a message is cut short or not CDR.
    """
    topic = Topic(block.channel.topic, kind)
    topic.take(block)
    try:
        stamps, _ = topic.stamps, topic.numbers
    except LogError:
        _require_whole(source, block, kind)
        raise
    if strays := bag.strays.get(block.channel.topic):
        stamps = strays.placed(topic.log_times, stamps)
    times = bag.line.stamps(topic.log_times) if bag.by_log else stamps
    bare = stamps == 0
    if fills := bag.fills.get(block.channel.topic):
        bare = fills.among(topic.log_times, stamps)
        stamps = np.where(bare, fills.placed(topic.log_times, bag.line), stamps)
        times = times if bag.by_log else stamps
    elif bag.fills:
        bare = np.zeros(topic.count, dtype=bool)
    time_ns, (number, chunk) = times - bag.offset_ns, place
    arrival = np.column_stack([np.full(topic.count, number), topic.log_times, chunk + block.begins])
    commands = commands_of(topic, block, channel, time_ns, time_ns, arrival)
    return _Batch(stamps, bare, topic.log_times, commands)


def _stamped(block: MessageBlock, kind: str) -> tuple[Times, Times]:
    """Return log times and stamps (ns) of the messages in a block that have a stamp."""
    if cdr.LAYOUTS.get(kind, [None])[0] != cdr.STAMP:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    whole = block.ends - block.begins >= 12
    raw = block.data[block.begins[whole, None] + np.arange(12)]
    parts = [raw[:, 4:].copy().view(order).astype(np.int64) for order in (">u4", "<u4")]
    seconds, rest = np.where(raw[:, 1:2] == 1, parts[1], parts[0]).T
    stamps = seconds * _NANOSECONDS + rest
    return block.log_times[whole][stamps != 0], stamps[stamps != 0]


def _clock_note(bag: _Recording) -> str:
    """Return how the log times of commands without stamps were put on the clock of stamps; "" if there is no need.

    Raises:
        LogError: it cannot be told which stamp belongs to a log time.
    """
    line, told = bag.line, list[str]()
    if not bag.times_unstamped:
        return ""
    off = f"leave a line against the stamps of the motion by {line.error_s:.3g} s"
    if not (line.bounded or line.one_clock):
        raise LogError(
            f"{bag.path}: its log times are of another clock than the stamps and {off}, so that it is not known when "
            "commands without stamps acted; record by the clock of the stamps (ros2 bag record --use-sim-time), or "
            "commands with stamps"
        )
    if line.drift:
        told.append(
            f"run {1.0 / (1.0 - line.drift):.6g} times as fast as the stamps of the motion: each command without a "
            "stamp acts at the stamp that belongs to its log time"
        )
    if not line.straight and line.one_clock:
        told.append(f"{off}; commands without stamps act at their log times all the same")
    elif not line.straight:
        told.append(f"{off}, as in queues: commands without stamps may have acted up to that much earlier")
    if line.ends_s:
        told.append(
            f"leave a line against the stamps of the motion by {line.ends_s:.3g} s within a second of the first or the "
            "last of these: either messages waited or a clock was set, so commands without stamps may have acted up to "
            "that much earlier there"
        )
    return f"{bag.path}: its log times {'; they '.join(told)}" if told else ""


def _pause_ns(bag: _Recording, other: _Recording) -> float:
    """Return the time between the commands to actuators of a bag and the wrenches of another, by their log times."""
    mine, its = bag.setpoints, other.log_times
    if mine.first_ns is None or mine.last_ns is None or its.first_ns is None or its.last_ns is None:
        return math.inf
    return max(0, mine.first_ns - its.last_ns, its.first_ns - mine.last_ns)


def _first(*times_ns: int | None) -> int | None:
    """Return the least of those that are known; None without any."""
    return min((time_ns for time_ns in times_ns if time_ns is not None), default=None)


def _least(known: int | None, more: Times) -> int | None:
    """Return the least of what was known and of more times; None without any."""
    return _first(known, int(more.min())) if len(more) else known


def _require_whole(source: Source, block: MessageBlock, kind: str) -> None:
    """Name the first message of a block that is damaged.

    Raises:
        LogError: there is one.
    """
    for log_time, begin, end in zip(block.log_times.tolist(), block.begins, block.ends, strict=True):
        try:
            cdr.decode(kind, block.data[begin:end].tobytes())
        except LogError as error:
            raise LogError(f"{source.path}: topic {block.channel.topic}, log time {log_time} ns: {error}") from error


def _seconds(time_ns: int) -> str:
    """Return a time in s with all its digits."""
    sign, whole, rest = "-" if time_ns < 0 else "", *divmod(abs(time_ns), _NANOSECONDS)
    return f"{sign}{whole}.{rest:09d}".rstrip("0").rstrip(".")


def origin_of(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, int]:
    """Return the bags that the commands of a log came from, by name, and which time (ns) of each was time 0."""
    facts = metadata.get(RUN, {})
    names, starts = (facts.get(key, "").split(", ") for key in ("wrench_bags", "wrench_start_ns"))
    # The text may come from any program: accept no more digits than a time has.
    if len(names) != len(starts) or not all(
        start.removeprefix("-").isdecimal() and len(start) < 20 for start in starts
    ):
        return {}
    return dict(zip(names, map(int, starts), strict=True))


def driven_of(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """Return the channel that each topic of those bags drove, if their names differed."""
    pairs = (pair.partition("=") for pair in metadata.get(RUN, {}).get("wrench_topics", "").split(", "))
    return {topic: channel for topic, _, channel in pairs if channel}


def _wanted(topics: Sequence[str], mapping: Mapping[str, str]) -> dict[str, str]:
    """Return the channel of each topic of the bag, without leading slash; a channel that is mapped has that topic only.

    Raises:
        LogError: a topic is mapped to what is not a channel.
    """
    channels = {topic.removeprefix("/"): topic for topic in topics}
    mapped = {source.removeprefix("/"): channel.removeprefix("/") for source, channel in mapping.items()}
    for source, channel in mapped.items():
        if channel not in channels:
            raise LogError(
                f"topic {source} is mapped to {channel!r}, expected a channel of the scene: {list(topics)}; name one"
            )
    by_name = {name: topic for name, topic in channels.items() if name not in mapped.values()}
    return by_name | {source: channels[channel] for source, channel in mapped.items()}


def _drive_nothing(bag: _Recording, actuators: Sequence[str]) -> str:
    return (
        f"{', '.join(sorted(bag.drives_nothing))} command{'s' * (len(bag.drives_nothing) == 1)} no actuator of the "
        f"scene ({', '.join(actuators)}); map with --topic TOPIC=ACTUATOR/command"
    )


def _no_commands(bag: _Recording, topics: Sequence[str], actuators: Sequence[str]) -> str:
    if actuators and bag.drives_nothing and not bag.found:
        return f"{bag.path}: {_drive_nothing(bag, actuators)}"
    if not bag.found:
        remedy = "give a bag of WrenchStamped or Wrench messages"
        if bag.unused:
            remedy = f"{_several(bag.unused)} is of another type than its commands, Float64"
        if bag.lost:
            remedy = "the file was cut off before a whole message: record it again"
    elif not topics:
        remedy = "add a channel under `wrenches` in the scene, or leave out the bag"
    else:
        remedy = (
            "name the channel under `wrenches` in the scene like the topic in the file, or map the topic with --topic "
            "TOPIC=CHANNEL"
        )
    return (
        f"{bag.path} has no channel of the scene: its wrench topics are {_listed(bag.found)}, the scene expects "
        f"{', '.join(topics) or 'none'}; {remedy}"
    )


def _several(topics: Mapping[str, str]) -> str:
    return ", ".join(f"{name} ({kind.rpartition('/')[2]})" for name, kind in sorted(topics.items()))


def _listed(found: Counter[str]) -> str:
    return ", ".join(f"{name} ({count} messages)" for name, count in sorted(found.items())) or "none"
