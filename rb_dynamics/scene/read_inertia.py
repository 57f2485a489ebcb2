"""Read the `inertia` of a body in each of its forms, with the mass and the centre of mass.

If the scene names a file, its content replaces the name, so that the text of the scene is complete. `rb_dynamics.body`
does the physics; its errors are reported at the key.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

from rb_dynamics.body.particles import body_of_particles
from rb_dynamics.body.plausibility import Finding, examine_density, examine_reach, slip_behind
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.shapes import SHAPES, Form
from rb_dynamics.errors import BodyError, did_you_mean
from rb_dynamics.formats.yaml.document import Node, from_python, show
from rb_dynamics.formats.yaml.fields import Field, Rule, Section
from rb_dynamics.formats.yaml.problems import printable
from rb_dynamics.numerics.vector import ZERO, Vector

INERTIA_FORMS = ("matrix", "diagonal", "principal", "particles", "shape", "mesh", "urdf")
FORMS = ", ".join(INERTIA_FORMS)

MASS = Rule("a number greater than 0 (kg)", lambda v: v > 0.0, "write the mass as a positive number")
LENGTH = Rule("a finite number (m)")
_INERTIA = Rule("a finite number (kg m^2)")
_SIZE = Rule("a number greater than 0 (m)", lambda v: v > 0.0, "write a length as a positive number")
_DENSITY = Rule("a number greater than 0 (kg/m^3)", lambda v: v > 0.0, "write the density as a positive number")
_SCALE = Rule("a number greater than 0 (m per unit of the file)", lambda v: v > 0.0, "write 0.001 for a mesh in mm")

_CALCULATED = {
    "particles": "follow from the particles",
    "mesh": "follow from the mesh, the mass with its density",
    "urdf": "follow from the URDF",
}


@dataclass(frozen=True, slots=True)
class BodyReading:
    """The body, None if it has problems; suspicious properties; the source file, or "".

    `surface` is the path of a mesh and its unit in m.
    """

    body: RigidBody | None
    findings: tuple[Finding, ...] = ()
    file: str = ""
    surface: tuple[str, float] | None = None


def read_inertia(section: Section) -> BodyReading:
    """Return the body of the section `body`; problems are recorded, and a form that names a file is replaced."""
    inertia = section.get("inertia")
    if inertia is None:
        return _particle(section)
    name, form = _form(inertia)
    if form is None:
        _mass(section)
        return BodyReading(None)
    try:
        return _READERS.get(name, _stated)(form, section)
    except BodyError as error:
        # The message may quote a file; keep it on one line.
        text = printable(str(error), 2000)
        if name in _FILES:
            form.problems.add(form.node.line, form.key, text)
        else:
            form.reject("the inertia of a real body", text)
        return BodyReading(None)


def _particle(section: Section) -> BodyReading:
    """Read a body without inertia: a particle, unless `inertia` was misspelt."""
    mass = _mass(section)
    center = section.get("center_of_mass")
    if center is not None and center.vector(LENGTH) != ZERO:
        center.reject("none, since a body without inertia is a particle, located at its origin", "add body.inertia")
    return BodyReading(RigidBody.particle(mass))


def _form(field: Field) -> tuple[str, Field | None]:
    """Return the given form of inertia, by name."""
    if remedy := _form_meant(field.node):
        field.reject(f"a mapping of {FORMS}", remedy)
        return "", None
    section = field.section(INERTIA_FORMS)
    given = [name for name in INERTIA_FORMS if name in section.values]
    if len(given) > 1:
        field.reject(f"exactly one of {FORMS}", "remove all but one", " and ".join(given))
    elif field.node.value == {}:
        field.reject(f"exactly one of {FORMS}", "add diagonal: [Ixx, Iyy, Izz] (kg m^2)")
    return (given[0], section.get(given[0])) if len(given) == 1 else ("", None)


def _form_meant(node: Node) -> str:
    """Return a remedy for numbers in place of a form; "" if there are none."""
    if isinstance(node.value, list):
        form = "matrix" if any(isinstance(item.value, list) for item in node.value) else "diagonal"
        return f"name the form: {{{form}: {show(node)}}}"
    if isinstance(node.value, dict) and not {"ixx", "iyy", "izz"}.isdisjoint(map(str.lower, node.value)):
        return "write matrix: [[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]"
    return ""


def _mass(section: Section) -> float:
    # A wrong mass has been recorded; with 1 kg in its place the inertia can be checked in the same pass.
    return section.number("mass", MASS, 1.0, required=True)


def _stated(form: Field, section: Section) -> BodyReading:
    """Read a form that gives the inertia about the centre of mass: matrix, diagonal or principal."""
    mass, center_of_mass = _mass(section), section.vector("center_of_mass", LENGTH)
    return BodyReading(_build(form, mass, center_of_mass))


def _build(form: Field, mass: float, center_of_mass: Vector) -> RigidBody | None:
    """Return the body with this inertia, None if a number is wrong; impossible values raise BodyError."""
    before = form.problems.count
    if form.key.endswith(".matrix"):
        matrix = form.matrix(_INERTIA)
        if matrix is None or form.problems.count > before:
            return None
        try:
            return RigidBody.from_matrix(mass, matrix, center_of_mass)
        except BodyError as error:
            symmetric = tuple(zip(*matrix, strict=True)) == matrix
            raise BodyError(f"{error}{slip_behind(matrix) if symmetric else ''}") from error
    if form.key.endswith(".diagonal"):
        moments = form.vector(_INERTIA)
        return None if form.problems.count > before else RigidBody.from_diagonal(mass, moments, center_of_mass)
    values = form.section(("moments", "orientation"))
    if values.get("moments") is None:
        values.missing("moments", "3 principal moments (kg m^2)", "add moments: [I1, I2, I3]")
    moments, orientation = values.vector("moments", _INERTIA), values.quaternion("orientation")
    if form.problems.count > before:
        return None
    return RigidBody.from_principal(mass, moments, orientation, center_of_mass)


def _particles(form: Field, section: Section) -> BodyReading:
    before = form.problems.count
    _refuse(section, ("mass", "center_of_mass"), "particles")
    masses, positions = [], []
    example = "write a list such as [{mass: 1.0, position: [0, 0, 1]}, ...]"
    for item in form.items("a list of particles", example):
        particle = item.section(("mass", "position"))
        masses.append(particle.number("mass", MASS, 1.0, required=True))
        if particle.get("position") is None:
            particle.missing("position", "3 numbers (m)", "add position: [x, y, z], from the body origin")
        positions.append(particle.vector("position", LENGTH))
    return BodyReading(None if form.problems.count > before else body_of_particles(masses, positions))


def _shape(form: Field, section: Section) -> BodyReading:
    before = form.problems.count
    kind, shape = _shape_form(form)
    if shape is None:
        return BodyReading(None)
    values = form.section(("type", *shape.dimensions, "density", "orientation"))
    dimensions = [_dimension(values, name, kind) for name in shape.dimensions]
    orientation, center_of_mass = values.quaternion("orientation"), section.vector("center_of_mass", LENGTH)
    mass, density = _mass_or_density(section, values)
    if form.problems.count > before:
        return BodyReading(None)
    made = shape.make(*dimensions)
    mass = mass or made.mass(density)
    body = made.body(mass, center_of_mass, orientation)
    finding = None if made.volume is None else examine_density(mass, made.volume)
    return BodyReading(body, (finding,) if finding else ())


def _shape_form(form: Field) -> tuple[str, Form | None]:
    """Return the name of the shape and its keys; None if it is unknown."""
    value = form.node.value
    if not isinstance(value, dict) or "type" not in value:
        shape = Section(form, value if isinstance(value, dict) else {})
        expected = f"a shape with type: one of {', '.join(SHAPES)}"
        if isinstance(value, dict):
            shape.missing("type", expected, "add the type, such as type: box, size: [1, 2, 3]")
        else:
            form.reject(expected, "write {type: box, size: [1, 2, 3]}")
        return "", None
    field = Field(value["type"], f"{form.key}.type", form.problems)
    text = field.node.value if isinstance(field.node.value, str) else ""
    remedy = did_you_mean(text.lower(), SHAPES, "choose one of them, or give a mesh")
    kind = field.text(f"one of {', '.join(SHAPES)}", SHAPES.__contains__, remedy, "")
    return kind, SHAPES.get(kind)


def _dimension(values: Section, name: str, kind: str) -> float | Vector:
    field = values.get(name)
    vector = SHAPES[kind].vector
    if field is None:
        remedy = f"add {name}: [x, y, z]" if vector else f"add the key {name}"
        if kind == "rod" and name == "radius":
            remedy = "add the key radius: a rod without thickness has no moment about its own axis, so that its spin "
            remedy += "about it is not defined"
        values.missing(name, "3 numbers greater than 0 (m)" if vector else _SIZE.expected, remedy)
        return 1.0
    return field.vector(_SIZE) if vector else field.number(_SIZE, 1.0)


def _mesh(form: Field, section: Section) -> BodyReading:
    before = form.problems.count
    values = form.section(("file", "density", "scale"))
    _refuse(section, ("center_of_mass",), "mesh")
    name, path = _file(values, "a mesh (STL, OBJ or PLY)")
    mass, density = _mass_or_density(section, values)
    scale = values.number("scale", _SCALE, 1.0)
    if form.problems.count > before:
        return BodyReading(None)
    # numpy is slow to import, and few scenes have a mesh.
    from rb_dynamics.body.mesh import read_solid

    solid = read_solid(path, scale)
    mass = mass or density * solid.volume
    findings = [examine_density(mass, solid.volume)]
    if solid.inside_out:
        remedy = "the result is correct; orient the mesh outwards for other programs"
        findings.append(Finding("inside-out", f"the triangles of {name} point inwards", "they were turned", remedy))
    if solid.unchecked:
        why, remedy = "too many of its triangles are close to each other", "check that in the program that made it"
        findings.append(Finding("unchecked", f"not checked whether {name} crosses itself", why, remedy))
    reading = _resolved(form, section, solid.body(mass), tuple(f for f in findings if f), name)
    return replace(reading, surface=(path, scale))


def _urdf(form: Field, section: Section) -> BodyReading:
    before = form.problems.count
    values = form.section(("file", "link"))
    _refuse(section, ("mass", "center_of_mass"), "urdf")
    name, path = _file(values, "a URDF file")
    link = values.get("link")
    if link is None:
        values.missing("link", "the name of a link", "add link: base_link")
    text = "" if link is None else link.text("the name of a link", bool, "write the name of a link of the URDF", "")
    if form.problems.count > before:
        return BodyReading(None)
    from rb_dynamics.body.urdf import read_urdf

    inertial = read_urdf(path, text)
    finding = None if inertial.reach is None else examine_reach(inertial.body, inertial.reach)
    return _resolved(form, section, inertial.body, (*inertial.findings, *((finding,) if finding else ())), name)


def _file(values: Section, what: str) -> tuple[str, str]:
    """Return the file as written, and its path; a relative one is relative to the scene file."""
    field = values.get("file")
    if field is None:
        values.missing("file", f"the path of {what}", "add file: with a path relative to the scene file")
        return "", ""
    name = field.text(
        f"the path of {what}, relative to the scene file",
        lambda path: path.isprintable() and path.strip() != "" and "://" not in path,
        "URLs (package:// among them) are not followed, write a path on this machine",
        "",
    )
    return name, os.path.join(os.path.dirname(field.problems.source), name)


def _refuse(section: Section, names: tuple[str, ...], form: str) -> None:
    """Record a problem for keys that must not be given with `form`, which defines the same."""
    given = [name for name in names if name in section.values]
    if given:
        field = section.get(given[0])
        assert field is not None
        keys = " and ".join(f"body.{name}" for name in given)
        expected = f"no {' and no '.join(names)} beside inertia.{form}: they {_CALCULATED[form]}"
        field.reject(expected, f"remove {keys}", keys)


def _mass_or_density(section: Section, values: Section) -> tuple[float, float]:
    """Return (mass, density); exactly one is given and the other 0."""
    mass, density = section.get("mass"), values.get("density")
    if mass is not None and density is not None:
        density.reject("one of body.mass and density", "remove one of them", "a density beside body.mass")
    elif mass is None and density is None and isinstance(values.field.node.value, dict):
        section.missing("mass", f"{MASS.expected}, or a density in {values.field.key}", "add one of them")
    return (
        mass.number(MASS, 1.0) if mass else 0.0,
        density.number(_DENSITY, 1.0) if density else 0.0,
    )


def _resolved(form: Field, section: Section, body: RigidBody, findings: tuple[Finding, ...], name: str) -> BodyReading:
    """Return the body as defined by the scene's text after the file's content has been inserted."""
    mass, center = body.mass, body.center_of_mass
    if RigidBody.from_matrix(mass, body.inertia, center) == body:
        kind, value = "matrix", from_python(body.inertia)
    else:
        axes = dict(zip("xyzw", body.principal_orientation_xyzw, strict=True))
        kind, value = "principal", from_python({"moments": body.principal_moments, "orientation": axes})
    section.values.update(
        mass=from_python(mass), center_of_mass=from_python(center), inertia=Node({kind: value})
    )  # fmt: skip
    again = _build(Field(value, f"body.inertia.{kind}", form.problems), mass, center)
    return BodyReading(again, findings, name)


_FILES = ("mesh", "urdf")

_READERS = {"particles": _particles, "shape": _shape, "mesh": _mesh, "urdf": _urdf}
