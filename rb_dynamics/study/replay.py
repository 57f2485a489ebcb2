"""`replay`: run a log again from what is in it, and compare every topic to the last bit.

Scene, initial state and the time at which each command took effect come from the log alone. Only the commands are held
in memory.

Some things must agree on every platform and version: the received commands; the hashes of scene and commands; stamps,
frames and everything that is not a number; copies of the same instant in pose, odometry and transform; and, as far as
the hash of the states agrees with the log's, every topic except the acceleration, which that hash does not cover.
Everything else may differ in its last digits on another version or platform; which one wrote the log is known only from
the log itself.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, cast

import numpy as np

from rb_dynamics.errors import LogError, WrenchError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import Source, SplitBag, open_source
from rb_dynamics.formats.channel_metadata import QOS, TYPE_HASH, log_channel, qos_profile
from rb_dynamics.formats.log_metadata import (
    CHECKPOINT,
    CONTINUES_IN,
    EPOCH,
    INPUTS_RULE,
    INTERRUPTED,
    RESULT,
    RUN,
    SCENE,
    TOPICS,
    next_file,
)
from rb_dynamics.formats.mcap_records import Fact, McapChannel, Message, MessageBlock
from rb_dynamics.formats.message_types import DIAGNOSTICS, SCALAR, WRENCH
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.loads.wrench_channels import AppliedWrench, ReceivedWrench, RejectedWrench
from rb_dynamics.loads.wrench_command_arrays import CommandBatch
from rb_dynamics.logs.messages import (
    ACCEL,
    APPLIED,
    COMMAND_DEPTH,
    LATENCY,
    MASS_PROPERTIES,
    SAMPLE_TOPICS,
    SET_STATE,
    TF_STATIC,
    WHEEL_TOPICS,
    acting,
    block_encoder,
    decode_state_change,
    encode_applied,
    encode_fixed,
    encode_inertia,
    encode_received,
    encode_setpoint,
    encode_state_change,
    is_state_change,
    log_topics,
    measurement_packers,
    sample_encoder,
    sample_topics,
)
from rb_dynamics.logs.own_log import end_of_run, received_batch, received_commands, received_setpoints, scene_and_names
from rb_dynamics.motion import METHODS, REMOVED
from rb_dynamics.numerics.nanoseconds import split_stamp
from rb_dynamics.numerics.number_parsing import whole_number
from rb_dynamics.numerics.vector import ZERO
from rb_dynamics.run.event_arrays import EventArrays
from rb_dynamics.run.input_hash import RULE, AppliedHash
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.run.sink import ActuatorCommand, Event, Measurement, RunInfo, Sample, StateChange
from rb_dynamics.scene.model import Scene
from rb_dynamics.sinks.state_hash import StateHash, hashed_rows

_PARTS = 100

# Kinds of messages that a replay cannot check.
_REJECTED = "rejected commands, whose numbers have no effect"
_WAITING = "commands whose delay was not over at the end, so that their numbers have no effect"

# Numbers of samples, of which there may be many.
_BOOKS = {f"/{name}" for name, kind in (*SAMPLE_TOPICS, *WHEEL_TOPICS) if kind == SCALAR}

# Facts besides scene and commands on which bits depend.
_VERSION, _CODE = "version.rb_dynamics", "code_sha256"
_SOFTWARE = (_VERSION, _CODE, "version.numpy", "version.scipy", "plugins", "platform", "machine")
# Facts of a scene that are the same in every version.
_BY_SCENE = ("scene_sha256", "method", "seed", "effects")
# A pose consists of position and attitude, six numbers are two vectors, and mass properties are mass, centre and
# moments.
_PARTS_OF_RUN = {7: (3, 4), 6: (3, 3), 10: (1, 3, 6)}


@dataclass
class TopicDifference:
    """Difference of one topic between log and replay.

    Attributes:
        first_ns: time of the first difference.
        largest: difference of its numbers, in their unit, where `relative` is largest.
        largest_ns: time of that difference.
        relative: largest difference of a quantity (position, attitude, energy ...) relative to the largest value of
            that quantity in the replay; infinite for NaN, or if anything other than a number differs.
        hashed: whether the topic contains, or follows from, the numbers in the hash of the states.
        certain: whether the topic depends on the log alone, or anything other than a number differs.
    """

    first_ns: int
    hashed: bool = True
    certain: bool = False
    largest: float = 0.0
    largest_ns: int = 0
    relative: float = 0.0


@dataclass
class Replay:
    """Result of a replay.

    Attributes:
        samples: number compared.
        commands: number posted.
        complete: whether the log was finished by its writer; otherwise only its beginning is compared.
        gap_ns: time from which the log lacks messages although later ones exist: a damaged piece was left out. It may
            have contained commands, so nothing after it is compared. None without a gap.
        differences: by topic; empty if every number is the same.
        missing: messages that only the log or only the replay has, one line for each topic.
        torn: topics that contradict the pose or the twist of the same instant in the log itself, one line for each.
        uncompared: number of messages of the log that cannot be compared with a run, by topic and kind.
        unchecked: other contents of the log that do not follow from its scene and commands, by record and name.
        proven_ns: time up to which the hash of the states, which also covers numbers that are not in the log, agrees
            with the log: of all samples, or up to the last checkpoint that agrees. None if none does.
        facts: metadata of the run, its hashes included, as (log, replay), by record and name.
        certain: names of the facts that are the same on every version and platform.
        software: software and platform that differ from those in the log: (log, here), by name.
    """

    samples: int = 0
    commands: int = 0
    complete: bool = True
    gap_ns: int | None = None
    differences: dict[str, TopicDifference] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    torn: list[str] = field(default_factory=list)
    uncompared: dict[tuple[str, str], int] = field(default_factory=dict)
    unchecked: set[str] = field(default_factory=set)
    proven_ns: int | None = None
    facts: dict[str, tuple[str, str]] = field(default_factory=dict)
    certain: set[str] = field(default_factory=set)
    software: dict[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def other_code(self) -> bool:
        """Whether the log was made by another version of the package, or by changed code of this one."""
        return not self.software.keys().isdisjoint((_VERSION, _CODE))

    @property
    def corrupt(self) -> list[str]:
        """Topics and facts that differ although they do not depend on version or platform."""
        topics = [
            topic
            for topic, each in self.differences.items()
            if each.certain or (each.hashed and self.proven_ns is not None and each.first_ns <= self.proven_ns)
        ]
        return topics + [name for name in self.differing if name in self.certain]

    @property
    def differing(self) -> list[str]:
        """Names of the facts that differ from the log."""
        return [name for name, (logged, found) in self.facts.items() if logged != found]

    def within(self, bound: float) -> bool:
        """Return whether all differences can be due to another version or platform, and are at most `bound`."""
        broken = self.missing or self.torn or self.corrupt or self.gap_ns is not None
        return not broken and bool(self.software) and self.relative <= bound

    @property
    def relative(self) -> float:
        """Largest relative difference of a number, as in `TopicDifference`; 0 if all are the same."""
        return max((each.relative for each in self.differences.values()), default=0.0)

    @property
    def identical(self) -> bool:
        """Whether every number is the same to the last bit, everything else agrees, and nothing is missing."""
        return not (self.differing or self.differences or self.missing or self.torn) and self.gap_ns is None

    @property
    def first(self) -> tuple[int, str] | None:
        """Time (ns) and topic of the first difference."""
        return min(((each.first_ns, topic) for topic, each in self.differences.items()), default=None)


def replay(path: str | Path, progress: Callable[[float], None] | None = None) -> Replay:
    """Run the log at `path` again and compare.

    Raises:
        LogError: the log cannot be read, or is not a log of this package.
        SceneError: its scene is no longer valid.
        ConvergenceError: a step could not be solved.
    """
    facts = _Facts.of(path)
    count = len(facts.commands.time_ns) + len(facts.setpoints)
    found = Replay(commands=count, complete=facts.complete, torn=facts.records.torn)
    comparison = _Comparison(open_source(path), facts, found)
    run = Simulation(facts.scene, [comparison])
    moments = {change.time_ns for change in facts.moves}
    # A rejected command is rejected again.
    run.post_batch(facts.commands.some((~np.isin(facts.commands.time_ns, list(moments))).nonzero()[0]))
    for topic, value, time_ns in facts.setpoints:
        if time_ns not in moments:
            _actuate(run, topic, value, time_ns)
    run.start()
    try:
        around = deque(facts.around_moves(path, moments))
        for part in range(1, _PARTS + 1):
            until_ns = facts.end_ns * part // _PARTS
            while around and around[0][0] <= until_ns:
                time_ns, take = around.popleft()
                # The log gives a lagging wrench in axes that turn when the body is moved: replay it at its time.
                run.advance(time_ns)
                take(run)
            run.advance(until_ns)
            if progress is not None:
                progress(part / _PARTS)
            if found.gap_ns is not None:
                break
    finally:
        run.finish()
    return found


def _actuate(run: Simulation, topic: str, value: float, time_ns: int) -> None:
    with contextlib.suppress(WrenchError):
        run.actuate(topic, value, time_ns)


def _post(run: Simulation, topic: str, wrench: Wrench, time_ns: int) -> None:
    with contextlib.suppress(WrenchError):
        run.post(topic, wrench, time_ns)


@dataclass
class _Facts:
    """Facts of a log that are needed to run it again."""

    scene: Scene
    names: Mapping[str, str]
    commands: CommandBatch
    setpoints: list[tuple[str, float, int]]
    moves: list[StateChange]
    metadata: dict[str, dict[str, str]]
    records: _Records
    complete: bool
    end_ns: int

    @classmethod
    def of(cls, path: str | Path) -> _Facts:
        """Read a whole log.

        Raises:
            LogError: it has no scene or no sample, is not a whole run, or its method was removed.
        """
        said = _Records()
        source = open_source(path, said.add)
        begin_ns, end_ns = math.inf, -1
        wrenches: list[MessageBlock] = []
        received: list[Message] = []
        moves: list[Message] = []
        for block in source.blocks():
            begin_ns = min(begin_ns, int(block.log_times[0]))
            if block.channel.type_name == WRENCH:
                wrenches.append(block.alone())
            elif block.channel.type_name == SCALAR and block.channel.topic not in _BOOKS:
                received += block.messages()
            elif is_state_change(block.channel.topic, block.channel.type_name):
                moves += block.messages()
            elif block.channel.type_name == SAMPLE_TOPICS[0][1]:
                end_ns = max(end_ns, int(block.log_times.max()))
        received.sort(key=lambda message: message.log_time)
        method = source.metadata.get(RUN, {}).get("method", "")
        if method in REMOVED and method not in METHODS:
            raise LogError(
                f"{source.path} was made by {method}, a method that was removed: no other gives its bits; inspect and "
                f"convert read it, and its scene (convert it to a .yaml) runs with --method {REMOVED[method]}"
            )
        scene, names = scene_and_names(source, "run again", overrides={})
        if end_ns < 0:
            raise LogError(f"{source.path} holds no pose: there is nothing to compare; give the log of a run")
        commands = received_batch(scene, names, wrenches)
        setpoints = list(received_setpoints(scene, names, received))
        complete = source.complete and INTERRUPTED not in source.metadata
        if complete:
            told = end_of_run(source)
            absent = next_file(source.metadata)
            if absent and begin_ns == 0 and Path(path).is_dir():
                # The last files of the bag are missing: the others are compared, as of a log that was cut off.
                complete = False
            elif begin_ns > 0 or told is None:
                raise _no_whole_run(source.path, int(begin_ns), absent)
            else:
                # The wrench may change after the last sample.
                end_ns = told
        if moves:
            names[SET_STATE[0]] = moves[0].channel.topic
        changes = [decode_state_change(message) for message in moves]
        return cls(scene, names, commands, setpoints, changes, source.metadata, said, complete, end_ns)

    def around_moves(self, path: str | Path, moments: Set[int]) -> Iterator[tuple[int, Callable[[Simulation], None]]]:
        """Yield the time (ns) of each move from outside, and of each command of such a time, and how a run takes it.

        They come in the order in which they were logged.
        """
        for message in open_source(path).messages() if moments else ():
            if message.log_time not in moments:
                continue
            for topic, wrench, time_ns in received_commands(self.scene, self.names, [message]):
                yield time_ns, partial(_post, topic=topic, wrench=wrench, time_ns=time_ns)
            for topic, value, time_ns in received_setpoints(self.scene, self.names, [message]):
                yield time_ns, partial(_actuate, topic=topic, value=value, time_ns=time_ns)
            if is_state_change(message.channel.topic, message.channel.type_name):
                yield message.log_time, partial(Simulation.set_state, change=decode_state_change(message))


class _Records:
    """The metadata records of a log, besides the last of each name, which its source keeps.

    Attributes:
        torn: names with two contradictory records.
        channels: all different declarations, by topic.
        checkpoints: time (ns) and hash of the states, by number of samples.
    """

    def __init__(self) -> None:
        self.torn: list[str] = []
        self.channels: dict[str, list[McapChannel]] = {}
        self.checkpoints: dict[int, tuple[str, str]] = {}
        self._before: dict[str, dict[str, str] | bytes] = {}
        self._states = ""

    def add(self, name: str, said: Fact) -> None:
        """Add one record."""
        if isinstance(said, McapChannel):
            declared = self.channels.setdefault(name, [])
            declared += [said] if said not in declared else []
            return
        if name == RESULT and isinstance(said, dict) and CONTINUES_IN in said:
            if said.get("states_sha256") != self._states:
                self._tear(name, "the hash of the states at the end of a file is not that of the checkpoint before it")
        elif name == CHECKPOINT and isinstance(said, dict):
            facts = said.get("time_ns", ""), said.get("states_sha256", "")
            self._states = facts[1]
            try:
                number = whole_number(said.get("samples", ""))
            except ValueError:
                number = 0
            if self.checkpoints.setdefault(number, facts) != facts:
                self._tear(name)
        elif self._before.setdefault(name, said) != said and name not in (INTERRUPTED, EPOCH):
            self._tear(name)

    def _tear(self, name: str, what: str = "the log has two of that name that do not say the same") -> None:
        line = f"{name}: {what}"
        if line not in self.torn:
            self.torn.append(line)


def _no_whole_run(path: Path, begin_ns: int, absent: str) -> LogError:
    """Return the error of a log that is a part of a run; `absent`: the file in which it says that it continues."""
    whole = "expected a run from its start to its end"
    if begin_ns and path.is_dir():
        begin = f"{path} begins at {begin_ns * 1e-9:.10g} s"
        return LogError(f"{begin}, {whole}; add its first files, or inspect those that are there")
    folder = f"give the folder of the bag{f', with {absent} in it' if absent else ''}"
    return LogError(f"{path}: found one file of a bag, {whole}; {folder}")


class _Comparison:
    """A sink that compares events with the log, topic by topic."""

    def __init__(self, source: Source, facts: _Facts, found: Replay) -> None:
        self._source, self._facts, self._found = source, facts, found
        self._log = source.messages()
        # Messages that have been read and are still to be looked at, and the channel that each topic had last.
        self._ahead: deque[Message] = deque()
        self._last_channel: dict[str, McapChannel] = {}
        self._states = StateHash()
        self._checkpoints = dict(facts.records.checkpoints)
        by_rule_1 = facts.complete and INPUTS_RULE not in facts.metadata[RESULT]
        self._in_order = _InOrder(facts.scene) if by_rule_1 else None
        self._largest_energy, self._scales = 0.0, dict[str, list[float]]()
        self._newest_ns = 0
        # When commands come at the time at which an earlier one of their channel expires, and the changes of that time.
        self._renewals = _renewals(facts)
        self._renewed: dict[str, list[AppliedWrench]] = {}
        # Those on which a timeout has the message of the command: the wrench at that time, on its way.
        self._lagging = {facts.names[each.topic + APPLIED] for each in facts.scene.channels if each.lag}
        # Times of messages that each file has once, at its first sample, and which of them are still expected.
        self._begun: dict[str, list[int]] = {}
        self._at_start: dict[str, int] = {}

    def open(self, run: RunInfo) -> None:
        """Determine which topics are compared, and compare the metadata of the run."""
        scene, names = run.scene, {**{name: f"/{name}" for name, _ in WHEEL_TOPICS}, **self._facts.names}
        frames, accel = scene.frames, ACCEL[0] in names
        samples = sample_topics(scene, accel)
        self._sample_topics = [names[name] for name, _ in samples]
        self._energies = {names[name] for name, kind in samples if kind == SCALAR}
        self._encode = sample_encoder(scene, run.acceleration if accel else None)
        self._encode_block = None if accel else block_encoder(scene)
        self._body_frame = frames.body_frame
        self._delay_ns = {channel.topic: channel.delay_ns for channel in scene.channels}
        commands = {*self._delay_ns}
        self._applied = {names[name + APPLIED] for name in acting(scene)}
        self._certain = {names[topic] for topic in (*commands, *(each.topic for each in scene.actuators))}
        self._once = {names[MASS_PROPERTIES[0]]: lambda time_ns: encode_inertia(scene, time_ns)}
        if frames.fixed:
            self._once[names[TF_STATIC[0]]] = lambda time_ns: encode_fixed(frames, time_ns)
        topics = log_topics(scene, accel)
        moving = [(*SET_STATE, qos_profile(COMMAND_DEPTH))] if self._facts.moves else []
        self._certain |= {names[name] for name, *_ in moving}
        self._channels = {
            names.get(name, name): log_channel(names.get(name, name), *rest) for name, *rest in (*topics, *moving)
        }
        self._types = {topic: each.type_name for topic, each in self._channels.items() if each.type_name != DIAGNOSTICS}
        self._waiting: dict[str, deque[Message]] = {topic: deque() for topic in self._types if topic not in self._once}
        self._encode_measurement = measurement_packers(scene)
        self._unhashed = {names[name] for name in (*scene.sensor_topics, *([ACCEL[0]] if accel else []))}
        self._hold_run(run.metadata, [name for name, *_ in topics])

    def _hold_run(self, here: Mapping[str, str], topics: Sequence[str]) -> None:
        """Compare the metadata written at the start."""
        logged = self._facts.metadata[RUN]
        # Logs up to 0.2.0 do not say which code made them.
        asked = (name for name in _SOFTWARE if name != _CODE or _CODE in logged)
        both = {name: (logged.get(name, ""), here.get(name, "")) for name in asked}
        self._found.software |= {name: (was, now) for name, (was, now) in both.items() if was != now}
        for name in {**here, **logged}:
            if name in both or name == _CODE:
                continue
            if name in here and name != "scene_file" and name.partition(".")[0] not in ("version", "python"):
                self._hold(RUN, name, logged, here, certain=name in _BY_SCENE or None)
            else:
                self._found.unchecked.add(f"{RUN}.{name}")
        named = self._facts.metadata.get(TOPICS, {})
        self._hold(TOPICS, "names", {"names": ", ".join(sorted(named))}, {"names": ", ".join(sorted(topics))})

    @property
    def write_block(self) -> Callable[[EventArrays], None] | None:
        """Compare the messages of many events; None where each sample has its acceleration in the log."""
        return None if self._encode_block is None else self._compare_block

    def _compare_block(self, block: EventArrays) -> None:
        assert self._encode_block is not None
        times, samples, hashed = cast("Any", block.samples.time_ns), block.samples, hashed_rows(block.samples)
        models, fill = self._encode_block
        filled = [np.tile(np.frombuffer(model, np.uint8), (len(times), 1)) for model in models]
        fill(filled, samples, times)
        messages = [(rows.tobytes(), rows.shape[1]) for rows in filled]
        potential = () if samples.potential_energy is None else (samples.potential_energy,)
        energies = np.abs([samples.kinetic_energy, samples.work, *potential]).max(axis=0).tolist()
        change = _ChangesAsLogged(block, self._facts.names)
        stamps = times.tolist()
        for number in block.order.tolist():
            if self._found.gap_ns is not None:
                return
            if number >= block.taken:
                self._compare_change(number - block.taken, change)
                continue
            self._states.update_all(hashed[number : number + 1])
            expected = [data[number * size : number * size + size] for data, size in messages]
            self._compare_sample(stamps[number], expected, energies[number])

    def _compare_change(self, i: int, changes: _ChangesAsLogged) -> None:
        time_ns, topic, received, applied = changes.logged(i)
        acting = changes.applied_topic(i)
        came = [(topic, received)] if received is not None and topic in self._certain else []
        renewed = time_ns in self._renewals.get(acting, ())
        if not renewed and self._goes_on_with([*came, (acting, applied)], time_ns):
            return
        for topic, received in came:
            self._compare(topic, time_ns, received)
        plain = self._in_order is None and acting not in self._renewals
        if plain and self._fill(acting, 1) and self._waiting[acting][0].data == applied:
            self._compare(acting, time_ns, applied)
        else:
            self._compare_applied(changes.block.change(i))

    def _compare_sample(self, time_ns: int, expected: Sequence[bytes], energy: float) -> None:
        """Compare the messages of a sample whose state has been hashed."""
        self._found.samples += 1
        if (checkpoint := self._checkpoints.pop(self._found.samples, None)) is not None:
            self._hold_states(CHECKPOINT, dict(zip(("time_ns", "states_sha256"), checkpoint, strict=True)))
        self._largest_energy = max(self._largest_energy, energy)
        self._compare_renewed(time_ns)
        messages = list(zip(self._sample_topics, expected, strict=True))
        if self._goes_on_with(messages, time_ns):
            return
        logged = [self._compare(topic, time_ns, message) for topic, message in messages]
        if self._found.differences:
            self._hold_together(time_ns, logged)

    def write(self, event: Event) -> None:
        """Compare the messages of this event with the log."""
        if self._found.gap_ns is not None:
            return
        if isinstance(event, Sample):
            self._states.update(event)
            energies = event.kinetic_energy, event.work, event.potential_energy or 0.0
            self._compare_sample(event.time_ns, self._encode(event), max(map(abs, energies)))
        elif isinstance(event, AppliedWrench):
            self._compare_received(event)
            self._compare_applied(event)
        elif isinstance(event, ReceivedWrench):
            self._compare_received(event)
            if event.time_ns + self._delay_ns[event.topic] > self._facts.end_ns:
                self._leave_out(self._facts.names[event.topic], _WAITING)
        elif isinstance(event, ActuatorCommand):
            self._compare(self._facts.names[event.topic], event.time_ns, encode_setpoint(event.value))
            if event.reason:
                self._leave_out(self._facts.names[event.topic], _REJECTED)
        elif isinstance(event, Measurement):
            message = self._encode_measurement[event.topic](event, event.taken_ns)
            self._compare(self._facts.names[event.topic], event.time_ns, message)
        elif isinstance(event, RejectedWrench):
            self._compare_received(event)
            self._leave_out(self._facts.names[event.topic], _REJECTED)
        elif isinstance(event, StateChange):
            message = encode_state_change(event, self._facts.scene.frames)
            self._compare(self._facts.names[SET_STATE[0]], event.time_ns, message)

    def close(self, result: Mapping[str, str]) -> None:
        """Compare the hashes, and find messages that only the log has."""
        if self._found.gap_ns is not None:
            return
        self._read_rest()
        for topic, waiting in self._waiting.items():
            # A log that is still being written may have grown since its end was determined.
            messages = [each for each in waiting if self._facts.complete or each.log_time <= self._facts.end_ns]
            if messages:
                self._miss(topic, messages[0].log_time, f"{len(messages)} messages that the replay does not have")
        for topic, channel in self._channels.items():
            self._hold_channel(topic, self._facts.records.channels.get(topic, []), channel)
        known = (RUN, TOPICS, CHECKPOINT, *([RESULT] if self._facts.complete else []))
        self._found.unchecked |= self._facts.metadata.keys() - set(known)
        self._found.unchecked |= self._source.attachments.keys() - {SCENE}
        begun = len(self._source.files) if isinstance(self._source, SplitBag) else 1
        for topic in self._once:
            times = self._begun.get(topic, [])
            if len(times) > begun or (self._facts.complete and (len(times) < begun or times[0] != 0)):
                self._miss(topic, times[0] if times else 0, f"{len(times)} messages, expected one at each file's start")
        for number in self._checkpoints:
            self._found.unchecked.add(f"{CHECKPOINT} of {number} samples")
        if self._facts.complete:
            if self._checkpoints:
                last, there = str(max(self._checkpoints)), str(self._found.samples)
                self._hold(CHECKPOINT, "samples", {"samples": last}, {"samples": there}, certain=True)
            self._hold_result(result)
        elif self._facts.metadata.get(RESULT, {}).get("states_sha256") == self._states.hexdigest():
            # Only what follows the messages was cut off or damaged.
            self._hold_states(RESULT, {**self._facts.metadata[RESULT], "time_ns": str(self._states.time_ns)})

    def _hold_result(self, here: Mapping[str, str]) -> None:
        """Compare the metadata written at the end."""
        logged, rule_1 = self._facts.metadata[RESULT], self._in_order
        self._hold_states(RESULT, {**logged, "time_ns": str(self._states.time_ns)})
        proven = self._found.proven_ns == self._states.time_ns
        self._hold(RESULT, "method", logged, here, certain=proven or self._facts.scene.solver.method != "auto")
        # 0.1.0 counted what a node had computed beyond its end.
        self._hold(RESULT, "steps", logged, here)
        self._hold(RESULT, "end_time_ns", logged, here, certain=True)
        rule = logged.get(INPUTS_RULE, "")
        if rule_1 is not None:
            here = {**here, "inputs_sha256": rule_1.hexdigest()}
            if self._found.other_code:
                here = {**here, INPUTS_RULE: ""}
        self._hold(RESULT, INPUTS_RULE, logged, here)
        if rule in ("", RULE):
            self._hold(RESULT, "inputs_sha256", logged, here, certain=rule_1 is None or proven)
        self._found.unchecked |= {f"{RESULT}.{name}" for name in logged if f"{RESULT}.{name}" not in self._found.facts}

    def _hold(
        self,
        record: str,
        name: str,
        logged: Mapping[str, str],
        here: Mapping[str, str],
        certain: bool | None = None,
    ) -> None:
        """Compare one entry; `certain` is None if it does not depend on the platform, but perhaps on the version."""
        fact, both = f"{record}.{name}", (logged.get(name, ""), here.get(name, ""))
        was = self._found.facts.get(fact)
        if was is None or was[0] == was[1]:
            self._found.facts[fact] = both
        if certain or (certain is None and not self._found.other_code):
            self._found.certain.add(fact)

    def _hold_states(self, record: str, logged: Mapping[str, str]) -> None:
        """Compare the hash of all states so far, and their time."""
        here = {"states_sha256": self._states.hexdigest(), "time_ns": str(self._states.time_ns)}
        proven = self._found.proven_ns == self._states.time_ns
        self._hold(record, "states_sha256", logged, here, certain=proven)
        if logged["time_ns"] != here["time_ns"] or record == CHECKPOINT:
            self._hold(record, "time_ns", logged, here, certain=True)
        if logged.get("states_sha256", "") == here["states_sha256"]:
            self._found.proven_ns = self._states.time_ns
            # Everything before a proven time is proven as well.
            self._found.certain |= {name for name in self._found.differing if name == f"{CHECKPOINT}.states_sha256"}

    def _hold_channel(self, topic: str, declared: Sequence[McapChannel], here: McapChannel) -> None:
        """Compare what a channel declares: the message definition and QoS."""
        if not declared:
            self._miss(topic, 0, "no channel of that name")
        for each in declared:
            self._hold(topic, "QoS", {"QoS": each.metadata.get(QOS, "")}, {"QoS": here.metadata[QOS]})
            one, two = (
                {"schema": hashlib.sha256(repr((c.encoding, c.metadata.get(TYPE_HASH), c.schema)).encode()).hexdigest()}
                for c in (each, here)
            )
            self._hold(topic, "schema", one, two, certain=True)

    def _hold_together(self, time_ns: int, logged: Sequence[Message | None]) -> None:
        """Compare copies within the log at one instant: `odom` and `/tf` repeat pose and twist."""
        said = dict(zip(self._sample_topics, logged, strict=True))
        pose, twist, odom, transform = (self._facts.names[name] for name in ("pose", "twist", "odom", "/tf"))
        for topic, start, other in ((odom, 0, pose), (odom, 43, twist), (transform, 0, pose)):
            one, two = said[topic], said[other]
            if one is None or two is None or any(each.startswith(f"{topic} at ") for each in self._found.torn):
                continue
            numbers = _numbers(two)
            if repr(_numbers(one)[start : start + len(numbers)]) != repr(numbers):
                self._found.torn.append(f"{topic} at {time_ns / 1e9:.9f} s: the log says something else on {other}")

    def _compare_received(self, event: AppliedWrench | ReceivedWrench | RejectedWrench) -> None:
        topic, reported = self._facts.names.get(event.topic), not isinstance(event, ReceivedWrench) and event.delayed
        if topic in self._certain and event.received is not None and not reported:
            self._compare(topic, event.time_ns, encode_received(event.received))

    def _compare_applied(self, event: AppliedWrench) -> None:
        """Compare a change of the applied wrench; where a command meets a timeout, once that time is over."""
        topic = self._facts.names[event.topic + APPLIED]
        self._compare_renewed(event.time_ns)
        if event.time_ns in self._renewals.get(topic, ()):
            self._renewed.setdefault(topic, []).append(event)
        else:
            self._compare_applied_on(topic, event)

    def _compare_applied_on(self, topic: str, event: AppliedWrench) -> None:
        if self._in_order is not None:
            self._in_order.replayed(topic, event)
        self._compare(topic, event.time_ns, encode_applied(event))

    def _compare_renewed(self, until_ns: float) -> None:
        """Compare changes before `until_ns` of channels on which a command came as an earlier one expired."""
        for topic, changes in [*self._renewed.items()]:
            if changes[0].time_ns < until_ns:
                del self._renewed[topic]
                self._compare_without_timeout(topic, changes)

    def _compare_without_timeout(self, topic: str, changes: list[AppliedWrench]) -> None:
        """Compare all changes of one time, but for a timeout before a command: it has no effect.

        A node that had advanced to that time before the command came has logged it; a replay has one if the body is
        moved then, as it goes to the time of a move before its commands.
        """
        time_ns, command = changes[0].time_ns, next((each for each in changes if each.received is not None), None)
        if command is not None:
            timeout = next((each for each in changes if each.timed_out), None)
            changes = [each for each in changes if not each.timed_out]
            if timeout is None and topic not in self._lagging:
                timeout = replace(command, received=None, frame_id=self._body_frame, force=ZERO, torque=ZERO)
            while self._newest_ns <= time_ns and self._read():
                pass
            waiting, place = self._waiting[topic], changes.index(command)
            logged = [each.log_time for each in waiting].count(time_ns)
            if logged > len(changes) and waiting[place].data == encode_applied(timeout or command):
                del waiting[place]
                if self._in_order is not None:
                    self._in_order.replayed(topic, timeout or command)
        for change in changes:
            self._compare_applied_on(topic, change)

    def _goes_on_with(self, expected: Sequence[tuple[str, bytes]], time_ns: int) -> bool:
        """Take the next messages of the log if they are these, all at one time; if not, they stay to be compared.

        They nearly always are, and comparing them one by one takes several times as long.
        """
        queued = self._ahead or self._at_start or any(self._waiting.values())
        if queued or time_ns < self._newest_ns or self._in_order is not None:
            return False
        channels, read = self._last_channel, list(islice(self._log, len(expected)))
        if read != [(channels.get(topic), time_ns, time_ns, data, 0) for topic, data in expected]:
            self._ahead.extend(read)
            return False
        self._newest_ns = time_ns
        return True

    def _compare(self, topic: str, time_ns: int, expected: bytes) -> Message | None:
        """Compare the next message on a topic, and return it; None at the end."""
        waiting = self._waiting[topic]
        message = waiting.popleft() if waiting or self._fill(topic, 1) else None
        if message is None:
            # A log that was cut off may lack its last moments.
            if self._facts.complete:
                self._miss(topic, time_ns, "not what the replay has here")
            return None
        if message.log_time != time_ns and not self._facts.complete:
            self._found.gap_ns = min(message.log_time, time_ns)
        if message != Message(message.channel, time_ns, time_ns, expected) and self._found.gap_ns is None:
            self._note(message, time_ns, expected)
        return message

    def _note(self, message: Message, time_ns: int, expected: bytes) -> None:
        """Record the difference of a message from the expected one, if there is any."""
        on_time = message.log_time == message.publish_time == time_ns
        if message.data == expected and on_time:
            return
        topic = message.channel.topic
        difference = self._found.differences.setdefault(
            topic,
            TopicDifference(
                min(message.log_time, time_ns),
                hashed=topic not in self._unhashed,
                certain=topic in self._certain,
            ),
        )
        layout = cdr.LAYOUTS[message.channel.type_name]
        here, logged = _numbers(message._replace(data=expected)), _numbers(message)
        values = cdr.decode(message.channel.type_name, expected)
        if (
            not on_time
            or len(logged) != len(here)
            or cdr.encode(message.channel.type_name, *cdr.with_numbers(layout, values, iter(logged))) != message.data
        ):
            difference.certain = True
            difference.largest, difference.largest_ns, difference.relative = math.inf, time_ns, math.inf
            return
        scales = self._scales.setdefault(topic, [])
        start = 0
        for place, count in enumerate(_quantities(layout, len(here))):
            one, two = logged[start : start + count], here[start : start + count]
            start += count
            if place == len(scales):
                scales.append(0.0)
            scales[place] = max(scales[place], *map(abs, two))
            scale = self._largest_energy if topic in self._energies else scales[place]
            largest = max(abs(a - b) if math.isfinite(a) else math.inf for a, b in zip(one, two, strict=True))
            relative = largest / scale if scale > 0.0 else math.inf
            if largest > 0.0 and relative > difference.relative:
                difference.largest, difference.largest_ns, difference.relative = largest, time_ns, relative

    def _fill(self, topic: str, count: int) -> bool:
        """Read on until `count` messages of a topic are queued; return False at the end."""
        waiting = self._waiting[topic]
        while len(waiting) < count:
            if not self._read():
                return False
        return True

    def _read(self) -> bool:
        """Read the next message of the log; return False at the end."""
        message = self._ahead.popleft() if self._ahead else next(self._log, None)
        if message is None:
            return False
        topic, kind = message.channel.topic, message.channel.type_name
        if message.log_time < self._newest_ns:
            self._miss(topic, message.log_time, f"what comes after {self._newest_ns / 1e9:.9f} s")
        self._newest_ns = max(self._newest_ns, message.log_time)
        if topic not in self._types:
            of_a_node = kind == DIAGNOSTICS or topic.endswith(LATENCY)
            what = "warnings and the state of a node" if of_a_node else "messages of a topic of no run"
            self._leave_out(topic, what)
        elif kind != self._types[topic]:
            self._miss(topic, message.log_time, f"the type {kind}, expected {self._types[topic]}")
        elif topic in self._once:
            self._begun.setdefault(topic, []).append(message.log_time)
            self._at_start[topic] = message.log_time
            self._note(message, message.log_time, self._once[topic](message.log_time))
        else:
            self._waiting[topic].append(message)
            self._last_channel[topic] = message.channel
            if self._at_start and topic == self._sample_topics[0]:
                for other, time_ns in self._at_start.items():
                    if time_ns != message.log_time:
                        self._miss(other, time_ns, "what belongs to the start of a file")
                self._at_start.clear()
            if self._in_order is not None and topic in self._applied:
                self._in_order.logged(topic)
        return True

    def _read_rest(self) -> None:
        self._compare_renewed(math.inf)
        while self._read():
            pass

    def _leave_out(self, topic: str, what: str) -> None:
        count = self._found.uncompared.get((topic, what), 0)
        self._found.uncompared[topic, what] = count + 1

    def _miss(self, topic: str, time_ns: int, what: str) -> None:
        line = f"{topic} at {time_ns / 1e9:.9f} s: the log has {what}"
        if not any(each.startswith(f"{topic} at ") for each in self._found.missing):
            self._found.missing.append(line)


class _ChangesAsLogged:
    """The messages that the changes of a block have in the log."""

    def __init__(self, block: EventArrays, names: Mapping[str, str]) -> None:
        changes = self._changes = block.changes
        self.block = block
        self._topics = [(names.get(topic, ""), names[topic + APPLIED]) for topic in changes.topics]
        self._packers = [cdr.stamped_packer(WRENCH, frame) for frame in changes.frames]
        self._messages = changes.came.received.messages()
        columns = changes.time_ns, changes.channel, changes.row, changes.in_world, changes.wrench
        self._rows: list[Any] = list(zip(*(column.tolist() for column in columns), strict=True))

    def logged(self, i: int) -> tuple[int, str, bytes | None, bytes]:
        """Return time (ns), topic, the command as received (None for a timeout) and as it acts."""
        time_ns, channel, row, in_world, wrench = self._rows[i]
        received = None
        if row >= 0:
            received = self._messages[row] or encode_received(self._changes.came.received(row))
        return time_ns, self._topics[channel][0], received, self._packers[in_world](*split_stamp(time_ns), *wrench)

    def applied_topic(self, i: int) -> str:
        """Return the topic of what acts."""
        channel: int = self._rows[i][1]
        return self._topics[channel][1]


class _InOrder:
    """The hash of the inputs by rule 1: over applied wrenches, in the order in which the log has them."""

    def __init__(self, scene: Scene) -> None:
        self._hash = AppliedHash(scene)
        self._order: deque[str] = deque()
        self._changes: dict[str, deque[AppliedWrench]] = {}

    def logged(self, topic: str) -> None:
        """Add the topic of the log's next change."""
        self._order.append(topic)
        self._go_on()

    def replayed(self, topic: str, change: AppliedWrench) -> None:
        """Add the replay's next change on a topic."""
        self._changes.setdefault(topic, deque()).append(change)
        self._go_on()

    def hexdigest(self) -> str:
        """Return the hash of the changes in both."""
        return self._hash.hexdigest()

    def _go_on(self) -> None:
        while self._order and self._changes.get(self._order[0]):
            self._hash.update(self._changes[self._order.popleft()].popleft())


def _renewals(facts: _Facts) -> dict[str, set[int]]:
    """Return, by the topic of what acts, the times (ns) of commands at which an earlier command expires.

    A node that had advanced to that time before the command came has logged the timeout as well.
    """
    found: dict[str, set[int]] = {}
    past, commands = facts.scene.past, facts.commands
    for number, channel in enumerate(facts.scene.channels):
        timeout_ns = channel.timeout_ns
        if not timeout_ns or channel.delay:
            continue
        times = commands.time_ns[commands.channel == number]
        earlier = times.tolist()
        if past is not None:
            earlier += [ns - past.length_ns for name, _, ns in past.commands if name == channel.topic]
        renewing = times[np.isin(times - timeout_ns, earlier)]
        if len(renewing):
            found[facts.names[channel.topic + APPLIED]] = set(renewing.tolist())
    return found


def _numbers(message: Message) -> list[float]:
    values = cdr.decode(message.channel.type_name, message.data)
    return cdr.numbers(cdr.LAYOUTS[message.channel.type_name], values)


def _quantities(layout: Sequence[cdr.Field], count: int) -> Sequence[int]:
    """Return how many of the numbers of a message belong to each of its quantities, in order."""
    runs = [run for part in layout for run in (part if isinstance(part, list) else [part]) if isinstance(run, int)]
    parts = [part for run in runs for part in _PARTS_OF_RUN.get(run, (run,))]
    return parts * (count // sum(parts))
