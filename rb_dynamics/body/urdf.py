"""Mass properties from a URDF file: the <inertial> of one link, in the axes of the link.

The products of <inertia> are the entries of the matrix (ixy = -int xy dm), about the centre of mass and in the axes
of <inertial>'s <origin>, whose rpy are rotations about the fixed axes x, y and z in this order. Entities are not
expanded, files that the URDF names are not opened, and joints are ignored.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.parsers import expat

from rb_dynamics.body.description_files import read_bounded
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import BodyError
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.decimals import real_number
from rb_dynamics.numerics.rotation import IDENTITY, Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector, norm, subtract

MAX_BYTES = 4 << 20

_ENTRIES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True, slots=True)
class Inertial:
    """What a URDF says about a link.

    Attributes:
        body: mass properties in the axes of the link, which become the body axes.
        reach: distance (m) of the farthest point of the link's boxes, cylinders and spheres (its <collision>, else its
            <visual>) from the centre of mass, at most; None where there are none.
    """

    body: RigidBody
    reach: float | None


def read_urdf(path: str | os.PathLike[str], link: str) -> Inertial:
    """Return the mass properties of the link named `link`.

    Raises:
        BodyError: it is no such file, has no such link, or the link has no valid <inertial>.
    """
    return parse_urdf(read_bounded(path, MAX_BYTES, "a URDF file"), link, os.fspath(path))


def parse_urdf(data: bytes, link: str, source: str = "<urdf>") -> Inertial:
    """Return the mass properties of the link named `link` in the URDF `data`.

    Raises:
        BodyError: as `read_urdf`.
    """
    root = _parse(data, source)
    element = _link(root, link, source)
    inertial = element.find("inertial")
    place = f"{source}: link {link!r}"
    if inertial is None:
        raise BodyError(
            f"{place} has no <inertial>, expected one with <mass> and <inertia>; choose another link or add it"
        )
    position, turn = _origin(inertial, place)
    mass = _number(_child(inertial, "mass", place), "value", place)
    entries = _child(inertial, "inertia", place)
    xx, xy, xz, yy, yz, zz = (_number(entries, name, place) for name in _ENTRIES)
    try:
        own = RigidBody.from_matrix(mass, ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)), position)
    except BodyError as error:
        raise BodyError(f"{place}: {error}") from error
    # From the moments, not from R I R^T: so that a needle's small moment survives any rpy.
    body = own
    if turn != IDENTITY:
        axes = rotation.multiply(turn, own.principal_orientation_xyzw)
        body = RigidBody.from_principal(mass, own.principal_moments, axes, position)
    return Inertial(body, _reach(element, position, place))


def _parse(data: bytes, source: str) -> ElementTree.Element:
    """Return the root element; a document type, and with it any entity, is refused before anything is expanded."""

    def refuse(*_: object) -> None:
        raise BodyError(f"{source}: found <!DOCTYPE ...>, expected a URDF without one; remove the document type")

    guard = expat.ParserCreate()
    guard.StartDoctypeDeclHandler = refuse
    try:
        guard.Parse(data, True)
        return ElementTree.fromstring(data)
    except (expat.ExpatError, ElementTree.ParseError, ValueError, LookupError) as error:
        hint = "run xacro on it first" if b"xacro" in data[:4096] else "check that this is a URDF file"
        raise BodyError(f"{source}: found no XML ({error}), expected a URDF file; {hint}") from error


def _link(root: ElementTree.Element, link: str, source: str) -> ElementTree.Element:
    links = {element.get("name", ""): element for element in root.findall("link")}
    if link in links:
        return links[link]
    known = ", ".join(repr(name[:60]) for name in list(links)[:20]) or "the links of a <robot>, which are none here"
    raise BodyError(f"{source}: found no link {link!r}, expected one of {known}; correct the name")


def _child(element: ElementTree.Element, name: str, place: str) -> ElementTree.Element:
    child = element.find(name)
    if child is None:
        raise BodyError(f"{place} has no <{name}> in <{element.tag}>, expected one; add it")
    return child


def _number(element: ElementTree.Element, name: str, place: str) -> float:
    return _numbers(element, name, 1, place)[0]


def _numbers(element: ElementTree.Element, name: str, count: int, place: str) -> list[float]:
    text = element.get(name)
    try:
        numbers = [real_number(word) for word in (text or "").split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise BodyError(
            f"{place}: {name} of <{element.tag}> is {None if text is None else text[:60]!r}, expected {count} finite "
            f"number{'s' if count > 1 else ''} separated by spaces; correct it, or run xacro on the file first"
        )
    return numbers


def _origin(element: ElementTree.Element, place: str) -> tuple[Vector, Quaternion]:
    """Return the position and the axes of <origin xyz= rpy=>; what is absent is zero."""
    origin = element.find("origin")
    if origin is None:
        return ZERO, IDENTITY
    x, y, z = _numbers(origin, "xyz", 3, place) if "xyz" in origin.attrib else ZERO
    roll, pitch, yaw = _numbers(origin, "rpy", 3, place) if "rpy" in origin.attrib else ZERO
    return (x, y, z), roll_pitch_yaw(roll, pitch, yaw)


def roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the rotation by `roll` about x, then `pitch` about y, then `yaw` about z (rad), all fixed axes."""
    if roll == pitch == yaw == 0.0:
        return IDENTITY
    turns = (rotation.exp((0.0, 0.0, yaw)), rotation.exp((0.0, pitch, 0.0)), rotation.exp((roll, 0.0, 0.0)))
    return rotation.multiply(rotation.multiply(turns[0], turns[1]), turns[2])


def _reach(link: ElementTree.Element, center: Vector, place: str) -> float | None:
    """Return a bound on the distance of the link's boxes, cylinders and spheres from `center`."""
    for kind in ("collision", "visual"):
        found = []
        for element in link.findall(kind):
            half = _half_diagonal(element.find("geometry"), place)
            if half is not None:
                position, _ = _origin(element, place)
                found.append(norm(subtract(position, center)) + half)
        # A mesh beside them could reach farther; then nothing can be said.
        if found and len(found) == len(link.findall(kind)):
            return max(found)
    return None


def _half_diagonal(geometry: ElementTree.Element | None, place: str) -> float | None:
    if geometry is None:
        return None
    for shape in geometry:
        if shape.tag == "box":
            return 0.5 * math.hypot(*_numbers(shape, "size", 3, place))
        if shape.tag == "cylinder":
            return math.hypot(_number(shape, "radius", place), 0.5 * _number(shape, "length", place))
        if shape.tag == "sphere":
            return _number(shape, "radius", place)
    return None
