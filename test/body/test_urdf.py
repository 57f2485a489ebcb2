"""URDF: mass, place, turned axes, products as they stand; and files that are none."""

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

    assert "robot.urdf" in str(caught.value)


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

    for name, says in (("r.urdf", "more than 4 MiB"), ("pipe.urdf", "no plain file"), ("none.urdf", "No such file")):
        with pytest.raises(BodyError, match=says):
            urdf.read_urdf(tmp_path / name, "arm")


def test_the_shipped_arm(scene_dir: Path) -> None:
    found: Any = urdf.read_urdf(scene_dir / "urdf" / "arm.urdf", "forearm")

    assert sorted(found.body.principal_moments)[1] == 0.0338
    assert examine_reach(found.body, found.reach) is None
