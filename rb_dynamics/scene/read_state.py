"""Read states of a scene: where it begins (`initial`), and the run that it continues (`continues`)."""

from __future__ import annotations

import math

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.formats.yaml.fields import Field, Rule, Section
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.numerics.nanoseconds import LONGEST, SHORTEST
from rb_dynamics.numerics.rotation import rotate
from rb_dynamics.numerics.vector import ZERO
from rb_dynamics.scene.model import Past

INITIAL_KEYS = (
    "position_world", "orientation", "linear_velocity_world", "linear_velocity_body", "angular_velocity_body",
)  # fmt: skip
_PAST_KEYS = ("after_ns", "duration", "initial", "commands")

_POSITION = Rule("a finite number (m)")
_VELOCITY = Rule("a finite number (m/s)")
_ANGULAR_VELOCITY = Rule("a finite number (rad/s)")
_DURATION = Rule(f"a number from {SHORTEST:g} to {LONGEST:.1e} (s)")
_NANOSECONDS = Rule(
    "a whole number of nanoseconds, 0 or more", lambda v: v >= 0.0 and v == math.floor(v), "write the time in ns"
)
_NUMBER = Rule("a finite number")
_COMMAND = "[time_ns, channel, frame_id, force x, y, z, torque x, y, z]"


def initial_state(section: Section, body: RigidBody | None) -> State:
    """Return the state in a section of `INITIAL_KEYS`."""
    omega = section.vector("angular_velocity_body", _ANGULAR_VELOCITY)
    turning = section.get("angular_velocity_body")
    if turning is not None and omega != ZERO and body is not None and body.is_particle:
        turning.reject(
            "no angular velocity, since a body without inertia is a particle", "add body.inertia or remove it"
        )
    orientation = section.quaternion("orientation")
    velocity = section.vector("linear_velocity_world", _VELOCITY)
    in_body = section.get("linear_velocity_body")
    if in_body is not None:
        if section.get("linear_velocity_world") is not None:
            in_body.reject("one of linear_velocity_world and linear_velocity_body", "remove the other", "both")
        velocity = rotate(orientation, in_body.vector(_VELOCITY))
    return State(
        time_ns=0,
        position_world=section.vector("position_world", _POSITION),
        orientation_xyzw=orientation,
        linear_velocity_world=velocity,
        angular_velocity_body=omega,
    )


def past(field: Field | None, body: RigidBody | None) -> Past | None:
    """Return the run that the scene continues; None if it begins by itself."""
    if field is None:
        return None
    section = field.section(_PAST_KEYS)
    length_ns = section.whole("after_ns", _NANOSECONDS, 0, required=True)
    duration = section.get("duration")
    commands = section.get("commands")
    rows = [] if commands is None else commands.items("a list of commands", f"write each as {_COMMAND}")
    found = [_command(row) for row in rows]
    return Past(
        length_ns,
        initial_state(section.section("initial", INITIAL_KEYS), body),
        None if duration is None else duration.number(_DURATION, 1.0),
        tuple(command for command in found if command is not None),
    )


def _command(field: Field) -> tuple[str, Wrench, int] | None:
    cells = field.items("a command", f"write {_COMMAND}")
    if len(cells) != 9:
        field.reject("a command", f"write {_COMMAND}")
        return None
    channel, frame = (cell.text("a name", lambda _: True, "write the name in quotes", "") for cell in cells[1:3])
    time_ns = cells[0].whole(_NANOSECONDS, 0)
    fx, fy, fz, tx, ty, tz = (cell.number(_NUMBER, 0.0) for cell in cells[3:])
    return channel, Wrench((fx, fy, fz), (tx, ty, tz), frame, time_ns), time_ns
