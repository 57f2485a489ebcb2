"""The `body` section of a scene: mass, centre of mass, inertia, and the frames fixed to the body."""

from __future__ import annotations

import re

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import BodyError
from rb_dynamics.loads.wrench import FixedFrame, WrenchFrames
from rb_dynamics.scene.fields import Field, Rule, Section
from rb_dynamics.scene.problems import printable
from rb_dynamics.vector import Vector

INERTIA_FORMS = ("matrix", "diagonal", "principal")

_LATER_INERTIA_FORMS = ("particles", "shape", "mesh", "urdf")
_FORMS = ", ".join(INERTIA_FORMS)

_MASS = Rule("a number greater than 0 (kg)", lambda v: v > 0.0, "write the mass as a positive number")
_LENGTH = Rule("a finite number (m)")
_INERTIA = Rule("a finite number (kg m^2)")


def body_and_frames(root: Section) -> tuple[RigidBody | None, WrenchFrames]:
    """Return the body (None where it has problems) and the names of the world, body and fixed frames."""
    if root.get("body") is None:
        root.missing("body", "a section with mass and inertia", "add body: {mass: 1.0, inertia: {diagonal: [1, 1, 1]}}")
        return None, WrenchFrames()
    section = root.section("body", ("frame", "mass", "center_of_mass", "inertia", "frames"))
    center_of_mass = section.vector("center_of_mass", _LENGTH)
    world = _frame_name(root.get("world_frame"), "world")
    frame = _frame_name(section.get("frame"), "body")
    named = section.get("frame") or root.get("world_frame")
    if world == frame and named is not None:
        named.reject("different names for world_frame and body.frame", "rename one of them")
    fixed = _fixed_frames(section.get("frames"), (world, frame))
    return _body(section, center_of_mass), WrenchFrames(world, frame, fixed, center_of_mass)


def _frame_name(field: Field | None, default: str) -> str:
    if field is None:
        return default
    return field.text(
        "the name of a frame", _is_frame_name, "use letters, digits and _, without spaces and leading /", default
    )


def _is_frame_name(name: str) -> bool:
    return re.fullmatch(r"[^\s/]\S*", name) is not None and name.isprintable()


def _fixed_frames(field: Field | None, taken: tuple[str, str]) -> dict[str, FixedFrame]:
    frames = {}
    for name, frame in field.mapping("{position:, orientation:}").items() if field else ():
        if name in taken:
            frame.reject("a name that is neither the world's nor the body's", "rename the frame", f"the name {name}")
        if not _is_frame_name(name):
            frame.reject("the name of a frame", "use letters, digits and _", f"the name '{printable(name)}'")
        values = frame.section(("position", "orientation"))
        frames[name] = FixedFrame(values.vector("position", _LENGTH), values.quaternion("orientation"))
    return frames


def _body(section: Section, center_of_mass: Vector) -> RigidBody | None:
    # A wrong mass has been noted; with 1 kg in its place the inertia can be checked in the same pass.
    mass = section.number("mass", _MASS, 1.0, required=True)
    inertia = section.get("inertia")
    if inertia is None:
        section.missing(
            "inertia",
            f"one of {_FORMS} (a body without inertia, a particle, is not supported by this version)",
            "add inertia: {diagonal: [Ixx, Iyy, Izz]} (kg m^2)",
        )
        return None
    form = _inertia_form(inertia)
    if form is None:
        return None
    try:
        return _build(form, mass, center_of_mass)
    except BodyError as error:
        form.reject("the inertia of a real body", str(error))
        return None


def _inertia_form(field: Field) -> Field | None:
    """Return the one form of inertia that is given."""
    section = field.section(INERTIA_FORMS, later=_LATER_INERTIA_FORMS)
    given = [name for name in INERTIA_FORMS if name in section.values]
    if len(given) > 1:
        field.reject(f"exactly one of {_FORMS}", "remove all but one", " and ".join(given))
    elif field.node.value == {}:
        field.reject(f"exactly one of {_FORMS}", "add diagonal: [Ixx, Iyy, Izz] (kg m^2)")
    return section.get(given[0]) if len(given) == 1 else None


def _build(form: Field, mass: float, center_of_mass: Vector) -> RigidBody | None:
    """Return the body with this inertia, None where a number of it is wrong; physics raises BodyError."""
    before = form.problems.count
    if form.key.endswith(".matrix"):
        matrix = form.matrix(_INERTIA)
        if matrix is None or form.problems.count > before:
            return None
        return RigidBody.from_matrix(mass, matrix, center_of_mass)
    if form.key.endswith(".diagonal"):
        moments = form.vector(_INERTIA)
        return None if form.problems.count > before else RigidBody.from_diagonal(mass, moments, center_of_mass)
    section = form.section(("moments", "orientation"))
    if section.get("moments") is None:
        section.missing("moments", "3 principal moments (kg m^2)", "add moments: [I1, I2, I3]")
    moments, orientation = section.vector("moments", _INERTIA), section.quaternion("orientation")
    if form.problems.count > before:
        return None
    return RigidBody.from_principal(mass, moments, orientation, center_of_mass)
