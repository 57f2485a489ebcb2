"""The `effects` section of a scene: what acts beside commanded wrenches. One reader for each type, by name."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError, WrenchError
from rb_dynamics.loads.central_gravity import CentralGravity
from rb_dynamics.loads.drag import LinearDrag, QuadraticDrag
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.rotor import Rotor
from rb_dynamics.loads.scheduled_wrench import ScheduledWrench
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.loads.wrench import Wrench, WrenchFrames
from rb_dynamics.scene.fields import LONGEST, Field, Rule, Section
from rb_dynamics.scene.problems import printable
from rb_dynamics.vector import ZERO, Vector

_ACCELERATION = Rule("a finite number (m/s^2)")
_LENGTH = Rule("a finite number (m)")
_VELOCITY = Rule("a finite number (m/s)")
_FORCE, _TORQUE = Rule("a finite number (N)"), Rule("a finite number (N m)")
_MU = Rule("a number greater than 0 (m^3/s^2)", lambda v: v > 0.0, "write mu = G M, for the Earth 3.986004418e14")
_COEFFICIENT = Rule("a number of 0 or more", lambda v: v >= 0.0, "drag takes energy out: write it without a sign")
_AXIAL = Rule("a number greater than 0 (kg m^2)", lambda v: v > 0.0, "write the rotor's inertia about its own axis")
_RATE = Rule("a finite number (rad/s)")
_TIME = Rule(f"a number from 0 to {LONGEST:.1e} (s)", lambda v: 0.0 <= v <= LONGEST, "write the time since the start")


class _Entry(NamedTuple):
    """One entry of the list, with what its numbers are checked against."""

    section: Section
    body: RigidBody | None
    frames: WrenchFrames

    @property
    def is_particle(self) -> bool:
        return self.body is not None and self.body.is_particle


_Reader = Callable[[_Entry], Effect]


def effects(field: Field | None, body: RigidBody | None, frames: WrenchFrames) -> tuple[Effect, ...]:
    """Return the effects in the order of the scene, none where the section is absent; notes what is wrong."""
    if field is None:
        return ()
    found = []
    for entry in field.items("a list of effects", "write a list such as [{type: uniform_gravity, ...}], or []"):
        kind = _kind(entry)
        if kind is not None:
            keys, read = _READERS[kind]
            before = entry.problems.count
            try:
                effect = read(_Entry(entry.section(("type", *keys)), body, frames))
                if body is not None:
                    effect.check(body)
                found.append(effect)
            except SceneError as error:
                if entry.problems.count == before:
                    entry.reject("an effect that can act on this body", str(error))
    return tuple(found)


def _kind(entry: Field) -> str | None:
    known = ", ".join(_READERS)
    values = entry.node.value
    node = values.get("type") if isinstance(values, dict) else None
    if node is None:
        entry.reject("a mapping with the key type", f"write {{type: ...}} with one of {known}")
        return None
    name = node.value if isinstance(node.value, str) else ""
    if name in _READERS:
        return name
    near = difflib.get_close_matches(printable(name), _READERS, n=1, cutoff=0.5)
    remedy = f"did you mean {near[0]}?" if near else "write one of them, or remove the entry"
    Field(node, f"{entry.key}.type", entry.problems).reject(f"one of {known}", remedy)
    return None


def _required(section: Section, name: str, rule: Rule) -> Vector:
    if section.get(name) is None:
        section.missing(name, f"a list of 3 numbers, each {rule.expected}", f"add {name}: [x, y, z]")
    return section.vector(name, rule)


def _uniform_gravity(entry: _Entry) -> Effect:
    return UniformGravity(_required(entry.section, "acceleration_world", _ACCELERATION), entry.frames.world_frame)


def _central_gravity(entry: _Entry) -> Effect:
    section = entry.section
    gradient = section.get("gravity_gradient")
    return CentralGravity(
        section.number("gravitational_parameter", _MU, 1.0, required=True),
        section.vector("center_world", _LENGTH),
        gradient is not None and gradient.flag(default=False),
    )


def _drag(kind: type[LinearDrag] | type[QuadraticDrag]) -> _Reader:
    def read(entry: _Entry) -> Effect:
        section = entry.section
        translation, rotation = (_coefficients(section.get(name)) for name in ("translation", "rotation"))
        if not ({"translation", "rotation"} & section.values.keys()):
            section.field.reject("at least one of translation and rotation", "add translation: or rotation:")
        turning = section.get("rotation")
        if turning is not None and rotation != ZERO and entry.is_particle:
            turning.reject("none, as a body without inertia is a particle and does not turn", "remove it")
        return kind(translation, rotation, section.vector("medium_velocity_world", _VELOCITY))

    return read


def _coefficients(field: Field | None) -> Vector:
    """Return one coefficient for each body axis; a single number is for all of them."""
    if field is None:
        return ZERO
    if isinstance(field.node.value, list):
        return field.vector(_COEFFICIENT)
    value = field.number(_COEFFICIENT, 0.0)
    return (value, value, value)


def _rotor(entry: _Entry) -> Effect:
    section = entry.section
    if entry.is_particle:
        section.field.reject("no rotor, as a body without inertia is a particle", "add body.inertia or remove it")
    axis = _required(section, "axis_body", Rule("a finite number"))
    given = section.get("axis_body")
    if given is not None and axis == ZERO:
        given.reject("a direction, not zero", "write the rotor's axis, such as [0, 0, 1]")
    inertia = section.number("axial_inertia", _AXIAL, 1.0, required=True)
    rate = section.get("spin_rate")
    if rate is None:
        section.missing("spin_rate", _RATE.expected + " or a list of {time:, rate:}", "add spin_rate: 100")
        return Rotor((0.0, 0.0, 1.0), inertia, ((0.0, 0.0),))
    knots = _knots(rate) if isinstance(rate.node.value, list) else ((0.0, rate.number(_RATE, 0.0)),)
    return Rotor(axis if axis != ZERO else (0.0, 0.0, 1.0), inertia, knots)


def _knots(field: Field) -> tuple[tuple[float, float], ...]:
    entries = [item.section(("time", "rate")) for item in field.items("a list", "write {time:, rate:} entries")]
    knots = [
        (e.number("time", _TIME, 0.0, required=True), e.number("rate", _RATE, 0.0, required=True)) for e in entries
    ]
    _in_order(field, [time for time, _ in knots])
    return tuple(knots) or ((0.0, 0.0),)


def _scheduled_wrench(entry: _Entry) -> Effect:
    section = entry.section
    schedule = section.get("schedule")
    if schedule is None:
        section.missing("schedule", "a list of wrenches", "add schedule: [{time: 0, force: [0, 0, 1]}]")
        return ScheduledWrench(())
    frame = section.get("frame_id")
    frame_id = "" if frame is None else frame.text("the name of a frame", lambda _: True, "write a name", "")
    entries = []
    for item in schedule.items("a list of wrenches", "write [{time: 0, force: [0, 0, 1], torque: [0, 0, 0]}]"):
        values = item.section(("time", "force", "torque"))
        time = values.number("time", _TIME, 0.0, required=True)
        wrench = Wrench(values.vector("force", _FORCE), values.vector("torque", _TORQUE), frame_id)
        entries.append((time, wrench))
        if entry.body is not None:
            try:
                entry.frames.hold(wrench)
            except WrenchError as error:
                item.reject("a wrench that can act", str(error))
    _in_order(schedule, [time for time, _ in entries])
    return ScheduledWrench(tuple(entries))


def _in_order(field: Field, times: list[float]) -> None:
    if not times:
        field.reject("at least one entry", "add one, or remove the effect")
    if any(later <= earlier for earlier, later in pairwise(times)):
        field.reject("times that grow from entry to entry", "sort the entries and give each its own time", str(times))


_READERS: Mapping[str, tuple[tuple[str, ...], _Reader]] = MappingProxyType(
    {
        UniformGravity.kind: (("acceleration_world",), _uniform_gravity),
        CentralGravity.kind: (("gravitational_parameter", "center_world", "gravity_gradient"), _central_gravity),
        LinearDrag.kind: (("translation", "rotation", "medium_velocity_world"), _drag(LinearDrag)),
        QuadraticDrag.kind: (("translation", "rotation", "medium_velocity_world"), _drag(QuadraticDrag)),
        Rotor.kind: (("axis_body", "axial_inertia", "spin_rate"), _rotor),
        ScheduledWrench.kind: (("frame_id", "schedule"), _scheduled_wrench),
    }
)

EFFECT_TYPES = tuple(_READERS)
"""Every `type` of effect there is."""
