"""The command `body`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rb_dynamics.cli import main


def scene(tmp_path: Path, body: str) -> str:
    path = tmp_path / "s.yaml"
    path.write_text(f"body: {body}\n", encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("name", ["slew", "dzhanibekov", "particles", "shape", "mesh", "urdf"])
def test_shipped_scenes(scene_dir: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["body", str(scene_dir / f"{name}.yaml")]) == 0
    text = capsys.readouterr().out
    assert main(["body", str(scene_dir / f"{name}.yaml"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)

    assert f"symmetry         {found['symmetry']}" in text
    assert text.count("warning: ") == len(found["warnings"]) == len(found["findings"])
    for warning in found["warnings"]:
        assert warning in text


def test_axis(scene_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An axis beside the centre of mass: d^2 = 0.5 more per kg of the cylinder."""
    file = str(scene_dir / "shape.yaml")
    assert main(["body", file, "--axis", "0", "0", "-2"]) == 0
    assert "through the centre of mass\nscalar inertia   0.0106028752 kg m^2\ngyration         0.0353553" in (
        capsys.readouterr().out
    )
    assert main(["body", file, "--axis", "0", "0", "1", "--through", "0.5", "0.5", "9", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)

    assert found["axis"]["axis"] == [0.0, 0.0, 1.0]
    assert found["axis"]["scalar_inertia"] == pytest.approx(found["mass"] * (0.00125 + 0.5), rel=1e-14)
    assert found["axis"]["radius_of_gyration"] == pytest.approx((0.00125 + 0.5) ** 0.5, rel=1e-14)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--axis", "0", "0", "0"], "expected a direction"),
        (["--mesh", "none.stl"], "none.stl cannot be read"),
    ],
)
def test_what_is_refused(scene_dir: Path, arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["body", str(scene_dir / "shape.yaml"), *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err


def test_comparison_with_a_mesh_names_the_slip(
    tmp_path: Path, scene_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The wedge of mesh.yaml with its product Ixz as +int xz dm, the usual slip: valid, and yet wrong."""
    body = "{mass: 1, center_of_mass: [0.08, 0.02, 0.01], inertia: {matrix: [[%s, 0, %s], [0, %s, 0], [%s, 0, %s]]}}"
    xx, xz, yy, zz = 183.33e-6, 100e-6, 850e-6, 933.33e-6
    mesh = ["--mesh", str(scene_dir / "meshes" / "wedge.stl"), "--scale", "0.001"]

    assert main(["body", scene(tmp_path, body % (xx, -xz, yy, -xz, zz)), *mesh, "--json"]) == 0
    right = json.loads(capsys.readouterr().out)["findings"]
    assert main(["body", scene(tmp_path, body % (xx, xz, yy, xz, zz)), *mesh, "--json"]) == 0
    wrong = json.loads(capsys.readouterr().out)["findings"]

    # 1 kg in 72 cm^3 is heavy, and not impossible.
    assert [finding["name"] for finding in right] == []
    assert [finding["name"] for finding in wrong] == ["negated-products"]


@pytest.mark.parametrize(("moment", "warned"), [(1.0, True), (0.25, False)])
def test_inertia_about_the_origin_is_warned_of(
    tmp_path: Path, moment: float, warned: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """A rod of 1 m and 3 kg with its origin at the end has 1 kg m^2 about it and 0.25 about its centre."""
    file = scene(
        tmp_path, f"{{mass: 3, center_of_mass: [0.5, 0, 0], inertia: {{diagonal: [0.01, {moment}, {moment}]}}}}"
    )

    assert main(["body", file]) == 0
    assert ("warning: the centre of mass is 0.5 m from the origin" in capsys.readouterr().out) is warned
