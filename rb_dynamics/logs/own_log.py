"""What a log of this package contains in addition to a bag: its scene, its samples as rows, its commands by channel."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from rb_dynamics.errors import LogError, RigidBodyError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import Source, open_source
from rb_dynamics.formats.log_metadata import RESULT, RUN, SCENE, TOPICS
from rb_dynamics.formats.mcap_records import Message, MessageBlock
from rb_dynamics.formats.message_types import SCALAR, WRENCH
from rb_dynamics.formats.output_file import is_log
from rb_dynamics.formats.topic_messages import Times, Topic, Values
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.loads.wrench_command_arrays import CommandBatch
from rb_dynamics.logs.messages import (
    ACCEL,
    APPLIED,
    MASS_PROPERTIES,
    POTENTIAL,
    SAMPLE_TOPICS,
    TF_STATIC,
    WHEEL_TOPICS,
    acting,
    decode_setpoint,
    decode_wrench,
)
from rb_dynamics.logs.recorded_commands import commands_of
from rb_dynamics.numerics.argument_checks import shown
from rb_dynamics.numerics.number_parsing import whole_number
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.read import UNSAID, opened, parse_scene


def _axes(name: str, axes: str = "xyz") -> tuple[str, ...]:
    return tuple(f"{name}_{axis}" for axis in axes)


# The columns of a row, by topic; `odom` and `/tf` say again what pose and twist say.
COLUMNS: dict[str, tuple[str, ...]] = {
    "pose": _axes("position_world") + _axes("orientation", "xyzw"),
    "twist": _axes("linear_velocity_body") + _axes("angular_velocity_body"),
    "angular_momentum": _axes("angular_momentum_world"),
    "linear_momentum": _axes("linear_momentum_world"),
    "energy/kinetic": ("kinetic_energy",),
    "energy/work": ("work",),
    "energy/defect": ("energy_defect",),
    "energy/potential": ("potential_energy",),
    "energy/motor_work": ("motor_work",),
    "energy/friction_heat": ("friction_heat",),
    "accel": _axes("linear_acceleration_body") + _axes("angular_acceleration_body"),
}

# Samples in a block.
_ROWS = 10_000

BY_ANY_METHOD: Mapping[str, object] = MappingProxyType({"solver": {}})
"""Overrides that read the scene of a log whose method is no longer there, where only its numbers are wanted."""


class SampleRow(NamedTuple):
    """One sample as logged: time in integer nanoseconds, numbers in the order of `row_columns`."""

    time_ns: int
    numbers: tuple[float, ...]


def scene_and_names(
    source: Source, purpose: str, overrides: Mapping[str, object] = BY_ANY_METHOD
) -> tuple[Scene, dict[str, str]]:
    """Return the scene of a log that has been read through, and each topic's name in it by its name in the scene.

    Args:
        source: the log.
        purpose: what the log is needed for, for error messages.
        overrides: of the scene, which keeps its text all the same.

    Raises:
        LogError: it is not a log of this package, or one of its topics has another type than it had.
        SceneError: the scene in it is not valid.
    """
    if SCENE not in source.attachments or RUN not in source.metadata:
        cut = "" if source.complete else ", which was cut off,"
        raise LogError(
            f"{source.path}{cut} is no log of this package: expected scene.yaml attached and metadata rb_dynamics, so "
            f"it cannot be {purpose}; inspect shows a bag of pose, twist and wrench, and its commands are run with "
            "simulate SCENE --wrench BAG"
        )
    try:
        text = source.attachments[SCENE].decode()
    except UnicodeDecodeError as error:
        raise LogError(
            f"{source.path} is damaged: {SCENE} in it is no UTF-8 text (byte {error.start}); give a copy that is whole"
        ) from error
    if text == UNSAID:
        raise LogError(
            f"{source.path} cannot be {purpose}: its scene was made or changed in Python, and no text in the log says "
            "what it is; read scenes with what is to be changed: read_scene(path, {'body.mass': 2.0})"
        )
    scene = replace(parse_scene(text, f"{source.path}: {SCENE}", overrides), text=text)
    return scene, require_types(source, scene)


def scene_of_log(
    path: str | os.PathLike[str], overrides: Mapping[str, object] = MappingProxyType({})
) -> tuple[Scene, dict[str, str], bool]:
    """Return the scene of a log, changed by `overrides`, to be run again, and what each topic of the log commands.

    The second are the topics of channels and actuators in the scene, by those of the log that have another name.
    The third is whether the run was open-ended: it now ends where it ended in the log.

    Raises:
        LogError: it is not a log of this package.
        SceneError: the scene in it, or an override, is not valid.
    """
    source = open_source(Path(path))
    # The last sample is the end of a run that was cut off: its log does not say it.
    last_ns = max(
        (int(b.log_times.max()) for b in source.blocks() if b.channel.type_name == SAMPLE_TOPICS[0][1]), default=0
    )
    logged, names = scene_and_names(source, "run again")
    end_ns = end_of_run(source) or last_ns
    open_ended = logged.duration is None and "duration" not in overrides and end_ns > 0
    if open_ended:
        overrides = {**overrides, "duration": end_ns / 1e9}
    scene = parse_scene(logged.text, f"{source.path}: {SCENE}", overrides)
    present = {channel.topic for channel in source.channels.values()}
    topics = {names[channel.topic]: channel.topic for channel in logged.channels}
    # One that was never commanded has no topic there.
    topics |= {names[each.topic]: each.topic for each in logged.actuators if names[each.topic] in present}
    names = {topic: channel for topic, channel in topics.items() if topic.lstrip("/") != channel.lstrip("/")}
    return scene, names, open_ended


def end_of_run(source: Source) -> int | None:
    """Return when the run ended, in ns, as the metadata of its log says, all of it being read; None if it does not.

    Raises:
        LogError: what it says is no time.
    """
    told = source.metadata.get(RESULT, {}).get("end_time_ns")
    if told is None:
        return None
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


def opened_scene(scene: Scene | str | os.PathLike[str]) -> Scene:
    """Return `scene`, read if it is the path of a scene file or of a log.

    Raises:
        TypeError: it is neither a scene nor a path.
        LogError: a log is not one of this package.
        SceneError: the file cannot be read, or is not a valid scene.
    """
    if isinstance(scene, (str, os.PathLike)) and is_log(scene):
        return scene_of_log(scene)[0]
    return opened(scene)


def logged_scene(attachments: Mapping[str, bytes]) -> Scene | None:
    """Return the scene in a log; None if there is none, or it needs a plug-in that is not here."""
    return scene_of_text(attachments[SCENE]) if SCENE in attachments else None


def scene_of_text(text: bytes) -> Scene | None:
    """Return the scene that a log has attached; None if it needs a plug-in that is not here."""
    try:
        return parse_scene(text.decode("utf-8", "replace"), overrides=BY_ANY_METHOD)
    except RigidBodyError:
        return None


def require_types(source: Source, scene: Scene | None) -> dict[str, str]:
    """Return each topic's name in a log of this package by its name in the scene; None if the scene is not known.

    Raises:
        LogError: a topic has another type than it had.
    """
    types = dict((*SAMPLE_TOPICS, POTENTIAL, MASS_PROPERTIES, TF_STATIC))
    if scene is not None:
        types |= {channel.topic: WRENCH for channel in scene.channels}
        types |= {name + APPLIED: WRENCH for name in acting(scene)}
        types |= {sensor.name: sensor.message for sensor in scene.sensors}
        types |= {actuator.topic: SCALAR for actuator in scene.actuators}
    usual = {name: name if name.startswith("/") else f"/{name}" for name in types}
    named = source.metadata.get(TOPICS, {})
    names = usual | named
    types |= {name: type_name for name, type_name in (*WHEEL_TOPICS, ACCEL) if name in named}
    expected = {names[name]: type_name for name, type_name in types.items()}
    for channel in source.channels.values():
        type_name = expected.get(channel.topic, channel.type_name)
        if channel.type_name != type_name:
            raise LogError(
                f"{source.path} is damaged: topic {channel.topic} has the type {channel.type_name!r}, expected "
                f"{type_name!r}; give a copy that is whole"
            )
    return names


def received_commands(
    scene: Scene, names: Mapping[str, str], messages: Iterable[Message]
) -> Iterator[tuple[str, Wrench, int]]:
    """Yield channel, command and the time (ns) at which it took effect, for each command that was received."""
    channels = {names[channel.topic]: channel.topic for channel in scene.channels}
    for each in messages:
        if each.channel.topic in channels:
            yield channels[each.channel.topic], decode_wrench(WRENCH, each.log_time, each.data), each.log_time


def received_batch(scene: Scene, names: Mapping[str, str], blocks: Iterable[MessageBlock]) -> CommandBatch:
    """Return the same for blocks of messages, by time.

    Raises:
        LogError: a message is cut short or not CDR.
    """
    channels = {names[channel.topic]: number for number, channel in enumerate(scene.channels)}
    batches, count = [CommandBatch.empty()], 0
    for block in blocks:
        if (number := channels.get(block.channel.topic)) is not None:
            topic, rows = Topic(block.channel.topic, WRENCH), np.arange(count, count + len(block.log_times))
            topic.take(block)
            arrival = np.column_stack([0 * rows, 0 * rows, rows])
            batches.append(commands_of(topic, block, number, topic.log_times, topic.stamps, arrival))
            count += len(rows)
    return CommandBatch.of(batches)


def received_setpoints(
    scene: Scene, names: Mapping[str, str], messages: Iterable[Message]
) -> Iterator[tuple[str, float, int]]:
    """Yield topic, command and the time (ns) at which it came, for each command to an actuator."""
    topics = {names[actuator.topic]: actuator.topic for actuator in scene.actuators}
    for each in messages:
        if each.channel.topic in topics:
            yield topics[each.channel.topic], decode_setpoint(each.data), each.log_time


def row_columns(scene: Scene, names: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of the numbers in a row."""
    return tuple(column for topic in _topics(scene, names) for column in COLUMNS[topic])


def rows(scene: Scene, names: Mapping[str, str], messages: Iterable[Message]) -> Iterator[SampleRow]:
    """Yield each sample of a log; one that was cut off within a sample ends before it."""
    waiting: dict[str, deque[tuple[int, tuple[float, ...]]]] = {names[t]: deque() for t in _topics(scene, names)}
    for message in messages:
        queue = waiting.get(message.channel.topic)
        if queue is None:
            continue
        layout = cdr.LAYOUTS[message.channel.type_name]
        numbers = tuple(cdr.numbers(layout, cdr.decode(message.channel.type_name, message.data)))
        queue.append((message.log_time, numbers))
        if all(waiting.values()):
            parts = [each.popleft() for each in waiting.values()]
            yield SampleRow(parts[0][0], tuple(number for _, part in parts for number in part))


def row_blocks(
    scene: Scene, names: Mapping[str, str], blocks: Iterable[MessageBlock]
) -> Iterator[tuple[Times, Values]]:
    """Yield the same in blocks: times (ns), and the numbers of each sample in the order of `row_columns`.

    Raises:
        LogError: a message is damaged.
    """
    types = dict((*SAMPLE_TOPICS, POTENTIAL, *WHEEL_TOPICS, ACCEL))
    waiting = {names[name]: Topic(names[name], types[name]) for name in _topics(scene, names)}

    def taken(least: int) -> Iterator[tuple[Times, Values]]:
        count = min(topic.count for topic in waiting.values())
        count -= count % least
        columns = [topic.numbers[:count] for topic in waiting.values()]
        times = next(iter(waiting.values())).log_times
        for first in range(0, count, _ROWS):
            part = slice(first, min(first + _ROWS, count))
            yield times[part], np.hstack([column[part] for column in columns])
        for name, topic in waiting.items() if count else ():
            waiting[name] = topic.only(np.arange(topic.count) >= count)

    for block in blocks:
        if (topic := waiting.get(block.channel.topic)) is not None:
            topic.take(block)
            if topic.count >= _ROWS:
                yield from taken(_ROWS)
    yield from taken(1)


def _topics(scene: Scene, names: Mapping[str, str]) -> list[str]:
    """Return the topics of a sample: a potential where there is one, and of wheels and acceleration what was logged."""
    lacking = {POTENTIAL[0]} if scene.combined_effects.potential() is None else set()
    lacking |= {name for name, _ in (*WHEEL_TOPICS, ACCEL) if name not in names}
    return [topic for topic in COLUMNS if topic not in lacking]
