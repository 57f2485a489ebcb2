"""URDF: mass, position, rotated axes, signs of products of inertia; invalid files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rb_dynamics.body import urdf
from rb_dynamics.body.plausibility import examine_reach
from rb_dynamics.errors import BodyError

INERTIA = '<inertia ixx="2.1" ixy="0.13" ixz="-0.27" iyy="1.7" iyz="0.31" izz="2.9"/>'
MATRIX = np.array([[2.1, 0.13, -0.27], [0.13, 1.7, 0.31], [-0.27, 0.31, 2.9]])

angles = st.floats(-math.pi, math.pi)


def robot(inertial: str, rest: str = "", head: str = '<?xml version="1.0"?>') -> bytes:
    text = f'{head}<robot name="r"><link name="other"/><link name="arm">{inertial}{rest}</link></robot>'
    return text.encode()


def inertial(origin: str = "", mass: str = '<mass value="3.5"/>', inertia: str = INERTIA) -> str:
    return f"<inertial>{origin}{mass}{inertia}</inertial>"


def test_without_an_origin_the_matrix_is_taken_to_the_bit() -> None:
    body = urdf.parse_urdf(robot(inertial()), "arm").body

    assert body.mass == 3.5
    assert body.center_of_mass == (0.0, 0.0, 0.0)
    assert np.array_equal(body.inertia, MATRIX)


def test_origin_without_rpy_moves_only_the_centre_of_mass() -> None:
    """The inertia is about the centre of mass and stays what it is."""
    body = urdf.parse_urdf(robot(inertial('<origin xyz="0.1 -0.2 0.3"/>')), "arm").body

    assert body.center_of_mass == (0.1, -0.2, 0.3)
    assert np.array_equal(body.inertia, MATRIX)


@given(angles, angles, angles)
def test_rpy_turns_about_the_fixed_axes_x_y_z_in_this_order(roll: float, pitch: float, yaw: float) -> None:
    body = urdf.parse_urdf(robot(inertial(f'<origin xyz="1 2 3" rpy="{roll!r} {pitch!r} {yaw!r}"/>')), "arm").body

    r = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
    np.testing.assert_allclose(body.inertia, r @ MATRIX @ r.T, atol=1e-14)
    assert body.center_of_mass == (1.0, 2.0, 3.0)


def test_quarter_turn_by_hand() -> None:
    """A quarter turn about z takes x to y: what was about x is about y."""
    inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="2.5"/>'
    body = urdf.parse_urdf(robot(inertial(f'<origin rpy="0 0 {math.pi / 2!r}"/>', inertia=inertia)), "arm").body

    assert [body.inertia[i][i] for i in range(3)] == pytest.approx([2.0, 1.0, 2.5], rel=1e-15)


def test_a_needle_keeps_its_small_moment_however_it_is_turned() -> None:
    inertia = '<inertia ixx="1e-12" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    body = urdf.parse_urdf(robot(inertial('<origin rpy="0.3 -0.7 2"/>', inertia=inertia)), "arm").body

    assert min(body.principal_moments) == 1e-12


@pytest.mark.parametrize(
    ("rest", "reach"),
    [
        ('<collision><geometry><box size="2 4 4"/></geometry></collision>', 3.0),
        ('<collision><origin xyz="0 0 5"/><geometry><sphere radius="2"/></geometry></collision>', 7.0),
        ('<visual><geometry><cylinder radius="3" length="8"/></geometry></visual>', 5.0),
        ('<collision><geometry><mesh filename="a.stl"/></geometry></collision>', None),
        ("<collision/>", None),
        ("", None),
    ],
)
def test_reach_of_the_geometry(rest: str, reach: float | None) -> None:
    found = urdf.parse_urdf(robot(inertial(), rest), "arm")

    assert found.reach == reach


def test_a_placeholder_inertia_is_found() -> None:
    rest = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
    large = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    found = urdf.parse_urdf(robot(inertial(inertia=large), rest), "arm")

    assert found.reach is not None
    finding = examine_reach(found.body, found.reach)
    assert finding is not None
    assert "no mass within it" in finding.why


def fixed(parent: str, child: str, origin: str = "", kind: str = "fixed") -> str:
    return f'<joint name="{child}_joint" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{origin}</joint>'


def link(name: str, inertial: str = "") -> str:
    return f'<link name="{name}">{inertial}</link>'


def diagonal(mass: float, xx: float, yy: float, zz: float, origin: str = "") -> str:
    inertia = f'<inertia ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"/>'
    return inertial(origin, f'<mass value="{mass}"/>', inertia)


def model(*parts: str) -> bytes:
    return f"<robot name='r'>{''.join(parts)}</robot>".encode()


def test_a_link_moves_with_what_is_fixed_to_it() -> None:
    """By hand: two equal masses 2 m apart, the second a quarter turn about z from the first."""
    parts = (
        link("hull", diagonal(2.0, 0.1, 0.2, 0.25)),
        link("tank", diagonal(2.0, 0.1, 0.2, 0.25)),
        fixed("hull", "tank", f'<origin xyz="2 0 0" rpy="0 0 {math.pi / 2!r}"/>'),
    )
    hull, tank = (urdf.parse_urdf(model(*parts), name) for name in ("hull", "tank"))

    assert (hull.body.mass, hull.body.center_of_mass) == (4.0, (1.0, 0.0, 0.0))
    np.testing.assert_allclose(hull.body.inertia, np.diag([0.3, 0.3 + 4.0, 0.5 + 4.0]), rtol=0.0, atol=1e-15)
    # In the axes of the tank the hull lies at y = 2.
    np.testing.assert_allclose(tank.body.center_of_mass, (0.0, 1.0, 0.0), atol=1e-15)
    np.testing.assert_allclose(tank.body.inertia, np.diag([0.3 + 4.0, 0.3, 0.5 + 4.0]), atol=1e-15)
    (told,) = hull.findings
    assert "'tank' (2.0 kg)" in told.seen


poses = st.tuples(*[st.floats(-2.0, 2.0)] * 6)


@given(st.lists(poses, min_size=3, max_size=3), st.lists(poses, min_size=2, max_size=2), st.integers(0, 2))
def test_a_chain_of_fixed_links_by_homogeneous_matrices(
    centers: list[tuple[float, ...]], joints: list[tuple[float, ...]], named: int
) -> None:
    def origin(pose: tuple[float, ...]) -> str:
        x, y, z, *rpy = map(repr, pose)
        return f'<origin xyz="{x} {y} {z}" rpy="{" ".join(rpy)}"/>'

    def matrix(pose: tuple[float, ...]) -> Any:
        found = np.eye(4)
        found[:3, :3], found[:3, 3] = Rotation.from_euler("xyz", pose[3:]).as_matrix(), pose[:3]
        return found

    masses = (1.0, 2.5, 0.5)
    data = model(
        *(link(f"l{k}", inertial(origin(centers[k]), f'<mass value="{masses[k]}"/>')) for k in range(3)),
        *(fixed(f"l{k}", f"l{k + 1}", origin(joints[k])) for k in range(2)),
    )
    body = urdf.parse_urdf(data, f"l{named}").body

    at = [np.eye(4), matrix(joints[0]), matrix(joints[0]) @ matrix(joints[1])]
    frames = [np.linalg.inv(at[named]) @ at[k] @ matrix(centers[k]) for k in range(3)]
    center = sum(m * f[:3, 3] for m, f in zip(masses, frames, strict=True)) / sum(masses)
    expected = np.zeros((3, 3))
    for m, f in zip(masses, frames, strict=True):
        arm = f[:3, 3] - center
        expected += f[:3, :3] @ MATRIX @ f[:3, :3].T + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    assert body.mass == 4.0
    np.testing.assert_allclose(body.center_of_mass, center, atol=1e-13)
    np.testing.assert_allclose(body.inertia, expected, atol=1e-12)


def test_links_that_are_frames_change_no_bit() -> None:
    alone = urdf.parse_urdf(robot(inertial('<origin xyz="0.1 0 0" rpy="0.1 0.2 0.3"/>')), "arm")
    zero = '<inertial><mass value="0"/><inertia ixx="0" ixy="0" ixz="0" iyy="0.0" iyz="0" izz="0"/></inertial>'
    frames = fixed("arm", "imu", '<origin xyz="1 2 3"/>') + fixed("footprint", "arm", '<origin rpy="1 2 3"/>')
    rest = link("imu", zero) + link("footprint") + frames
    data = robot(inertial('<origin xyz="0.1 0 0" rpy="0.1 0.2 0.3"/>')).replace(
        b"</robot>", rest.encode() + b"</robot>"
    )

    assert urdf.parse_urdf(data, "arm") == alone
    # What has no mass of its own has that of what it is fixed to.
    assert urdf.parse_urdf(data, "footprint").body.mass == 3.5


def test_a_point_without_inertia_counts_beside_others() -> None:
    data = model(
        link("a", diagonal(1, 1, 1, 1)), link("b", diagonal(3, 0, 0, 0)), fixed("a", "b", '<origin xyz="0 0 2"/>')
    )
    body = urdf.parse_urdf(data, "a").body

    assert (body.mass, body.center_of_mass) == (4.0, (0.0, 0.0, 1.5))
    np.testing.assert_allclose(body.inertia, np.diag([4.0, 4.0, 1.0]))


def test_what_hangs_on_other_joints_or_on_the_world_is_left_out_and_named() -> None:
    data = model(
        *(link(name, diagonal(mass, 1, 1, 1)) for name, mass in (("hull", 5), ("wheel", 2), ("table", 70))),
        link("world"),
        fixed("hull", "wheel", kind="continuous"),
        fixed("world", "hull"),
        fixed("world", "table"),
    )
    found = urdf.parse_urdf(data, "hull")

    assert found.body.mass == 5.0
    (told,) = found.findings
    assert "left out: 'wheel' (2 kg), 'table' (70 kg)" in str(told)


def test_reach_covers_every_link() -> None:
    ball = '<collision><geometry><sphere radius="1"/></geometry></collision>'
    joint = fixed("a", "b", '<origin xyz="10 0 0"/>')
    a, b = diagonal(1, 1, 1, 1), diagonal(1, 1, 1, 1)

    assert urdf.parse_urdf(model(link("a", a + ball), link("b", b + ball), joint), "a").reach == 6.0
    assert urdf.parse_urdf(model(link("a", a + ball), link("b", b), joint), "a").reach is None


A, B = link("a", diagonal(1, 1, 1, 1)), link("b", diagonal(1, 1, 1, 1))


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (model(A, A), "link 'a' twice"),
        (model(A, fixed("a", "c")), r"joint 'c_joint' joins \['a', 'c'\]"),
        (model(A, '<joint type="fixed" name="j"><parent link="a"/></joint>'), r"joint 'j' joins \['a'\]"),
        (model(A, B, fixed("a", "b"), fixed("b", "a")), "closes a loop of fixed joints"),
        (model(A, fixed("a", "a")), "closes a loop of fixed joints"),
        (model(A, B, fixed("a", "b", '<origin quat_xyzw="0 0 1 0"/>')), "joint 'b_joint': <origin> has the attribute"),
        (model(A, B, fixed("a", "b", '<origin xyz="1"/>')), "joint 'b_joint': xyz of <origin> is '1'"),
        (model(A, link("b", diagonal(-1, 1, 1, 1)), fixed("a", "b")), "link 'b': mass is -1"),
        (model(A, link("b", diagonal(-1, 0, 0, 0)), fixed("a", "b")), "link 'b': mass is -1"),
        (model(A, link("b", diagonal(1, 1, 1, 3)), fixed("a", "b")), "link 'b': .*1 < 3"),
        (model(A, B, fixed("a", "b", '<origin xyz="1e300 0 0"/>')), "link 'a' with what is fixed to it"),
        (
            model(A, B, fixed("a", "b").replace("fixed", "Fixed")),
            "joint 'b_joint' is of type 'Fixed', expected 'fixed'",
        ),
        (model(A, B, fixed("a", "b").replace('type="fixed"', "")), "joint 'b_joint' is of type '', expected 'fixed'"),
        (
            model(A, '<x:payload xmlns:x="http://www.ros.org/wiki/xacro" parent="a"/>'),
            "found elements of xacro, which may add links, expected URDF; run xacro on it first",
        ),
    ],
)
def test_fixed_joints_that_are_refused(data: bytes, says: str) -> None:
    with pytest.raises(BodyError, match=says):
        urdf.parse_urdf(data, "a")


BAD: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "found no XML"),
    "no XML": (b"robot", "found no XML"),
    "xacro": (b"<robot xmlns:xacro='x'><link name=</robot>", "run xacro"),
    "binary": (b"\x00\x01\x02" * 99, "found no XML"),
    "unknown encoding": (robot(inertial(), head='<?xml version="1.0" encoding="no-such"?>'), "found no XML"),
    "no links": (b"<robot/>", "which are none here"),
    "other link": (b'<robot><link name="base_link"/></robot>', "expected one of 'base_link'"),
    "no inertial": (robot(""), "has no <inertial>"),
    "no mass": (robot(inertial(mass="")), "has no <mass> in <inertial>"),
    "no inertia": (robot(inertial(inertia="")), "has no <inertia>"),
    "mass without value": (robot(inertial(mass="<mass/>")), "value of <mass> is None"),
    "mass in a word": (robot(inertial(mass='<mass value="heavy"/>')), "value of <mass> is 'heavy'"),
    "mass unexpanded": (robot(inertial(mass='<mass value="${m}"/>')), "run xacro"),
    "mass NaN": (robot(inertial(mass='<mass value="nan"/>')), "1 finite number "),
    "mass zero": (robot(inertial(mass='<mass value="0"/>')), "link 'arm': mass is 0.0"),
    "product missing": (robot(inertial(inertia='<inertia ixx="1" iyy="1" izz="1"/>')), "ixy of <inertia> is None"),
    "origin short": (robot(inertial('<origin xyz="1 2"/>')), "3 finite numbers"),
    "origin infinite": (robot(inertial('<origin rpy="1 2 inf"/>')), "3 finite numbers"),
    "another attribute of the origin": (
        robot(inertial('<origin xyz="1 2 3" quat_xyzw="0 0 0.6 0.8"/>')),
        "<origin> has the attribute 'quat_xyzw', expected xyz and rpy: it would be ignored; write its rotation as rpy",
    ),
    "another attribute of the mass": (robot(inertial(mass='<mass value="1" unit="g"/>')), "<mass> has .*'unit'"),
    "another attribute of the inertia": (
        robot(inertial(inertia=INERTIA.replace(" ixx", ' scale="2" ixx'))),
        "<inertia> has the attribute 'scale', expected ixx and ixy",
    ),
    "two inertials": (robot(inertial() + inertial()), "has 2 <inertial> in <link>, expected one; remove the others"),
    "two masses": (robot(inertial(mass='<mass value="1"/><mass value="2"/>')), "has 2 <mass> in <inertial>"),
    "impossible": (
        robot(inertial(inertia='<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="3"/>')),
        r"1 \+ 1 < 3",
    ),
    "document type": (robot(inertial(), head="<!DOCTYPE robot>"), "DOCTYPE"),
    "billion laughs": (
        robot(inertial(), head='<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]>'),
        "found <!DOCTYPE",
    ),
    "external entity": (
        robot(inertial(mass="<mass>&x;</mass>"), head='<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>'),
        "found <!DOCTYPE",
    ),
    "undefined entity": (robot(inertial(mass="<mass>&x;</mass>")), "found no XML"),
}


@pytest.mark.parametrize(("data", "says"), BAD.values(), ids=BAD)
def test_what_is_refused(data: bytes, says: str) -> None:
    with pytest.raises(BodyError, match=says) as caught:
        urdf.parse_urdf(data, "arm", "robot.urdf")

    assert str(caught.value).count("robot.urdf") == 1


@given(st.binary(max_size=300) | st.text("<>/\"'=!? abrobtlinkmserti", max_size=200).map(str.encode))
def test_any_bytes_are_answered(data: bytes) -> None:
    with pytest.raises(BodyError):
        urdf.parse_urdf(data, "arm")


def test_size_is_bounded_and_pipes_are_not_opened(tmp_path: Path) -> None:
    import os

    path = tmp_path / "r.urdf"
    with path.open("wb") as file:
        file.truncate(urdf.MAX_BYTES + 1)
    os.mkfifo(tmp_path / "pipe.urdf")

    for name, says in (
        ("r.urdf", "more than 4 MiB"),
        ("pipe.urdf", "not a regular file"),
        ("none.urdf", "No such file"),
    ):
        with pytest.raises(BodyError, match=says):
            urdf.read_urdf(tmp_path / name, "arm")


def test_the_shipped_arm(scene_dir: Path) -> None:
    found: Any = urdf.read_urdf(scene_dir / "urdf" / "arm.urdf", "forearm")

    assert sorted(found.body.principal_moments)[1] == 0.0338
    assert examine_reach(found.body, found.reach) is None
