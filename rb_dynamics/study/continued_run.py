"""`scene_at`: a scene that continues a log from a time on, with the same bits. `whole_run`: the logs of both as one.

The log is run again up to that time. The new scene begins with the state there, to the last bit, and describes
in `continues` the run that it comes from: its first state and the commands until then. When the scene is run, the
earlier part is computed again but not output, so the method and the totals of work and impulse continue too, and every
later number is that of the original run.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rb_dynamics.body.state import State
from rb_dynamics.errors import LogError, SceneError, WrenchError
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.formats.log_metadata import EPOCH, RESULT, RUN, loss
from rb_dynamics.formats.mcap_records import Fact, Message
from rb_dynamics.formats.output_file import require_other
from rb_dynamics.formats.yaml import document
from rb_dynamics.formats.yaml.problems import Problems
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.messages import ACCEL, is_state_change
from rb_dynamics.logs.own_log import logged_scene, received_commands, row_columns, rows, scene_and_names
from rb_dynamics.numerics.nanoseconds import nanoseconds
from rb_dynamics.numerics.rotation import rotate_inverse
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.scene.model import Past, Scene
from rb_dynamics.scene.read import parse_scene
from rb_dynamics.sinks.mcap_sink import LogSettings, McapSink

# Commands of a run that a scene keeps if it cannot keep all.
_KEPT = 500


@dataclass(frozen=True)
class SceneAt:
    """A scene that continues a log.

    Attributes:
        text: YAML.
        notes: what it leaves out; empty if it continues with the same bits.
        later: whether the log has commands from then on.
    """

    text: str
    notes: tuple[str, ...]
    later: bool


def scene_at(log: str | os.PathLike[str], time_ns: int) -> SceneAt:
    """Return a scene whose time 0 is `time_ns` of a log of this package.

    Its commands are those that it is given: with `--wrench LOG --wrench-start T` those of the log. What is held at
    that time stays held without them.

    Raises:
        LogError: it is not a log of this package or ends before `time_ns`, the body was moved from outside before, or
            the scene has actuators.
        SceneError: the scene in it is not valid.
    """
    source = open_source(Path(log))
    logged, last_ns = None, 0
    messages = list(source.messages())
    scene, names = scene_and_names(source, "continued", {})
    columns = row_columns(scene, names)
    for row in rows(scene, names, iter(messages)):
        last_ns = row.time_ns
        if row.time_ns == time_ns:
            logged = dict(zip(columns, row.numbers, strict=True))
    _require_possible(source.path, scene, messages, time_ns, last_ns)
    commands = list(received_commands(scene, names, iter(messages)))
    later = any(at >= time_ns for _, _, at in commands)
    # What is not finite was rejected, and no scene can contain it.
    received = [
        (topic, wrench, at)
        for topic, wrench, at in commands
        if at < time_ns and np.isfinite((*wrench.force, *wrench.torque)).all()
    ]
    state = _state_at(scene, received, time_ns)
    end_ns, lost = scene.end_ns, loss(source.complete, source.metadata)
    notes = [f"{source.path} {lost}"] * bool(lost)
    if logged is not None and not _agrees(state, logged):
        raise LogError(
            f"{source.path}: a repetition reaches another state at {time_ns / 1e9:.9g} s than the log has, expected "
            "the same bits: it was made on another platform or by another version; replay says what differs"
        )
    changes: dict[str, object] = {"initial": _initial(state)}
    if end_ns == time_ns:
        changes["duration"] = None
        notes.append("the run ends there, and the scene has no duration: give its length with --duration S")
    elif end_ns is not None:
        changes["duration"] = left = (end_ns - time_ns) / 1e9
        if (late_ns := nanoseconds(left) - (end_ns - time_ns)) != 0:
            notes.append(
                f"its end is {late_ns:+d} ns from that of the run: a double of so many seconds has gaps of them"
            )
    elif (ended := source.metadata.get(RESULT, {}).get("end_time_ns")) is not None:
        notes.append(f"the run had no duration; it was stopped after {int(ended) / 1e9:.9g} s")
    if scene.sensors:
        notes.append("sensors start anew: their noise differs from that of the run")
    try:
        return SceneAt(_text(scene, changes | {"continues": _past(scene, received, time_ns)}), tuple(notes), later)
    except SceneError:
        if not received:
            raise
    notes.append(
        f"{len(received)} commands before it are too many for a scene: it keeps the last ones and starts from the "
        "state of the run and the held wrenches; method, impulses and work start anew, so later bits differ"
    )
    if any(channel.lag for channel in scene.channels):
        notes.append("channels with a lag follow only the commands that are kept")
    past = _past(scene, received, time_ns, _newest)
    return SceneAt(_text(scene, changes | {"continues": past}), tuple(notes), bool(scene.channels))


_Commands = list[tuple[str, Wrench, int]]


def _newest(commands: _Commands) -> _Commands:
    """Return the newest commands, and of each other channel the last one, which stays held."""
    last = {topic: number for number, (topic, _, _) in enumerate(commands)}
    kept = sorted({*last.values(), *range(max(0, len(commands) - _KEPT), len(commands))})
    return [commands[number] for number in kept]


class _Part:
    """The log of a part of a run: from `begin_ns` of it on."""

    def __init__(self, path: Path) -> None:
        source = open_source(path)
        self.path, self.messages = path, list(source.messages())
        self.scene, self.names = scene_and_names(source, "made one with others", {})
        self.begin_ns = self.scene.past.length_ns if self.scene.past else 0
        self.in_ros_time = EPOCH in source.metadata
        self.end_ns = self.scene.end_ns or int(source.metadata.get(RESULT, {}).get("end_time_ns", "0"))

    def in_whole(self, wrench: Wrench) -> Wrench:
        """Return a command with its stamp in the whole run, unless it is ROS time, which goes on."""
        if not self.begin_ns or self.in_ros_time:
            return wrench
        return Wrench(wrench.force, wrench.torque, wrench.frame_id, wrench.stamp_ns + self.begin_ns)

    def samples(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Yield time (ns of the whole run) and numbers of each sample."""
        columns = row_columns(self.scene, self.names)
        for row in rows(self.scene, self.names, iter(self.messages)):
            yield row.time_ns + self.begin_ns, dict(zip(columns, row.numbers, strict=True))


def _scene_said_first(path: Path) -> Scene | None:
    """Return the scene of a log of this package, which has it before its messages; None for any other bag."""
    # Those of a folder are complete at the end of a file only.
    said: dict[str, Fact] = {}
    next(iter(open_source(path, said.__setitem__).blocks()), None)
    return logged_scene({name: fact for name, fact in said.items() if isinstance(fact, bytes)}) if RUN in said else None


def whole_run(logs: Sequence[Path], target: Path) -> int | None:
    """Write the log of the whole run of which `logs` are parts, that of the beginning among them; return its samples.

    None, and nothing written, if none of them continues another.

    Raises:
        LogError: they are not of one run, as the whole run gives other numbers than one of them; or no scene can
            describe what happened in one.
    """
    scenes = [_scene_said_first(path) for path in logs]
    if None in scenes or all(scene is None or scene.past is None for scene in scenes):
        return None
    parts = [_Part(path) for path in logs]
    require_other(target, *logs)
    parts.sort(key=lambda part: part.begin_ns)
    first, last = parts[0], parts[-1]
    ends_ns = [*(part.begin_ns for part in parts[1:]), last.begin_ns + last.end_ns]
    for part, end_ns in zip(parts, ends_ns, strict=True):
        _require_possible(part.path, part.scene, part.messages, end_ns - part.begin_ns, part.end_ns)
        if part.scene.sensors:
            raise LogError(
                f"{part.path} has sensors, whose noise begins anew in each part, expected none; keep it apart"
            )
    scene = parse_scene(first.scene.text, first.scene.source, {"duration": ends_ns[-1] / 1e9})
    log = McapSink(target, settings=LogSettings(accel=any(ACCEL[0] in part.names for part in parts)))
    run = Simulation(scene, [log], {"merged_from": ", ".join(part.path.name for part in parts)})
    run.start()
    for part, end_ns in zip(parts, ends_ns, strict=True):
        for topic, wrench, at in received_commands(part.scene, part.names, iter(part.messages)):
            if part.begin_ns + at < end_ns or part is last:
                with contextlib.suppress(WrenchError):
                    run.post(topic, part.in_whole(wrench), part.begin_ns + at)
    try:
        run.advance(ends_ns[-1])
    finally:
        run.finish()
    try:
        return _repeated(_Part(target), parts, ends_ns)
    except LogError:
        target.unlink()
        raise


def _repeated(whole: _Part, parts: Sequence[_Part], ends_ns: Sequence[int]) -> int:
    """Return the samples of a run, which must have the bits of its parts at the times of both.

    Raises:
        LogError: they differ.
    """
    found = dict(whole.samples())
    for part, end_ns in zip(parts, ends_ns, strict=True):
        for time_ns, numbers in part.samples():
            if time_ns > end_ns or time_ns not in found:
                continue
            # The whole run has the acceleration if any part has.
            if any(repr(found[time_ns].get(name)) != repr(number) for name, number in numbers.items()):
                raise LogError(
                    f"{part.path} is no part of that run: run as one, it comes to other numbers at "
                    f"{time_ns / 1e9:.9g} s, expected the same bits; was its body, its solver or its duration changed? "
                    "compare shows two logs beside each other, and a table (.csv, .parquet) holds both"
                )
    return len(found)


def _require_possible(path: Path, scene: Scene, messages: Sequence[Message], time_ns: int, last_ns: int) -> None:
    """Refuse a log that no scene can continue.

    Raises:
        LogError: says what it is.
    """
    moved = any(
        each.log_time < time_ns and is_state_change(each.channel.topic, each.channel.type_name) for each in messages
    )
    if not 0 <= time_ns <= last_ns:
        raise LogError(
            f"--at: found {time_ns / 1e9:.9g} s, expected a time from 0 to {last_ns / 1e9:.9g} s, where the samples of "
            f"{path} end; give one of these"
        )
    if moved:
        raise LogError(
            f"{path}: the body was moved from outside (set_state) before {time_ns / 1e9:.9g} s, and no scene "
            "says that; give a time before it"
        )
    if scene.actuators:
        raise LogError(
            f"{path} has actuators, whose commands and speeds a scene cannot contain, expected a body without; run "
            f"it from its beginning: simulate {path}"
        )


def _state_at(scene: Scene, commands: list[tuple[str, Wrench, int]], time_ns: int) -> State:
    run = Simulation(scene)
    run.start()
    for topic, wrench, at in commands:
        try:
            run.post(topic, wrench, at)
        except WrenchError:
            continue  # rejected in the log, too
    run.advance(time_ns)
    sample = run.look()
    return State(
        0, sample.position_world, sample.orientation_xyzw, sample.linear_velocity_world, sample.angular_velocity_body
    )


def _agrees(state: State, logged: Mapping[str, float]) -> bool:
    """Return whether a state has the bits of a sample in a log."""
    there = [logged[name] for name in logged if name.startswith(("position_", "orientation_", "linear_velocity_"))]
    there += [logged[name] for name in logged if name.startswith("angular_velocity_")]
    velocity = rotate_inverse(state.orientation_xyzw, state.linear_velocity_world)
    here = (*state.position_world, *state.orientation_xyzw, *velocity, *state.angular_velocity_body)
    return bool(np.array_equal(here, there))


def _initial(state: State) -> dict[str, object]:
    return {
        "position_world": list(state.position_world),
        "orientation": dict(zip("xyzw", state.orientation_xyzw, strict=True)),
        "linear_velocity_world": list(state.linear_velocity_world),
        "angular_velocity_body": list(state.angular_velocity_body),
    }


def _past(
    scene: Scene, commands: _Commands, time_ns: int, some: Callable[[_Commands], _Commands] = list
) -> dict[str, object]:
    """Return the run until `time_ns`, with what came before the scene itself, and `some` of all commands."""
    before = scene.past or Past(0, scene.initial, scene.duration)
    all_commands = some([*before.commands, *((topic, wrench, at + before.length_ns) for topic, wrench, at in commands)])
    duration = {} if before.duration is None else {"duration": before.duration}
    return {
        "after_ns": before.length_ns + time_ns,
        **duration,
        "initial": _initial(before.initial),
        "commands": [[at, topic, wrench.frame_id, *wrench.force, *wrench.torque] for topic, wrench, at in all_commands],
    }


def _text(scene: Scene, changes: Mapping[str, object]) -> str:
    """Return the text of a scene with changes, None to remove a key; reads it again, so that it can be read."""
    tree = document.parse(scene.text, Problems(scene.source))
    if isinstance(tree.value, dict):
        tree.value = {key: node for key, node in tree.value.items() if changes.get(key, node) is not None}
    set_to = {key: value for key, value in changes.items() if value is not None}
    text = parse_scene(document.to_text(tree, scene.source), scene.source, set_to).text
    parse_scene(text, scene.source)
    return text
