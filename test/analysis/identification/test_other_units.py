"""A body found that is far from the one given is doubted, with what other units would do so."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from identified_flights import flown, guess, random_body

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


def test_wrenches_in_another_unit_change_the_inertia_too() -> None:
    told = "\n".join(found(wrench=1e3).notes)
    assert "as of all wrenches, or the body given, in other units, for so is the inertia" in told


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
