"""A body found that is far from the one given is doubted, with what other units would do so."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from identified_flights import flown, guess, random_body

from rb_dynamics import parse_scene
from rb_dynamics.analysis.identification import other_units
from rb_dynamics.analysis.identification.flights import POSITION, Flight
from rb_dynamics.analysis.identification.identify import Identification, identify
from rb_dynamics.analysis.identification.measurement_model import Model


def flight_in(length: float = 1.0, wrench: float = 1.0) -> tuple[Any, Flight]:
    """Return a body, and its flight with positions and wrenches in other units than SI."""
    random = np.random.default_rng(3)
    body = random_body(random, center=0.05)
    flight = flown(body, random, torque=1.0, force=1.0, pose=1e-4)
    streams = (replace(s, values=s.values / length) if s.kind == POSITION else s for s in flight.streams)
    channels = (replace(each, held=each.held / wrench) for each in flight.channels)
    return body, replace(flight, streams=tuple(streams), channels=tuple(channels))


def found(length: float = 1.0, wrench: float = 1.0) -> Identification:
    body, flight = flight_in(length, wrench)
    return identify(guess(body), [flight])


def test_positions_in_millimetres_are_named() -> None:
    """The mass was a thousand times too small, and the centre of mass too far away, with nothing said."""
    told = "\n".join(found(length=1e-3).notes)
    assert "the mass found is 1500 times less than the 3 kg given, as of lengths in millimetres or forces in kN" in told
    assert "times the radius of gyration of the body given, as of positions in a smaller unit than m" in told
    usual = "\n".join(found().notes)
    assert "given, as of" not in usual


def falling(length: float) -> Flight:
    """Return a flight under gravity, positions in another unit than m."""
    body = random_body(np.random.default_rng(1))
    flight = flown(body, np.random.default_rng(2), seconds=2.0, pose=1e-3)
    seconds = flight.streams[0].time_ns * 1e-9
    fallen = np.outer(seconds, [1.0, 2.0, 8.0]) - 0.5 * 9.81 * np.outer(seconds**2, [0.0, 0.0, 1.0])
    return replace(
        flight,
        streams=tuple(
            replace(s, values=(s.values + fallen) / length) if s.kind == POSITION else s for s in flight.streams
        ),
    )


@pytest.mark.parametrize(
    ("length", "effects", "fit", "told"),
    [
        (1e-3, "", ["inertia_ratios"], "m/s^2 is found, which is gravity if positions are in millimetres"),
        (1.0, "", ["inertia_ratios"], ""),
        (
            1e-2,
            "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -1]}]\n",
            ["inertia_ratios", "effects[0].acceleration_world"],
            "m/s^2 is found, which is gravity if positions are in centimetres",
        ),
    ],
)
def test_gravity_tells_the_unit_of_positions(length: float, effects: str, fit: list[str], told: str) -> None:
    """The scene lacks it, or it is fitted: nothing was said, as a force was found that explains the motion."""
    scene = parse_scene(guess(random_body(np.random.default_rng(1))).text + effects)
    notes = "\n".join(identify(scene, [falling(length)], fit).notes)
    assert told in notes
    assert ("which is gravity" in notes) == bool(told)


@pytest.mark.parametrize("acceleration", [0.00981, 0.3, 9.81, 98.1, 500.0, 950.0, 5000.0, 11000.0, np.inf])
def test_no_other_acceleration_is_taken_for_gravity(acceleration: float) -> None:
    assert other_units.doubt_of_acceleration(acceleration) == ""


def test_wrenches_in_another_unit_change_the_inertia_too() -> None:
    told = "\n".join(found(wrench=1e3).notes)
    assert "as of all wrenches, or the body given, in other units, for so is the inertia" in told


def test_torques_in_another_unit_are_named() -> None:
    """The inertia was a thousand times too large, with nothing said."""
    random = np.random.default_rng(3)
    body = random_body(random)
    flight = flown(body, random, torque=1.0)
    for unit in (1.0, 1e-3):
        channels = tuple(replace(each, held=each.held / unit) for each in flight.channels)
        notes = "\n".join(identify(guess(body), [replace(flight, channels=channels)], ["inertia"]).notes)
        assert ("times more than that given, as of torques in mN m; correct the units" in notes) is (unit != 1.0)


@pytest.mark.parametrize(
    ("ratio", "told"),
    [
        (0.03, ""),
        (0.015, "66.67 times less than that given, as of rates in degrees per second"),
        (1e-6, "1e+06 times less than that given, as of torques in other units"),
    ],
)
def test_an_inertia_far_off_is_doubted(ratio: float, told: str) -> None:
    assert other_units.doubt_of_inertia(ratio) == told


@pytest.mark.parametrize(
    ("fitted", "told"),
    [
        (0.1, ""),
        (0.04, "100 times less than the 4 kg given, as of lengths in centimetres"),
        (3000.0, "750 times more than the 4 kg given, as of lengths in kilometres or forces in mN"),
        (4e8, "1e+08 times more than the 4 kg given, as of lengths or forces in other units"),
    ],
)
def test_a_factor_is_told_with_its_likely_cause(fitted: float, told: str) -> None:
    assert other_units.doubt_of_mass(fitted, 4.0) == told


def test_a_mass_beyond_all_numbers_is_no_warning() -> None:
    """A search that went astray wrote a RuntimeWarning of numpy to the terminal."""
    body, flight = flight_in()
    model = Model(guess(body), [flight], ("mass",))
    z = np.zeros(model.layout.count)
    z[model.layout["mass"].at] = 1e4
    assert model.body(z).mass == np.inf
