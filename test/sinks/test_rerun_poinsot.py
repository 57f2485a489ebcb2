"""Poinsot's construction in the .rrd, read with Rerun's reader: the ellipsoid rolls on the plane."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun_runs import BODY, COMMANDS, SCENE, Rrd, logged

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.sinks import rerun_poinsot as poinsot
from rb_dynamics.sinks.picture_style import eye_above
from rb_dynamics.theory import poinsot as theory
from rb_dynamics.theory.poinsot import invariable_plane

TUMBLE = replace(SCENE, duration=5.0)


def strips(rrd: Rrd, entity: str) -> np.ndarray:
    rows = rrd.rows["/" + entity, "LineStrips3D:strips"]
    return np.concatenate([np.array(strip) for _, _, strips in rows for strip in strips])


@pytest.fixture(scope="module")
def free(tmp_path_factory: pytest.TempPathFactory) -> tuple[Rrd, list]:
    return logged(tmp_path_factory.mktemp("free"), TUMBLE, commands=())


def test_free_motion_leaves_the_plane_where_it_is(free: tuple[Rrd, list]) -> None:
    rrd, _ = free
    plane = invariable_plane(BODY, TUMBLE.initial)
    ellipsoid = theory.energy_ellipsoid(BODY, TUMBLE.initial)
    place = plane.normal_world * plane.distance / ellipsoid.max()
    found = rrd.values("poinsot/plane", "Transform3D:translation")[:, 0]
    assert len(found) == 501
    np.testing.assert_allclose(found, np.tile(place, (501, 1)), rtol=0, atol=1e-6)
    half = np.array(rrd.static("poinsot/body/ellipsoid", "Ellipsoids3D:half_sizes")[0])
    np.testing.assert_allclose(half, ellipsoid / ellipsoid.max(), rtol=1e-6)


def test_curves_are_those_of_the_theory(free: tuple[Rrd, list]) -> None:
    rrd, samples = free
    times = [sample.time_ns * 1e-9 for sample in samples]
    largest = theory.energy_ellipsoid(BODY, TUMBLE.initial).max()
    in_body = theory.polhode(BODY, TUMBLE.initial, times=times).angular_velocity_body / largest
    in_world = theory.herpolhode(BODY, TUMBLE.initial, times=times).angular_velocity_world / largest
    for entity, curve in ((poinsot.POLHODE, in_body), (poinsot.HERPOLHODE, in_world)):
        drawn = strips(rrd, entity)
        assert np.abs(drawn[:, None] - curve[None]).max(axis=2).min(axis=1).max() < 2e-6
        assert np.abs(drawn[None] - curve[:, None]).max(axis=2).min(axis=1).max() < 2e-6
        assert rrd.times(entity, "LineStrips3D:strips")[-1] == 5_000_000_000


def test_the_curves_never_run_ahead_of_the_body(free: tuple[Rrd, list]) -> None:
    rrd, samples = free
    tips = dict(
        zip(
            rrd.indices("poinsot/angular_velocity", "Arrows3D:vectors"),
            rrd.values("poinsot/angular_velocity", "Arrows3D:vectors")[:, 0],
            strict=True,
        )
    )
    assert len(tips) == len(samples)
    for _, index, row in rrd.rows["/" + poinsot.HERPOLHODE, "LineStrips3D:strips"]:
        np.testing.assert_allclose(row[-1][-1], tips[index], rtol=0, atol=1e-6)


def test_a_torque_moves_the_plane_and_a_body_at_rest_has_none(tmp_path: Path) -> None:
    rest = replace(SCENE, initial=replace(SCENE.initial, angular_velocity_body=(0.0, 0.0, 0.0)))
    rrd, samples = logged(tmp_path, rest, COMMANDS)
    rows = rrd.rows["/poinsot/plane", "Transform3D:translation"]
    shown = [index for _, index, value in rows if value]
    turning = [i for i, sample in enumerate(samples) if any(sample.angular_velocity_body)]
    assert shown == turning
    assert 0 < len(turning) < len(samples)
    body = [index for _, index, value in rrd.rows["/poinsot/body", "Transform3D:quaternion"] if value]
    assert len(body) == len(samples)
    assert np.isfinite(strips(rrd, poinsot.POLHODE)).all()


def test_a_particle_has_no_construction(tmp_path: Path) -> None:
    scene = replace(
        SCENE, body=RigidBody.particle(1.0), initial=replace(SCENE.initial, angular_velocity_body=(0, 0, 0))
    )
    rrd, _ = logged(tmp_path, scene, commands=())
    assert not [entity for entity, _ in rrd.rows if entity.startswith("/poinsot")]
    assert "Poinsot" not in rrd.static("about", "TextDocument:text")[0]


def test_samples_too_far_apart_for_a_line_are_dots(tmp_path: Path) -> None:
    rrd, samples = logged(tmp_path, replace(SCENE, output_rate=2.0, duration=10.0), commands=())
    assert ("/" + poinsot.POLHODE, "LineStrips3D:strips") not in rrd.rows
    rows = rrd.rows["/" + poinsot.POLHODE + "/dots", "Points3D:positions"]
    dots = [place for _, _, places in rows for place in places]
    assert len(np.unique(dots, axis=0)) == len(samples)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (0.6, -0.8, 0), (-0.6, 0.64, -0.48), None])
def test_the_eye_looks_down_on_the_plane_from_the_side(normal: tuple[float, float, float] | None) -> None:
    eye = eye_above(normal)
    up = (0.0, 0.0, 1.0) if normal is None else np.negative(normal)
    assert eye.up == pytest.approx(up)
    distance = np.linalg.norm(eye.position)
    assert 3.0 < distance < 7.0
    assert 0.3 < np.dot(eye.position, up) / distance < 0.6
