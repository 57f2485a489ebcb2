"""Bodies from particles, shapes, meshes and URDF in a scene, and the files they refer to."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rb_dynamics.body.particles import body_of_particles
from rb_dynamics.body.shapes import SHAPES
from rb_dynamics.errors import SceneError
from rb_dynamics.numerics import rotation
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.read import parse_scene, read_scene

CONFIG = Path(__file__).parents[2] / "config"
HALF = math.sqrt(0.5)


def body(text: str) -> Any:
    return parse_scene(f"body: {text}").body


def test_particles() -> None:
    scene = parse_scene(
        "body: {inertia: {particles: [{mass: 1, position: [1, 0, 0]}, {mass: 2, position: [0, 1, 0]}, "
        "{mass: 1, position: [0, 0, 1]}]}, frames: {tool: {}}}"
    )

    assert scene.body == body_of_particles([1.0, 2.0, 1.0], [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
    assert scene.body.mass == 4.0
    assert scene.body.center_of_mass == (0.25, 0.5, 0.25)
    # The lever arm of a wrench goes to the centre of mass that follows.
    assert scene.frames.center_of_mass == scene.body.center_of_mass


DIMENSIONS = {"size": "[1, 2, 3]", "semi_axes": "[1, 2, 3]", "outer_radius": "2", "inner_radius": "1"}


@pytest.mark.parametrize("kind", SHAPES)
def test_every_shape(kind: str) -> None:
    form = SHAPES[kind]
    written = ", ".join(f"{name}: {DIMENSIONS.get(name, '1.5')}" for name in form.dimensions)
    made = (
        form.make((1.0, 2.0, 3.0))
        if form.vector
        else form.make(*(float(DIMENSIONS.get(name, "1.5")) for name in form.dimensions))
    )

    assert body(f"{{mass: 3, inertia: {{shape: {{type: {kind}, {written}}}}}}}") == made.body(3.0)
    if made.volume is not None:
        found = body(f"{{center_of_mass: [1, 2, 3], inertia: {{shape: {{type: {kind}, {written}, density: 2}}}}}}")
        assert found == made.body(2.0 * made.volume, (1.0, 2.0, 3.0))


def test_a_shape_may_be_turned() -> None:
    """A quarter turn about y lays a cylinder along x."""
    turn = f"orientation: {{x: 0, y: {HALF!r}, z: 0, w: {HALF!r}}}"
    rod = body(f"{{mass: 12, inertia: {{shape: {{type: rod, radius: 0.1, length: 1, {turn}}}}}}}")

    assert [rod.inertia[i][i] for i in range(3)] == pytest.approx([0.06, 1.03, 1.03], rel=1e-14)


def test_a_density_of_no_material_is_remarked() -> None:
    """1 kg in a sphere of 100 m: mm taken for m."""
    scene = parse_scene("body: {mass: 1, inertia: {shape: {type: sphere, radius: 100}}}")

    assert [finding.name for finding in scene.findings] == ["density"]
    assert parse_scene("body: {mass: 4000, inertia: {shape: {type: sphere, radius: 1}}}").findings == ()


class TestFiles:
    def test_mesh_in_mm_beside_the_scene(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        """The path begins at the scene's folder, wherever the process is. A wedge has a quarter of L W H / 2 ..."""
        monkeypatch.chdir(tmp_path)

        scene = read_scene(CONFIG / "mesh.yaml")

        assert scene.body.mass == pytest.approx(720.0 * 0.12 * 0.04 * 0.03 / 2.0, rel=1e-14)
        assert scene.body.center_of_mass == pytest.approx((0.08, 0.02, 0.01), rel=1e-14)
        assert scene.frames.center_of_mass == scene.body.center_of_mass
        k = np.array(scene.body.inertia) / scene.body.mass
        # A triangle has the variances L^2 / 18 and H^2 / 18 and the covariance L H / 36.
        np.testing.assert_allclose(np.diag(k) * 1e6, [50.0 + 400.0 / 3.0, 850.0, 800.0 + 400.0 / 3.0], rtol=1e-13)
        np.testing.assert_allclose(k[0, 2] * 1e6, -100.0, rtol=1e-13)
        assert scene.findings == ()

    def test_mass_instead_of_density(self) -> None:
        text = "body: {mass: 0.1, inertia: {mesh: {file: meshes/wedge.stl, scale: 0.001}}}"
        scene = parse_scene(text, str(CONFIG / "s.yaml"))

        assert scene.body.mass == 0.1

    def test_a_mesh_in_mm_without_scale_is_remarked(self) -> None:
        text = "body: {mass: 0.1, inertia: {mesh: {file: meshes/wedge.stl}}}"
        (finding,) = parse_scene(text, str(CONFIG / "s.yaml")).findings

        assert finding.name == "density"
        assert "scale: 0.001" in finding.remedy

    def test_an_inside_out_mesh_is_remarked(self, tmp_path: Path) -> None:
        lines = (CONFIG / "meshes" / "wedge.stl").read_text().splitlines()
        loops = [i for i, line in enumerate(lines) if "outer loop" in line]
        for i in loops:
            lines[i + 1], lines[i + 2] = lines[i + 2], lines[i + 1]
        (tmp_path / "a.stl").write_text("\n".join(lines))
        text = "body: {inertia: {mesh: {file: a.stl, scale: 0.001, density: 720}}}"
        scene = parse_scene(text, str(tmp_path / "s.yaml"))

        assert [finding.name for finding in scene.findings] == ["inside-out"]
        assert scene.body.mass == pytest.approx(read_scene(CONFIG / "mesh.yaml").body.mass, rel=1e-14)

    def test_an_open_mesh_names_the_place(self, tmp_path: Path) -> None:
        lines = (CONFIG / "meshes" / "wedge.stl").read_text().splitlines()
        (tmp_path / "a.stl").write_text("\n".join(lines[:1] + lines[8:]))

        with pytest.raises(SceneError, match=r"s\.yaml:1: body\.inertia\.mesh: .*3 open edges.*close the holes"):
            parse_scene("body: {inertia: {mesh: {file: a.stl, density: 1}}}", str(tmp_path / "s.yaml"))

    def test_urdf(self) -> None:
        scene = read_scene(CONFIG / "urdf.yaml")

        assert scene.body.mass == 2.4
        assert scene.body.center_of_mass == (0.19, 0.0, 0.01)
        inner = np.array([[0.0046, 0.0002, 0.0], [0.0002, 0.0341, 0.0], [0.0, 0.0, 0.0338]])
        r = np.array(rotation.matrix(rotation.exp((0.0, 0.0, 0.3))))
        np.testing.assert_allclose(scene.body.inertia, r @ inner @ r.T, atol=1e-16)

    @pytest.mark.parametrize("name", ["mesh", "urdf"])
    @pytest.mark.parametrize("overrides", [{}, {"duration": 0.5}])
    def test_the_text_alone_makes_the_scene(self, name: str, overrides: Any, tmp_path: Path) -> None:
        """A log carries the text, not the file: it has to give the same bits without it."""
        scene = read_scene(CONFIG / f"{name}.yaml", {"solver.method": "rkmk4", "solver.step": 0.01, **overrides})
        path = tmp_path / "elsewhere.yaml"
        path.write_text(scene.text, encoding="utf-8")
        again = read_scene(path)

        assert again.body == scene.body
        assert again.text == scene.text
        assert simulate(again).sample == simulate(scene).sample

    def test_overrides_reach_into_the_file_forms(self) -> None:
        light = read_scene(CONFIG / "mesh.yaml", {"body.inertia.mesh.density": 360.0}).body
        full = read_scene(CONFIG / "mesh.yaml").body

        assert light.mass == pytest.approx(full.mass / 2.0, rel=1e-15)
        with pytest.raises(SceneError, match=r"a density beside body\.mass"):
            read_scene(CONFIG / "mesh.yaml", {"body.mass": 1.0})


def _sound(scene: Scene, source: str) -> None:
    assert math.isfinite(scene.body.mass)
    assert all(m > 0.0 and math.isfinite(m) for m in scene.body.principal_moments)
    assert all(map(math.isfinite, scene.body.center_of_mass))
    assert parse_scene(scene.text, source) == scene


numbers = st.one_of(st.floats(), st.integers(-3, 3), st.sampled_from([1e308, 5e-324, 1e-200, 1e200]))
values = st.one_of(
    numbers,
    st.none(),
    st.booleans(),
    st.text(max_size=6),
    st.lists(numbers, max_size=4),
    st.sampled_from(
        [*SHAPES, "meshes/wedge.stl", "urdf/arm.urdf", "forearm", ".", "..", "/dev/zero", "/dev/stdin", "a\0b"]
    ),
    st.just({"x": 0, "y": 0, "z": 0, "w": 1}),
)
keys = st.sampled_from(
    sorted(
        {"type", "file", "link", "density", "scale", "orientation", "mass", "position"}.union(
            *(form.dimensions for form in SHAPES.values())
        )
    )
)
entries = st.dictionaries(keys, values, max_size=6)


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    form=st.sampled_from(["particles", "shape", "mesh", "urdf"]),
    base=st.sampled_from(
        [
            {"type": "box", "size": [1, 2, 3]},
            {"type": "capsule", "radius": 1, "length": 2, "density": 1000},
            {"file": "meshes/wedge.stl", "density": 1000},
            {"file": "urdf/arm.urdf", "link": "forearm"},
            {},
        ]
    ),
    changes=entries,
    particles=st.lists(
        st.fixed_dictionaries({"mass": numbers, "position": st.lists(numbers, min_size=3, max_size=3)}), max_size=5
    ),
    rest=st.dictionaries(st.sampled_from(["mass", "center_of_mass"]), values, max_size=2),
)
def test_whatever_a_form_holds_is_answered(form: str, base: Any, changes: Any, particles: Any, rest: Any) -> None:
    value = particles if form == "particles" else base | changes
    source = str(CONFIG / "s.yaml")
    with contextlib.suppress(SceneError):
        _sound(parse_scene(yaml.safe_dump({"body": {"inertia": {form: value}, **rest}}), source), source)
