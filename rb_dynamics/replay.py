"""`replay`: runs a log again from what is in it, and compares every logged number to the last bit.

Scene, initial state and the time at which each command took effect come from the log alone. Never changes the log, and
holds no more of it in memory than the commands.
"""

from __future__ import annotations

import contextlib
import platform
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rb_dynamics.arguments import shown
from rb_dynamics.decimals import whole_number
from rb_dynamics.errors import LogError, WrenchError
from rb_dynamics.loads.channels import AppliedWrench
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.recording import cdr
from rb_dynamics.recording.bag_source import Source, open_source
from rb_dynamics.recording.mcap_records import Message
from rb_dynamics.recording.messages import (
    ACCEL,
    APPLIED,
    SAMPLE_TOPICS,
    WRENCH,
    encode_applied,
    sample_encoder,
    sample_topics,
)
from rb_dynamics.recording.own_log import received_commands, scene_and_names
from rb_dynamics.recording.provenance import CHECKPOINT, INTERRUPTED, RESULT, RUN, next_file, version
from rb_dynamics.recording.sink import Event, RunInfo, Sample
from rb_dynamics.recording.state_hash import StateHash
from rb_dynamics.scene.model import Scene
from rb_dynamics.simulate import Simulation

_PARTS = 100


@dataclass
class Difference:
    """How far one topic of the log is from the replay.

    Attributes:
        first_ns: where its bytes first differ.
        largest: of its numbers, in their unit.
        largest_ns: where that is.
        scale: the largest number of the topic in the log, where it differs.
    """

    first_ns: int
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
        proven_ns: time up to which the hash of the states, over numbers too that the log does not show, is that of the
            log: of all samples, or of those before the last checkpoint of a log that was cut off. None where it differs
            or there is none.
        hashes: of states and inputs as (log, replay), where the log has them.
        software: what is not as it was when the log was written: (log, here), by name of the fact.
    """

    samples: int = 0
    commands: int = 0
    complete: bool = True
    gap_ns: int | None = None
    differences: dict[str, Difference] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    proven_ns: int | None = None
    hashes: dict[str, tuple[str, str]] = field(default_factory=dict)
    software: dict[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def identical(self) -> bool:
        """Whether every number, and every hash that the log has, is the same to the last bit, and none is missing."""
        hashes_agree = all(logged == found for logged, found in self.hashes.values())
        return not self.differences and not self.missing and hashes_agree and self.gap_ns is None

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
            LogError: it has no scene or no sample, or is not all of a run.
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
        scene, names = scene_and_names(source)
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
        self._waiting: dict[str, deque[Message]] = {}
        self._states = StateHash()
        self._checkpoint = {} if facts.complete else facts.metadata.get(CHECKPOINT, {})

    def open(self, run: RunInfo) -> None:
        """Say which topics are compared."""
        names, scene = self._facts.names, run.scene
        accel = ACCEL[0] in names
        self._sample_topics = [names[name] for name, _ in sample_topics(scene, accel)]
        frames, acceleration = scene.frames, run.acceleration if accel else None
        self._encode = sample_encoder(frames.world_frame, frames.body_frame, acceleration)
        held = [name for name, _ in scene.acting.schedules()]
        applied = [names[topic + APPLIED] for topic in [*(c.topic for c in scene.channels), *held]]
        self._waiting = {topic: deque() for topic in [*self._sample_topics, *applied]}

    def write(self, event: Event) -> None:
        """Compare what the log has of this event."""
        if self._found.gap_ns is not None:
            return
        if isinstance(event, Sample):
            self._states.update(event)
            self._found.samples += 1
            if str(self._found.samples) == self._checkpoint.get("samples"):
                self._hold_states(self._checkpoint)
            for topic, message in zip(self._sample_topics, self._encode(event), strict=True):
                self._compare(topic, event.time_ns, message)
        elif isinstance(event, AppliedWrench):
            topic = self._facts.names[event.topic + APPLIED]
            self._compare(topic, event.time_ns, encode_applied(event))

    def close(self, result: Mapping[str, str]) -> None:
        """Compare the hashes, and look for what only the log has."""
        if self._found.gap_ns is not None:
            return
        for message in self._log:
            if message.channel.topic in self._waiting:
                self._waiting[message.channel.topic].append(message)
        for topic, waiting in self._waiting.items():
            # A log that is still being written has grown since its end was looked for.
            messages = [each for each in waiting if self._facts.complete or each.log_time <= self._facts.end_ns]
            if messages:
                self._miss(topic, messages[0].log_time, f"{len(messages)} messages that the replay has not")
        if self._facts.complete:
            logged = self._facts.metadata[RESULT]
            self._hold_states(logged)
            self._found.hashes["inputs_sha256"] = logged.get("inputs_sha256", ""), result["inputs_sha256"]

    def _hold_states(self, logged: Mapping[str, str]) -> None:
        """Compare the hash of all states up to now."""
        there, here = logged.get("states_sha256", ""), self._states.hexdigest()
        self._found.hashes["states_sha256"] = there, here
        self._found.proven_ns = self._states.time_ns if there == here else None

    def _compare(self, topic: str, time_ns: int, expected: bytes) -> None:
        message = self._next(topic)
        if message is None:
            # Of a log that was cut off, the last moments may be missing.
            if self._facts.complete:
                self._miss(topic, time_ns, "not what the replay has here")
            return
        if message.data == expected and message.log_time == time_ns:
            return
        if message.log_time != time_ns and not self._facts.complete:
            self._found.gap_ns = min(message.log_time, time_ns)
        if self._found.gap_ns is not None:
            return
        difference = self._found.differences.setdefault(topic, Difference(min(message.log_time, time_ns)))
        logged = _numbers(message)
        here = _numbers(message._replace(data=expected))
        largest = max((abs(a - b) for a, b in zip(logged, here, strict=True)), default=0.0)
        difference.scale = max([difference.scale, *map(abs, logged)])
        # Not a number compares with nothing: it must not pass for a small difference.
        if not largest <= difference.largest:
            difference.largest, difference.largest_ns = largest, time_ns
        if message.log_time != time_ns:
            difference.largest = float("inf")

    def _next(self, topic: str) -> Message | None:
        """Return the log's next message on a topic; None behind the last."""
        waiting = self._waiting[topic]
        while not waiting:
            message = next(self._log, None)
            if message is None:
                return None
            if message.channel.topic in self._waiting:
                self._waiting[message.channel.topic].append(message)
        return waiting.popleft()

    def _miss(self, topic: str, time_ns: int, what: str) -> None:
        line = f"{topic} at {time_ns / 1e9:.9f} s: the log has {what}"
        if not any(each.startswith(f"{topic} at ") for each in self._found.missing):
            self._found.missing.append(line)


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
