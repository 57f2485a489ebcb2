"""The page of an identification."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identified_flights import flown, guess

from rb_dynamics import Identification, RigidBody, identify
from rb_dynamics.cli.commands.identify import as_text
from rb_dynamics.report.html import Section, render_html
from rb_dynamics.report.identification_page import identification_report

BODY = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))


def sections(found: Identification) -> dict[str, Section]:
    return {each.heading: each for each in identification_report(found).sections}


def test_page_shows_motion_residuals_and_errors() -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("jinja2")
    flights = [flown(BODY, np.random.default_rng(k), seconds=1.0, torque=3.0, pose=1e-3) for k in range(2)]
    found = identify(guess(BODY), flights, ["inertia", "gyro_bias"])
    page = sections(found)
    table = page["Parameters"].table

    assert [tile.value for tile in page["At a glance"].tiles if "moment" in tile.label] != ["not determined"] * 3
    assert table is not None
    assert [row[0] for row in table.rows] == [each.name for each in found.parameters]
    assert len(page["Ellipses of errors"].figures) == len(page["Ellipsoid of inertia"].figures) == 1
    assert sum(heading.startswith("Measured and fitted") for heading in page) == 2
    assert "inertia.xx" in render_html(identification_report(found))
    # The ellipses are those of the errors in the table.
    errors = [each.standard_error or np.nan for each in found.parameters]
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), errors)


def test_page_of_a_cube_says_what_is_not_told() -> None:
    pytest.importorskip("matplotlib")
    cube = RigidBody.from_diagonal(2.0, (0.02, 0.02, 0.02))
    found = identify(
        guess(cube), [flown(cube, np.random.default_rng(6), seconds=1.0, spin=(1.0, 1.0, 1.0))], ["inertia"]
    )
    page = sections(found)

    assert np.isnan(found.covariance).all()
    assert {tile.value for tile in page["At a glance"].tiles if "moment" in tile.label} == {"not determined"}
    assert "do not determine the shape of the inertia" in page["Ellipsoid of inertia"].text
    assert "Not determined by these recordings" in page["What these recordings do not determine"].text
    assert "Ellipses of errors" not in page

    # Notes of the reader are sentences with a full stop, those of the fit have none.
    noted = sections(replace(found, notes=("The bag has a gap.", "z: left out")))
    assert noted["Notes"].text == "The bag has a gap.\n\nz: left out."
    assert "Notes" not in page


def test_an_interval_is_told_with_digits_that_show_its_width() -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("jinja2")
    found = identify(guess(BODY), [flown(BODY, np.random.default_rng(0), seconds=1.0, torque=3.0)], ["inertia"])
    first = replace(found.parameters[0], value=0.11, standard_error=1e-10, interval=(0.11 - 2e-10, 0.11 + 2e-10))
    table = sections(replace(found, parameters=(first, *found.parameters[1:])))["Parameters"].table
    assert table is not None
    assert table.rows[0][3] == "0.1099999998 … 0.1100000002"


def test_residuals_below_the_accuracy_of_a_recording_are_not_said_to_be_white() -> None:
    pytest.importorskip("matplotlib")
    found = identify(
        guess(BODY), [flown(BODY, np.random.default_rng(1), seconds=1.0, torque=3.0, gyro=0.0)], ["inertia"]
    )
    page = sections(found)
    table = page["Residuals by sensor"].table

    assert table is not None
    assert [row[-1] for row in table.rows] == ["too small to judge"]
    assert "; too small to judge" in next(t.note for t in page["At a glance"].tiles if "Residual" in t.label)
    assert "too small to judge" in as_text(found, advise=False)
    assert found.as_dict()["residuals"]["imu"]["parts"]["rates"]["white"] is None
    # What is not judged is no colour, which would double the intervals.
    assert not any("white" in note for note in found.notes)
