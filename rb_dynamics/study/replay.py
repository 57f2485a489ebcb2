"""`replay`: run a log again from what is in it, and compare every topic to the last bit.

Scene, initial state and the time at which each command took effect come from the log alone. Only the commands are
held in memory.

Some bits must agree on every platform and version: the received commands; the hashes of scene and commands; what
pose, odometry and transform say of one instant; and, as far as the hash of the states agrees with the log's, every
topic except the acceleration, which that hash does not cover. Everything else may differ in its last digits on
another version or platform.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import platform
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from rb_dynamics.errors import LogError, WrenchError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import Source, open_source
from rb_dynamics.formats.mcap_records import Message
from rb_dynamics.formats.messages import (
    ACCEL,
    APPLIED,
    DIAGNOSTICS,
    MASS_PROPERTIES,
    SAMPLE_TOPICS,
    TF_STATIC,
    WRENCH,
    encode_applied,
    encode_fixed,
    encode_inertia,
    encode_received,
    sample_encoder,
    sample_topics,
)
from rb_dynamics.formats.own_log import received_commands, scene_and_names
from rb_dynamics.loads.channels import AppliedWrench, RejectedWrench
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import METHODS, REMOVED
from rb_dynamics.numerics.argument_checks import shown
from rb_dynamics.numerics.decimals import whole_number
from rb_dynamics.numerics.vector import ZERO
from rb_dynamics.recording.state_hash import StateHash
from rb_dynamics.run.input_hash import AppliedHash
from rb_dynamics.run.provenance import (
    CHECKPOINT,
    INPUTS_RULE,
    INTERRUPTED,
    RESULT,
    RUN,
    SCENE,
    next_file,
    version,
)
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.run.sink import Event, RunInfo, Sample
from rb_dynamics.scene.model import Scene

_PARTS = 100


@dataclass
class Difference:
    """How far one topic of the log is from the replay.

    Attributes:
        first_ns: where its bytes first differ.
        largest: of its numbers, in their unit.
        largest_ns: where that is.
        scale: the largest number of the topic in the log, where it differs.
        hashed: the topic says what the hash of the states is over, or what that follows from.
        certain: the topic is what the log alone says.
    """

    first_ns: int
    hashed: bool = True
    certain: bool = False
    largest: float = 0.0
    largest_ns: int = 0
    scale: float = 0.0

    @property
    def relative(self) -> float:
        """Largest difference against the largest number; infinite where it is not a number."""
        if self.largest == 0.0:
            return 0.0
        return self.largest / self.scale if self.scale > 0.0 else float("inf")


@dataclass
class Replay:
    """What a replay has found.

    Attributes:
        samples: compared.
        commands: posted.
        complete: the log was finished by its writer; else only its beginning is compared.
        gap_ns: time from which on the log lacks messages although later ones are there: a damaged piece was left out.
            Commands may be among them, so that nothing behind it is compared. None without a gap.
        differences: by topic; empty where every number is the same.
        missing: what one of the two has and the other has not, one line for each topic.
        torn: topics that contradict the pose or the twist of the same instant in the log itself, one line for each.
        uncompared: how many messages of the log cannot be held against a run, by topic and what they are.
        proven_ns: time up to which the hash of the states, over numbers too that the log does not show, is that of the
            log: of all samples, or of those before the last checkpoint of a log that was cut off. None where it differs
            or there is none.
        hashes: of scene, states and inputs as (log, replay), where the log has them.
        certain: names of the hashes that another version or platform gives too.
        software: what is not as it was when the log was written: (log, here), by name of the fact.
    """

    samples: int = 0
    commands: int = 0
    complete: bool = True
    gap_ns: int | None = None
    differences: dict[str, Difference] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    torn: list[str] = field(default_factory=list)
    uncompared: dict[tuple[str, str], int] = field(default_factory=dict)
    proven_ns: int | None = None
    hashes: dict[str, tuple[str, str]] = field(default_factory=dict)
    certain: set[str] = field(default_factory=set)
    software: dict[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def corrupt(self) -> list[str]:
        """Topics and hashes that differ although no version and no platform changes their bits."""
        topics = [
            topic
            for topic, each in self.differences.items()
            if each.certain or (each.hashed and self.proven_ns is not None and each.first_ns <= self.proven_ns)
        ]
        return topics + [name for name in self.certain if self.hashes[name][0] != self.hashes[name][1]]

    def within(self, bound: float) -> bool:
        """Return whether all that differs is what may differ on another version or platform, by at most `bound`."""
        broken = self.missing or self.torn or self.corrupt or self.gap_ns is not None
        return not broken and bool(self.software) and all(d.relative <= bound for d in self.differences.values())

    @property
    def identical(self) -> bool:
        """Whether every number, and every hash that the log has, is the same to the last bit, and none is missing."""
        hashes_agree = all(logged == found for logged, found in self.hashes.values())
        differ = self.differences or self.missing or self.torn or self.gap_ns is not None
        return hashes_agree and not differ

    @property
    def first(self) -> tuple[int, str] | None:
        """Time (ns) and topic of the first difference."""
        return min(((each.first_ns, topic) for topic, each in self.differences.items()), default=None)


def replay(path: str | Path, progress: Callable[[float], None] | None = None) -> Replay:
    """Run the log at `path` again and compare.

    Raises:
        LogError: the log cannot be read, or is not one of this package.
        SceneError: the scene in it is not valid any more.
        ConvergenceError: a step could not be solved that once was.
    """
    facts = _Facts.of(open_source(path))
    found = Replay(commands=len(facts.commands), complete=facts.complete, software=_changed(facts.metadata))
    comparison = _Comparison(open_source(path), facts, found)
    run = Simulation(facts.scene, [comparison])
    for topic, wrench, time_ns in facts.commands:
        # What was rejected is rejected again.
        with contextlib.suppress(WrenchError):
            run.post(topic, wrench, time_ns)
    run.start()
    try:
        for part in range(1, _PARTS + 1):
            run.advance(facts.end_ns * part // _PARTS)
            if progress is not None:
                progress(part / _PARTS)
            if found.gap_ns is not None:
                break
    finally:
        run.finish()
    return found


@dataclass
class _Facts:
    """What must be known of a log before it can be run again."""

    scene: Scene
    names: Mapping[str, str]
    commands: list[tuple[str, Wrench, int]]
    metadata: dict[str, dict[str, str]]
    complete: bool
    end_ns: int

    @classmethod
    def of(cls, source: Source) -> _Facts:
        """Read a log through.

        Raises:
            LogError: it has no scene or no sample, is not all of a run, or its method was removed.
        """
        begin_ns, end_ns = 0, -1
        received: list[Message] = []
        for number, message in enumerate(source.messages()):
            if number == 0:
                begin_ns = message.log_time
            if message.channel.type_name == WRENCH:
                received.append(message)
            elif message.channel.type_name == SAMPLE_TOPICS[0][1]:
                end_ns = max(end_ns, message.log_time)
        method = source.metadata.get(RUN, {}).get("method", "")
        if method in REMOVED and method not in METHODS:
            raise LogError(
                f"{source.path} was made by {method}, a method that was removed: no other gives its bits; inspect and "
                f"convert read it, and its scene (convert it to a .yaml) runs with --method {REMOVED[method]}"
            )
        scene, names = scene_and_names(source, "run again", overrides={})
        if end_ns < 0:
            raise LogError(f"{source.path} holds no pose: there is nothing to compare; give the log of a run")
        commands = list(received_commands(scene, names, received))
        complete = source.complete and INTERRUPTED not in source.metadata
        if complete:
            result = source.metadata.get(RESULT, {})
            if begin_ns > 0 or "end_time_ns" not in result:
                absent = next_file(source.metadata)
                raise LogError(
                    f"{source.path}: found one file of a bag, expected a run from its start to its end; give the "
                    f"folder of the bag{f', with {absent} in it' if absent else ''}"
                )
            # A change of wrench may be behind the last sample.
            end_ns = _end(source, result["end_time_ns"])
        return cls(scene, names, commands, source.metadata, complete, end_ns)


def _end(source: Source, told: str) -> int:
    try:
        end_ns = whole_number(told)
    except ValueError:
        end_ns = -1
    if not 0 <= end_ns < 2**63:
        raise LogError(
            f"{source.path} is damaged: its metadata says that the run ended at {shown(told)} ns, expected a time; "
            "give a copy that is whole"
        )
    return end_ns


class _Comparison:
    """A sink that holds what it is told against the log, topic by topic."""

    def __init__(self, source: Source, facts: _Facts, found: Replay) -> None:
        self._source, self._facts, self._found = source, facts, found
        self._log = source.messages()
        self._states = StateHash()
        self._checkpoint = {} if facts.complete else facts.metadata.get(CHECKPOINT, {})
        by_rule_1 = facts.complete and INPUTS_RULE not in facts.metadata[RESULT]
        self._in_order = _InOrder(facts.scene) if by_rule_1 else None

    def open(self, run: RunInfo) -> None:
        """Say which topics are compared."""
        names, scene = self._facts.names, run.scene
        frames, accel = scene.frames, ACCEL[0] in names
        samples = sample_topics(scene, accel)
        self._sample_topics = [names[name] for name, _ in samples]
        self._encode = sample_encoder(scene, run.acceleration if accel else None)
        self._body_frame = frames.body_frame
        commands = {channel.topic for channel in scene.channels}
        held = [*commands, *(name for name, _ in scene.combined_effects.schedules())]
        self._applied = {names[topic + APPLIED] for topic in held}
        self._certain = {names[topic] for topic in commands}
        self._types = {names[name]: kind for name, kind in samples}
        self._types |= dict.fromkeys(self._applied | self._certain, WRENCH)
        self._waiting: dict[str, deque[Message]] = {topic: deque() for topic in self._types}
        self._once = {names[MASS_PROPERTIES[0]]: lambda time_ns: encode_inertia(scene, time_ns)}
        self._types[names[MASS_PROPERTIES[0]]] = MASS_PROPERTIES[1]
        if frames.fixed:
            self._once[names[TF_STATIC[0]]] = lambda time_ns: encode_fixed(frames, time_ns)
            self._types[names[TF_STATIC[0]]] = TF_STATIC[1]
        self._absent = set(self._once)
        self._unhashed = {names[ACCEL[0]]} if accel else set()

    def write(self, event: Event) -> None:
        """Compare what the log has of this event."""
        if self._found.gap_ns is not None:
            return
        if isinstance(event, Sample):
            self._states.update(event)
            self._found.samples += 1
            if str(self._found.samples) == self._checkpoint.get("samples"):
                self._hold_states(self._checkpoint)
            logged = [
                self._compare(topic, event.time_ns, message)
                for topic, message in zip(self._sample_topics, self._encode(event), strict=True)
            ]
            if self._found.differences:
                self._hold_together(event.time_ns, logged)
        elif isinstance(event, AppliedWrench):
            self._compare_received(event)
            self._compare_applied(event)
        elif isinstance(event, RejectedWrench):
            self._compare_received(event)
            self._leave_out(
                self._facts.names[event.topic], "commands that were rejected: nothing follows from their numbers"
            )

    def close(self, result: Mapping[str, str]) -> None:
        """Compare the hashes, and look for what only the log has."""
        if self._found.gap_ns is not None:
            return
        while self._read():
            pass
        for topic, waiting in self._waiting.items():
            # A log that is still being written has grown since its end was looked for.
            messages = [each for each in waiting if self._facts.complete or each.log_time <= self._facts.end_ns]
            if messages:
                self._miss(topic, messages[0].log_time, f"{len(messages)} messages that the replay has not")
        scene = hashlib.sha256(self._source.attachments[SCENE]).hexdigest()
        self._hold("scene_sha256", self._facts.metadata[RUN].get("scene_sha256", ""), scene, certain=True)
        if self._facts.complete:
            for topic in self._absent:
                self._miss(topic, 0, "not what the replay has here")
            logged = self._facts.metadata[RESULT]
            self._hold_states(logged)
            inputs, rule_1 = logged.get("inputs_sha256", ""), self._in_order
            if rule_1 is None:
                self._hold("inputs_sha256", inputs, result["inputs_sha256"], certain=True)
            else:
                self._hold("inputs_sha256", inputs, rule_1.hexdigest(), certain=self._found.proven_ns is not None)

    def _hold(self, name: str, logged: str, here: str, certain: bool = False) -> None:
        self._found.hashes[name] = logged, here
        if certain:
            self._found.certain.add(name)

    def _hold_states(self, logged: Mapping[str, str]) -> None:
        """Compare the hash of all states up to now."""
        there, here = logged.get("states_sha256", ""), self._states.hexdigest()
        self._hold("states_sha256", there, here)
        self._found.proven_ns = self._states.time_ns if there == here else None

    def _hold_together(self, time_ns: int, logged: Sequence[Message | None]) -> None:
        """Compare what the log says twice of one instant: of pose and twist `odom` and `/tf` are copies."""
        said = dict(zip(self._sample_topics, logged, strict=True))
        pose, twist, odom, transform = (self._facts.names[name] for name in ("pose", "twist", "odom", "/tf"))
        for topic, start, other in ((odom, 0, pose), (odom, 43, twist), (transform, 0, pose)):
            one, two = said[topic], said[other]
            if one is None or two is None or any(each.startswith(f"{topic} at ") for each in self._found.torn):
                continue
            numbers = _numbers(two)
            if repr(_numbers(one)[start : start + len(numbers)]) != repr(numbers):
                self._found.torn.append(f"{topic} at {time_ns / 1e9:.9f} s: the log says something else on {other}")

    def _compare_received(self, event: AppliedWrench | RejectedWrench) -> None:
        topic = self._facts.names.get(event.topic)
        if topic in self._certain and event.received is not None:
            self._compare(topic, event.time_ns, encode_received(event.received))

    def _compare_applied(self, event: AppliedWrench) -> None:
        """Compare a change of what acts."""
        topic, expected = self._facts.names[event.topic + APPLIED], encode_applied(event)
        if self._fill(topic, 1) and self._waiting[topic][0].data != expected and event.received is not None:
            self._pass_timeout(topic, event)
        if self._in_order is not None:
            self._in_order.replayed(topic, event)
        self._compare(topic, event.time_ns, expected)

    def _pass_timeout(self, topic: str, command: AppliedWrench) -> None:
        """Pass over a timeout at the very time of a command on its channel: it acted for no time.

        A node that had gone on to that time before the command came has logged both.
        """
        timeout = replace(command, received=None, frame_id=self._body_frame, force=ZERO, torque=ZERO)
        first = self._waiting[topic][0]
        if (
            first.data == encode_applied(timeout)
            and self._fill(topic, 2)
            and first.log_time == self._waiting[topic][1].log_time == command.time_ns
        ):
            self._waiting[topic].popleft()
            if self._in_order is not None:
                self._in_order.replayed(topic, timeout)

    def _compare(self, topic: str, time_ns: int, expected: bytes) -> Message | None:
        """Compare the next message on a topic, and return it; None behind the last."""
        message = self._next(topic)
        if message is None:
            # Of a log that was cut off, the last moments may be missing.
            if self._facts.complete:
                self._miss(topic, time_ns, "not what the replay has here")
            return None
        if message.log_time != time_ns and not self._facts.complete:
            self._found.gap_ns = min(message.log_time, time_ns)
        if self._found.gap_ns is None:
            self._note(message, time_ns, expected)
        return message

    def _note(self, message: Message, time_ns: int, expected: bytes) -> None:
        """Note how far a message is from what is expected of it, if it is."""
        on_time = message.log_time == message.publish_time == time_ns
        if message.data == expected and on_time:
            return
        topic = message.channel.topic
        difference = self._found.differences.setdefault(
            topic,
            Difference(
                min(message.log_time, time_ns),
                hashed=topic not in self._unhashed,
                certain=topic in self._certain,
            ),
        )
        logged = _numbers(message)
        here = _numbers(message._replace(data=expected))
        alike = on_time and len(logged) == len(here)
        largest = max((abs(a - b) for a, b in zip(logged, here, strict=True)), default=0.0) if alike else math.inf
        difference.scale = max([difference.scale, *map(abs, logged)])
        # Not a number compares with nothing: it must not pass for a small difference.
        if not largest <= difference.largest:
            difference.largest, difference.largest_ns = largest, time_ns

    def _next(self, topic: str) -> Message | None:
        """Return the log's next message on a topic; None behind the last."""
        return self._waiting[topic].popleft() if self._fill(topic, 1) else None

    def _fill(self, topic: str, count: int) -> bool:
        """Read on until so many messages of a topic wait; False where there are no more."""
        waiting = self._waiting[topic]
        while len(waiting) < count:
            if not self._read():
                return False
        return True

    def _read(self) -> bool:
        """Take the next message of the log; False behind the last."""
        message = next(self._log, None)
        if message is None:
            return False
        topic, kind = message.channel.topic, message.channel.type_name
        if topic not in self._types:
            what = "messages that say how a node was" if kind == DIAGNOSTICS else "messages of a topic of no run"
            self._leave_out(topic, what)
        elif kind != self._types[topic]:
            self._miss(topic, message.log_time, f"the type {kind}, expected {self._types[topic]}")
        elif topic in self._once:
            self._absent.discard(topic)
            self._note(message, message.log_time, self._once[topic](message.log_time))
        else:
            self._waiting[topic].append(message)
            if self._in_order is not None and topic in self._applied:
                self._in_order.logged(topic)
        return True

    def _leave_out(self, topic: str, what: str) -> None:
        count = self._found.uncompared.get((topic, what), 0)
        self._found.uncompared[topic, what] = count + 1

    def _miss(self, topic: str, time_ns: int, what: str) -> None:
        line = f"{topic} at {time_ns / 1e9:.9f} s: the log has {what}"
        if not any(each.startswith(f"{topic} at ") for each in self._found.missing):
            self._found.missing.append(line)


class _InOrder:
    """The hash of the inputs as logs of rule 1 have it: over what acted, in the order in which the log has it."""

    def __init__(self, scene: Scene) -> None:
        self._hash = AppliedHash(scene)
        self._order: deque[str] = deque()
        self._changes: dict[str, deque[AppliedWrench]] = {}

    def logged(self, topic: str) -> None:
        """Take the topic of the log's next change."""
        self._order.append(topic)
        self._go_on()

    def replayed(self, topic: str, change: AppliedWrench) -> None:
        """Take the replay's next change on a topic."""
        self._changes.setdefault(topic, deque()).append(change)
        self._go_on()

    def hexdigest(self) -> str:
        """Return the hash of what both have."""
        return self._hash.hexdigest()

    def _go_on(self) -> None:
        while self._order and self._changes.get(self._order[0]):
            self._hash.update(self._changes[self._order.popleft()].popleft())


def _numbers(message: Message) -> list[float]:
    values = cdr.decode(message.channel.type_name, message.data)
    return cdr.numbers(cdr.LAYOUTS[message.channel.type_name], values)


def _changed(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, tuple[str, str]]:
    """Return what bits depend on and is not as it was."""
    logged = metadata[RUN]
    here = {
        "platform": platform.platform(),
        "machine": platform.machine(),
        **{f"version.{package}": version(package) for package in ("rb_dynamics", "numpy", "scipy")},
    }
    return {name: (logged.get(name, ""), value) for name, value in here.items() if logged.get(name, "") != value}
