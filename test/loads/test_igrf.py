"""The Earth's field: the series against others' values, its rotation, and what cannot be."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest
from scipy.special import lpmv

import rb_dynamics as rb
from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.igrf import flux_density, parsed, rotation_angle, term, terms_at
from rb_dynamics.loads.magnetic_field import MagneticField
from rb_dynamics.run.scene_remarks import scene_remarks

RADIUS = 6.3712e6
EPOCH = "2025-06-01T12:00:00Z"
SCENE = f"""
body: {{mass: 10, inertia: {{diagonal: [0.05, 0.12, 0.14]}}}}
initial: {{position_world: [7.0e+6, 0, 1.0e+6], angular_velocity_body: [0.01, 0, 0.02]}}
wrenches: []
effects: [{{type: magnetic_field, model: igrf, epoch: {EPOCH}}}]
actuators: [{{type: magnetorquer, name: rod, axis: [0, 1, 0], max_dipole: 0.2}}]
sensors: [{{type: magnetometer, name: mag, rate: 1}}]
duration: 5
"""


class TestSeries:
    def test_the_first_degree_is_a_dipole(self) -> None:
        terms = [term(1, 0, -29350.0, 0.0), term(1, 1, -1410.0, 4545.0)]
        moment = tuple(4 * math.pi * RADIUS**3 / (4e-7 * math.pi) * g * 1e-9 for g in (-1410.0, 4545.0, -29350.0))
        dipole = MagneticField("dipole", moment_world=moment).magnetic_field()
        for place in ((7e6, 1e6, -2e6), (0.0, 0.0, 6.5e6), (-1.0, 2.0, -4e7)):
            assert flux_density(terms, place) == pytest.approx(dipole(place), rel=1e-12)

    @pytest.mark.parametrize(("n", "m"), [(2, 0), (3, 3), (7, 1), (13, 12)])
    def test_it_is_the_slope_of_its_potential(self, n: int, m: int) -> None:
        g, h = 1000.0, -700.0

        def potential(x: float, y: float, z: float) -> float:
            r, lon = math.sqrt(x * x + y * y + z * z), math.atan2(y, x)
            schmidt = math.sqrt((2 if m else 1) * math.factorial(n - m) / math.factorial(n + m)) * (-1) ** m
            wave = g * math.cos(m * lon) + h * math.sin(m * lon)
            return float(RADIUS * (RADIUS / r) ** (n + 1) * wave * schmidt * lpmv(m, n, z / r)) * 1e-9

        place, step = np.array([4e6, -3e6, 5e6]), 500.0
        slope = [(potential(*(place + d)) - potential(*(place - d))) / (2 * step) for d in step * np.eye(3)]
        assert flux_density([term(n, m, g, h)], tuple(place)) == pytest.approx([-s for s in slope], rel=1e-5, abs=1e-15)

    def test_there_is_none_in_the_core(self) -> None:
        with pytest.raises(ConvergenceError, match=r"expected at least 3.4855e\+06 m"):
            flux_density([term(1, 0, -29350.0, 0.0)], (0.0, 0.0, 0.0))


class TestModel:
    def test_it_gives_what_others_give(self) -> None:
        ppigrf = pytest.importorskip("ppigrf")
        for lat, lon, r in ((80.0, 20.0, 6.4e6), (-35.0, 150.0, 6.9e6), (0.5, -75.0, 7.2e6), (-89.0, 0.0, 2e7)):
            theirs = [
                float(np.ravel(part)[0]) for part in ppigrf.igrf_gc(r / 1e3, 90.0 - lat, lon, datetime(2025, 6, 1, 12))
            ]
            t, p = math.radians(90.0 - lat), math.radians(lon)
            place = (r * math.sin(t) * math.cos(p), r * math.sin(t) * math.sin(p), r * math.cos(t))
            ours = np.array(flux_density(terms_at(EPOCH), place)) * 1e9
            axes = np.array([np.array(place) / r, [math.cos(t) * math.cos(p), math.cos(t) * math.sin(p), -math.sin(t)],
                             [-math.sin(p), math.cos(p), 0.0]])  # fmt: skip
            assert axes @ ours == pytest.approx(theirs, abs=1e-8)
        # The sample output of NOAA's Geomag 7.0 at 0 N, 0 E, 0 km on 2015-01-01, with IGRF-12, which 2015 was not yet
        # definitive in: north, east, down.
        down, east, north = np.array(flux_density(terms_at("2015-01-01"), (6378137.0, 0.0, 0.0))) * 1e9 * (-1, 1, 1)
        assert [north, east, down] == pytest.approx([27548.3, -2623.2, -15797.3], abs=6.0)

    def test_it_turns_with_the_earth(self) -> None:
        pytest.importorskip("ppigrf")
        field = MagneticField("igrf", epoch=EPOCH)
        day = 86164.0989  # s, sidereal
        place = (7e6, 1e6, 2e6)
        now, later = field.magnetic_field_at(0.0)(place), field.magnetic_field_at(day)(place)
        assert later == pytest.approx(now, abs=1e-14)
        half = field.magnetic_field_at(0.5 * day)((-7e6, -1e6, 2e6))
        assert half == pytest.approx((-now[0], -now[1], now[2]), abs=1e-14)
        assert field.magnetic_field()(place) == now

    def test_a_run_in_which_the_field_changes_says_so(self) -> None:
        """The figures of the remark and of docs/limits.md, on the surface and per year; 10 % for the grid of places."""
        pytest.importorskip("ppigrf")
        angles = [(a, b) for a in np.linspace(-1.5, 1.5, 16) for b in np.linspace(0.0, 6.2, 24)]
        places = [
            RADIUS * np.array([math.cos(a) * math.cos(b), math.cos(a) * math.sin(b), math.sin(a)]) for a, b in angles
        ]
        now, later = ([flux_density(terms_at(f"{year}-01-01"), tuple(p)) for p in places] for year in (2025, 2026))
        changed = 1e9 * np.linalg.norm(np.subtract(now, later), axis=1)
        assert math.sqrt(np.mean(changed**2)) == pytest.approx(80.0, rel=0.1)
        assert changed.max() == pytest.approx(220.0, rel=0.1)

        scene = rb.parse_scene(SCENE)
        (said,) = scene_remarks(replace(scene, duration=365.25 * 86400.0))
        assert "after 365 days the field has changed by about 80 nT, at places by 220 nT" in said
        assert not scene_remarks(replace(scene, duration=30.0 * 86400.0))
        assert not scene_remarks(replace(scene, effects=(), actuators=(), sensors=(), duration=365.25 * 86400.0))

    def test_the_angle_of_the_earth(self) -> None:
        # Astronomical Almanac: ERA 280.4606 degrees at J2000.0; 2025-01-01 0 h UT1: 100.8 degrees.
        assert math.degrees(rotation_angle(parsed("2000-01-01T12:00:00"), 0.0)) == pytest.approx(280.46061837504)
        one, other = rotation_angle(parsed(EPOCH), 7200.0), rotation_angle(parsed("2025-06-01T15:00:00+01:00"), 0.0)
        assert one == pytest.approx(other, abs=1e-11)

    def test_torquer_and_magnetometer_are_in_it(self) -> None:
        pytest.importorskip("ppigrf")
        scene, sink = rb.parse_scene(SCENE), rb.MemorySink()
        rb.simulate(scene, [("rod/command", rb.Setpoint(0.1))], [sink])
        first = sink.measurements[0]
        assert max(map(abs, np.ravel(first.numbers)[:3])) > 1e-5
        assert abs(sink.angular_momentum_defect_world).max() < 1e-15
        assert abs(sink.angular_momentum_world[-1] - sink.angular_momentum_world[0]).max() > 1e-6

    @pytest.mark.parametrize(
        ("change", "says"),
        [
            ({"effects[0].epoch": "soon"}, "epoch is 'soon', expected a date and time of UTC"),
            ({"effects[0].epoch": "1850-01-01"}, "epoch is '1850-01-01', expected one from 1900-01-01 to"),
            ({"effects[0].moment_world": [0, 0, 1]}, "moment_world: found .*expected no moment_world"),
        ],
    )
    def test_what_cannot_be_is_one_clear_error(self, change: dict[str, object], says: str) -> None:
        pytest.importorskip("ppigrf")
        with pytest.raises(SceneError, match=says):
            rb.parse_scene(SCENE, overrides=change)

    def test_without_the_package_the_error_names_it(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "ppigrf", None)
        terms_at.cache_clear()
        with pytest.raises(SceneError, match=r"pip install 'rb-dynamics\[igrf\]'"):
            rb.parse_scene(SCENE)
        with pytest.raises(SceneError, match="epoch: found nothing, expected a date and time of UTC"):
            rb.parse_scene(SCENE.replace(f", epoch: {EPOCH}", ""))
