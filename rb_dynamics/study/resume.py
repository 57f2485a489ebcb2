"""`scene_at`: a scene that goes on from a time of a log, with the same bits.

The log is run again up to that time. The new scene begins with the state there, to the last bit, and says in
`continues` from what run it comes: its first state and the commands until then. When the scene is run, the earlier part
is computed again but not output; so the method and the totals of work and impulse go on too, and every later number is
that of the run.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rb_dynamics.body.state import State
from rb_dynamics.errors import LogError, SceneError, WrenchError
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.formats.mcap_records import Message
from rb_dynamics.formats.messages import SET_STATE
from rb_dynamics.formats.own_log import received_commands, row_columns, rows, scene_and_names
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.numerics.rotation import rotate_inverse
from rb_dynamics.run.provenance import RESULT
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.scene.model import Past, Scene
from rb_dynamics.scene.read import parse_scene


@dataclass(frozen=True)
class SceneAt:
    """A scene that goes on from a log.

    Attributes:
        text: YAML.
        notes: what it does not take along; empty if it goes on with the same bits.
        channels: whether it has any for commands.
    """

    text: str
    notes: tuple[str, ...]
    channels: bool


def scene_at(log: str | os.PathLike[str], time_ns: int) -> SceneAt:
    """Return a scene whose time 0 is `time_ns` of a log of this package.

    Its commands are those that it is given: with `--wrench LOG --wrench-start T` those of the log. What is held at
    that time goes on without them.

    Raises:
        LogError: it is no log of this package, does not reach `time_ns`, the body was moved from outside before, or the
            scene has actuators.
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
    # What is not finite was rejected, and no scene can say it.
    received = [
        (topic, wrench, at)
        for topic, wrench, at in received_commands(scene, names, iter(messages))
        if at < time_ns and np.isfinite((*wrench.force, *wrench.torque)).all()
    ]
    state = _state_at(scene, received, time_ns)
    end_ns, notes = scene.end_ns, []
    if logged is not None and not _agrees(state, logged):
        raise LogError(
            f"{source.path}: run again, it comes to another state at {time_ns / 1e9:.9g} s than it has there, expected "
            "the same bits: it was made on another platform or by another version; replay says what differs"
        )
    changes: dict[str, object] = {"initial": _initial(state)}
    if end_ns is not None:
        changes["duration"] = (end_ns - time_ns) / 1e9
    elif (ended := source.metadata.get(RESULT, {}).get("end_time_ns")) is not None:
        notes.append(f"the run had no duration; it was stopped after {int(ended) / 1e9:.9g} s")
    if end_ns == time_ns:
        raise LogError(f"--at: found {time_ns / 1e9:.9g} s, which is the end of the run; give an earlier time")
    if scene.sensors:
        notes.append("sensors begin anew: their noise is not that of the run")
    try:
        return SceneAt(
            _text(scene, changes | {"continues": _past(scene, received, time_ns)}), tuple(notes), bool(scene.channels)
        )
    except SceneError:
        if not received:
            raise
    notes.append(
        f"{len(received)} commands before it are too many for a scene: it begins with the state of the run, but method "
        "and books begin anew, so that later bits differ"
    )
    return SceneAt(_text(scene, changes), tuple(notes), bool(scene.channels))


def _require_possible(path: Path, scene: Scene, messages: Sequence[Message], time_ns: int, last_ns: int) -> None:
    """Refuse what no scene can go on from.

    Raises:
        LogError: says what it is.
    """
    name, kind = SET_STATE
    moves = [each for each in messages if each.channel.type_name == kind and each.channel.topic.endswith(f"/{name}")]
    moved = any(each.log_time < time_ns for each in moves)
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
            f"{path} has actuators, whose commands and speeds no scene takes over, expected a body without; run "
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


def _past(scene: Scene, commands: list[tuple[str, Wrench, int]], time_ns: int) -> dict[str, object]:
    """Return the run until `time_ns`, with what came before the scene itself."""
    before = scene.past or Past(0, scene.initial, scene.duration)
    all_commands = [*before.commands, *((topic, wrench, at + before.length_ns) for topic, wrench, at in commands)]
    duration = {} if before.duration is None else {"duration": before.duration}
    return {
        "after_ns": before.length_ns + time_ns,
        **duration,
        "initial": _initial(before.initial),
        "commands": [[at, topic, wrench.frame_id, *wrench.force, *wrench.torque] for topic, wrench, at in all_commands],
    }


def _text(scene: Scene, changes: Mapping[str, object]) -> str:
    """Return the text of a scene with changes; reads it again, so that what is returned can be read."""
    text = parse_scene(scene.text, scene.source, changes).text
    parse_scene(text, scene.source)
    return text
