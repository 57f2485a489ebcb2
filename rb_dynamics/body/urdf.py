"""Mass properties from a URDF file: one link with all that is joined to it by fixed joints, in the axes of the link.

Simulators of robots join such links too (sdformat calls it fixed joint reduction), except through a link `world`. What
is attached by joints of other types is left out, and named.

The products of <inertia> are the entries of the matrix (ixy = -int xy dm), about the centre of mass and in the axes
of <inertial>'s <origin>, whose rpy are rotations about the fixed axes x, y and z in this order. Entities are not
expanded, and files that the URDF names are not opened.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import NamedTuple
from xml.etree import ElementTree
from xml.parsers import expat

from rb_dynamics.body import particles
from rb_dynamics.body.body_files import read_bounded
from rb_dynamics.body.plausibility import Finding
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import BodyError
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.number_parsing import is_decimal, real_number
from rb_dynamics.numerics.rotation import IDENTITY, Matrix, Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector, add, norm, scale, subtract

MAX_BYTES = 4 << 20

_WORLD = "world"
_SHOWN = 20

_ENTRIES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True, slots=True)
class Inertial:
    """What a URDF says about a link.

    Attributes:
        body: mass properties in the axes of the link, which become the body axes, of all links that are fixed to it.
        reach: distance (m) of the farthest point of the links' boxes, cylinders and spheres (their <collision>, else
            their <visual>) from the centre of mass, at most; None where a link with a mass has others, or none.
        findings: which links are counted too, and which are not.
    """

    body: RigidBody
    reach: float | None
    findings: tuple[Finding, ...] = ()


class _Pose(NamedTuple):
    """A pose: of a link, or of something in its axes."""

    position: Vector
    orientation_xyzw: Quaternion

    def of(self, inner: _Pose) -> _Pose:
        """Return the pose of `inner`, which is given in these axes."""
        if self == _HERE:
            return inner
        return _Pose(
            add(self.position, rotation.rotate(self.orientation_xyzw, inner.position)),
            rotation.multiply(self.orientation_xyzw, inner.orientation_xyzw),
        )

    def inverse(self) -> _Pose:
        """Return the pose of the outer axes in these."""
        back = rotation.conjugate(self.orientation_xyzw)
        return _Pose(scale(-1.0, rotation.rotate(back, self.position)), back)


_HERE = _Pose(ZERO, IDENTITY)


def read_urdf(path: str | os.PathLike[str], link: str) -> Inertial:
    """Return the mass properties of the link named `link`, with everything fixed to it.

    Raises:
        BodyError: it is no such file, has no such link, or the links have no valid <inertial>.
    """
    return parse_urdf(read_bounded(path, MAX_BYTES, "a URDF file"), link, os.fspath(path))


def parse_urdf(data: bytes, link: str, source: str = "<urdf>") -> Inertial:
    """Return the mass properties of the link named `link` in the URDF `data`, with everything fixed to it.

    Raises:
        BodyError: as `read_urdf`.
    """
    root = _parse(data, source)
    if any(each.tag.startswith("{") and "xacro" in each.tag.partition("}")[0] for each in root.iter()):
        raise BodyError(f"{source}: found elements of xacro, which may add links, expected URDF; run xacro on it first")
    links = _links(root, source)
    poses = _fixed(root, links, _link(links, link, source), source)
    heavy = [name for name in poses if _has_mass(links[name])]
    if heavy in ([], [link]):
        place = f"{source}: link {link!r}"
        body = _body(links[link], poses[link], place)
    else:
        body = _together([_part(links[name], poses[name], f"{source}: link {name!r}") for name in heavy], source, link)
    reaches = [_reach(links[name], poses[name], body.center_of_mass, f"{source}: link {name!r}") for name in heavy]
    found = [reach for reach in reaches if reach is not None]
    reach = max(found) if found and len(found) == len(reaches) else None
    return Inertial(body, reach, _findings(links, link, heavy, poses))


def _body(element: ElementTree.Element, pose: _Pose, place: str) -> RigidBody:
    """Return the <inertial> of a link that has `pose`."""
    inertial = _only(element, "inertial", place)
    if inertial is None:
        raise BodyError(
            f"{place} has no <inertial>, expected one with <mass> and <inertia>, there or in a link that is fixed to "
            "it; choose another link or add it"
        )
    position, turn = pose.of(_origin(inertial, place))
    mass = _number(_child(inertial, "mass", place), "value", place)
    entries = _inertia(inertial, place)
    try:
        own = RigidBody.from_matrix(mass, entries, position)
    except BodyError as error:
        raise BodyError(f"{place}: {error}") from error
    # From the moments, not from R I R^T: so that a needle's small moment survives any rpy.
    if turn == IDENTITY:
        return own
    axes = rotation.multiply(turn, own.principal_orientation_xyzw)
    return RigidBody.from_principal(mass, own.principal_moments, axes, position)


def _inertia(inertial: ElementTree.Element, place: str) -> Matrix:
    entries = _child(inertial, "inertia", place)
    xx, xy, xz, yy, yz, zz = (_number(entries, name, place) for name in _ENTRIES)
    return ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))


_Part = tuple[float, Vector, Matrix]
"""Mass, centre of mass, and inertia about that."""


def _part(element: ElementTree.Element, pose: _Pose, place: str) -> _Part:
    """Return the contribution of one link of several, which may be a point without inertia."""
    inertial = _child(element, "inertial", place)
    if any(map(any, _inertia(inertial, place))):
        body = _body(element, pose, place)
        return body.mass, body.center_of_mass, body.inertia
    mass = _number(_child(inertial, "mass", place), "value", place)
    if mass < 0.0:
        raise BodyError(f"{place}: mass is {mass!r}, expected a number greater than 0 (kg); correct it")
    return mass, pose.of(_origin(inertial, place)).position, (ZERO, ZERO, ZERO)


def _together(parts: list[_Part], source: str, link: str) -> RigidBody:
    """Return the body of all parts: the inertia of each about its own centre, and that of their masses there."""
    masses, centers, inertias = [list(column) for column in zip(*parts, strict=True)]
    try:
        of_centers = particles.inertia_matrix(masses, centers)
        rows = [[math.fsum([of_centers[i][k], *(own[i][k] for own in inertias)]) for k in range(3)] for i in range(3)]
        return RigidBody.from_matrix(particles.total_mass(masses), rows, particles.center_of_mass(masses, centers))
    except (BodyError, OverflowError, ValueError) as error:
        raise BodyError(f"{source}: link {link!r} with what is fixed to it: {error}") from error


def _has_mass(element: ElementTree.Element) -> bool:
    """Return whether a link has an <inertial> that is not zero throughout, as those of links that are frames are."""
    inertial = element.find("inertial")
    if inertial is None:
        return False
    mass, entries = inertial.find("mass"), inertial.find("inertia")
    texts = ["" if mass is None else mass.get("value", "")]
    texts += ["" if entries is None else entries.get(name, "") for name in _ENTRIES]
    return not all(is_decimal(text.strip()) and float(text) == 0.0 for text in texts)


def _findings(
    links: dict[str, ElementTree.Element], link: str, heavy: list[str], poses: dict[str, _Pose]
) -> tuple[Finding, ...]:
    """Return which links of the robot count, where it has several with a mass."""
    counted = [name for name in heavy if name != link]
    left = [name for name, element in links.items() if name not in poses and _has_mass(element)]
    findings = []
    if counted:
        why = "they move with it as one body"
        remedy = "nothing is wrong; a joint that gives way has another type than fixed"
        findings.append(Finding("fixed-links", f"link {link!r} has {_named(links, counted)} fixed to it", why, remedy))
    if left:
        why = "not joined to it by fixed joints, they are no part of this one body"
        remedy = "make their joints fixed to count them"
        findings.append(Finding("other-links", f"left out: {_named(links, left)}", why, remedy))
    return tuple(findings)


def _named(links: dict[str, ElementTree.Element], names: list[str]) -> str:
    """Return the first of the links with their masses, as they are written."""
    told = []
    for name in names[:_SHOWN]:
        mass = links[name].find("inertial/mass")
        text = "" if mass is None else mass.get("value", "")
        told.append(f"{name[:60]!r} ({text if is_decimal(text) else '?'} kg)")
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(told) + more


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


def _links(root: ElementTree.Element, source: str) -> dict[str, ElementTree.Element]:
    links: dict[str, ElementTree.Element] = {}
    for element in root.findall("link"):
        name = element.get("name", "")
        if name in links:
            raise BodyError(f"{source}: found the link {name[:60]!r} twice, expected it once; rename or remove one")
        links[name] = element
    return links


def _link(links: dict[str, ElementTree.Element], link: str, source: str) -> str:
    if link in links:
        return link
    known = ", ".join(repr(name[:60]) for name in list(links)[:_SHOWN]) or "the links of a <robot>, which are none here"
    raise BodyError(f"{source}: found no link {link!r}, expected one of {known}; correct the name")


def _fixed(
    root: ElementTree.Element, links: dict[str, ElementTree.Element], link: str, source: str
) -> dict[str, _Pose]:
    """Return the pose of `link` and of every link that is fixed to it, in the axes of `link`."""
    joints: dict[str, list[tuple[str, ElementTree.Element, bool]]] = {name: [] for name in links}
    for joint in root.findall("joint"):
        ends = [end.get("link", "") for end in (joint.find("parent"), joint.find("child")) if end is not None]
        kind, place = joint.get("type", ""), f"{source}: joint {joint.get('name', '')[:60]!r}"
        if kind != "fixed" and kind.strip().lower() in ("", "fixed"):
            raise BodyError(
                f"{place} is of type {kind!r}, expected 'fixed', or a type that moves, such as 'revolute'; correct it"
            )
        # Links that are fixed to the world do not move with the others.
        if kind != "fixed" or _WORLD in ends:
            continue
        if len(ends) != 2 or not all(end in links for end in ends):
            raise BodyError(
                f"{place} joins {ends}, expected <parent link=> and <child link=> of the file; correct them"
            )
        parent, child = ends
        joints[parent].append((child, joint, True))
        joints[child].append((parent, joint, False))
    poses, todo, used = {link: _HERE}, [link], set[int]()
    while todo:
        name = todo.pop()
        for other, joint, is_child in joints[name]:
            if id(joint) in used:
                continue
            used.add(id(joint))
            place = f"{source}: joint {joint.get('name', '')[:60]!r}"
            if other in poses:
                raise BodyError(f"{place} closes a loop of fixed joints, expected a tree; remove one of them")
            pose = _origin(joint, place)
            poses[other] = poses[name].of(pose if is_child else pose.inverse())
            todo.append(other)
    return poses


def _child(element: ElementTree.Element, name: str, place: str) -> ElementTree.Element:
    child = _only(element, name, place)
    if child is None:
        raise BodyError(f"{place} has no <{name}> in <{element.tag}>, expected one; add it")
    return child


# All attributes that count. What newer URDF adds, such as quat_xyzw, would change the result without a word.
_ATTRIBUTES = {"inertial": (), "origin": ("xyz", "rpy"), "mass": ("value",), "inertia": _ENTRIES}


def _only(element: ElementTree.Element, name: str, place: str) -> ElementTree.Element | None:
    """Return the child of that name, None if there is none; raises where it is not the only one, or says more."""
    children = element.findall(name)
    if len(children) > 1:
        raise BodyError(f"{place} has {len(children)} <{name}> in <{element.tag}>, expected one; remove the others")
    for unknown in [each for child in children for each in child.attrib if each not in _ATTRIBUTES[name]]:
        known = " and ".join(_ATTRIBUTES[name]) or "none"
        remedy = "write its rotation as rpy" if name == "origin" else "remove it"
        raise BodyError(
            f"{place}: <{name}> has the attribute {unknown[:60]!r}, expected {known}: it would be ignored; {remedy}"
        )
    return children[0] if children else None


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


def _origin(element: ElementTree.Element, place: str) -> _Pose:
    """Return <origin xyz= rpy=>; what is absent is zero."""
    origin = _only(element, "origin", place)
    if origin is None:
        return _HERE
    x, y, z = _numbers(origin, "xyz", 3, place) if "xyz" in origin.attrib else ZERO
    roll, pitch, yaw = _numbers(origin, "rpy", 3, place) if "rpy" in origin.attrib else ZERO
    return _Pose((x, y, z), roll_pitch_yaw(roll, pitch, yaw))


def roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the rotation by `roll` about x, then `pitch` about y, then `yaw` about z (rad), all fixed axes."""
    if roll == pitch == yaw == 0.0:
        return IDENTITY
    turns = (rotation.exp((0.0, 0.0, yaw)), rotation.exp((0.0, pitch, 0.0)), rotation.exp((roll, 0.0, 0.0)))
    return rotation.multiply(rotation.multiply(turns[0], turns[1]), turns[2])


def _reach(link: ElementTree.Element, pose: _Pose, center: Vector, place: str) -> float | None:
    """Return a bound on the distance of the boxes, cylinders and spheres of a link with `pose` from `center`."""
    for kind in ("collision", "visual"):
        found = []
        for element in link.findall(kind):
            half = _half_diagonal(element.find("geometry"), place)
            if half is not None:
                position = pose.of(_origin(element, place)).position
                found.append(norm(subtract(position, center)) + half)
        # A mesh beside them could reach farther; then there is no bound.
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
