"""The search of a fit: it ends at its minimum."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from identified_flights import flown, guess, random_body
from scipy.integrate import quad
from scipy.optimize import least_squares
from scipy.stats import norm

from rb_dynamics import identify
from rb_dynamics.analysis.identification import estimation, measurement_model
from rb_dynamics.analysis.identification.estimation import (
    _against_plausible,
    _estimated,
    _least_squares,
    _times_larger,
    fitted,
)
from rb_dynamics.analysis.identification.measurement_model import Model
from rb_dynamics.analysis.identification.parameters import AXES, PLACES
from rb_dynamics.errors import LogError


def test_a_search_that_begins_at_its_minimum_ends_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounding of the cost refused every step: shorter and shorter ones were tried, each for a whole flight."""
    random = np.random.default_rng(1)
    body = random_body(random)
    model = Model(
        guess(body), [flown(body, random, seconds=5.0, spin=(0.9, 1.2, -1.5), gyro=1e-3)], ("inertia_ratios",)
    )
    fit = fitted(model, 1, "linear", 0)
    at = _least_squares(model, fit.z, fit.noise, "linear", None).x
    flown_times, blocks = [], Model.blocks

    def counted(*arguments: Any) -> Any:
        flown_times.append(arguments)
        return blocks(*arguments)

    monkeypatch.setattr(Model, "blocks", counted)
    again = _least_squares(model, at, fit.noise, "linear", None)
    assert len(flown_times) == 1
    assert np.array_equal(again.x, at)
    assert again.status > 0
    moved = _least_squares(model, at + 1e-3, fit.noise, "linear", None)
    assert moved.cost == pytest.approx(again.cost, rel=1e-9)
    assert np.allclose(moved.x, at, atol=1e-4)


@pytest.mark.parametrize("longest", [1.0, 300.0])
def test_a_motion_that_diverges_is_an_error_and_of_a_long_one_a_part_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, longest: float
) -> None:
    monkeypatch.setattr(estimation, "_LONG", longest)
    random = np.random.default_rng(1)
    body = random_body(random)
    model = Model(guess(body), [flown(body, random, torque=1.0, spin=(0.9, 1.2, -1.5))], ("inertia",))
    tiny = np.zeros(model.layout.count)
    tiny[model.layout["size"].at] = -600.0
    with pytest.raises(LogError, match=r"found no motion that follows the recording.*or try more starts") as error:
        estimation._of_a_motion(model, tiny, {("imu", "rates", 0): 1.0})
    assert ("give a part of it (convert --to): the body turns by some" in str(error.value)) == (longest == 1.0)


def test_noise_is_estimated_beside_parameters_that_are_nearly_undetermined() -> None:
    """Squared derivatives lost the weak one of two directions to rounding, and with it the freedom of the fit."""
    random = np.random.default_rng(1)
    body = random_body(random)
    model = Model(guess(body), [flown(body, random)], ("inertia_ratios",))
    (predicted,) = model.predict(np.zeros(model.layout.count))
    one = np.linalg.qr(random.standard_normal((predicted.left.size, 2)))[0]
    by = one @ np.diag([1e8, 1e-3]) @ np.linalg.qr(random.standard_normal((2, 2)))[0]
    left = 0.01 * random.standard_normal(predicted.left.shape)
    flat = predicted._replace(left=left, by=by.reshape(*left.shape, 2))
    # The strong direction takes one degree of freedom, the weak one nearly none.
    noise = np.sqrt(np.sum(left**2) / (left.size - 1.0))
    assert _estimated(model, [flat], {predicted.key: 1.0}, "linear")[predicted.key] == pytest.approx(noise, rel=1e-5)


def test_a_search_does_not_hold_the_derivatives_of_the_whole_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measurement_model, "_BLOCK", 256)
    random = np.random.default_rng(1)
    body = random_body(random)
    made = flown(body, random, seconds=300.0, spin=(0.9, 1.2, -1.5), gyro=1e-3)
    model = Model(guess(body), [made], ("inertia_ratios",))
    z, noise = np.zeros(model.layout.count), {("imu", "rates", 0): 1e-3}
    derivatives = 8 * made.streams[0].values.size * model.layout.count
    list(model.blocks(z, derivatives=False))
    tracemalloc.start()
    _against_plausible(model, z, noise, "linear", None)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 0.5 * derivatives


def test_a_search_ends_where_the_cost_shows_no_gain(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search for the noise of the recording followed one for the same noise, and both looked for what is rounding."""
    random = np.random.default_rng(1)
    body = random_body(random)
    made = flown(body, random, seconds=5.0, spin=(0.9, 1.2, -1.5), gyro=1e-2)
    model = Model(guess(body), [made], ("inertia_ratios",))
    whole, blocks = [], Model.blocks

    def counted(self: Model, z: Any, end_ns: Any = None, derivatives: bool = True) -> Any:
        if end_ns is None and derivatives:
            whole.append(z)
        return blocks(self, z, end_ns, derivatives)

    monkeypatch.setattr(Model, "blocks", counted)
    assert fitted(model, 1, "linear", 0).converged
    assert len(whole) <= 8


def test_starts_that_meet_are_followed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a flight with slow noise, which no start explains, every start was followed to the end."""
    random = np.random.default_rng(1)
    body = random_body(random)
    made = flown(body, random, seconds=10.0, spin=(0.9, 1.2, -1.5), gyro=1e-3)
    (stream,) = made.streams
    slow = 0.05 * np.sin(0.5e-9 * stream.time_ns)[:, None]
    made = replace(made, streams=(replace(stream, values=stream.values + slow),))
    model = Model(guess(body), [made], ("inertia_ratios",))
    whole, search = [], estimation._least_squares

    def counted(*given: Any) -> Any:
        found = search(*given)
        if given[-1] is None:
            whole.append(found.x)
        return found

    monkeypatch.setattr(estimation, "_least_squares", counted)
    fit = fitted(model, 4, "linear", 0)
    assert fit.starts == fit.agreeing == 4
    # Two of them, for either noise, and from the best with the noise that is found; nine if all are.
    assert len(whole) <= 5


@pytest.mark.slow
def test_a_piece_in_which_the_motion_is_lost_grows_in_steps() -> None:
    """Near the middle axis the three times longer piece was beyond what the one before foresaw."""
    random = np.random.default_rng(4)
    body = random_body(random)
    _, axes = np.linalg.eigh(np.array(body.inertia))
    spin = 2.0 * (axes[:, 1] + 1e-2 * axes[:, 0] + 1e-2 * axes[:, 2])
    made = flown(body, random, seconds=100.0, rate=20.0, spin=spin, gyro=2e-2)
    fit = fitted(Model(guess(body), [made], ("inertia_ratios",)), 1, "linear", 0)
    assert fit.noise["imu", "rates", 0] == pytest.approx(2e-2, rel=0.1)


@pytest.mark.parametrize(
    ("loss", "psi", "kinks"),
    [
        ("huber", lambda r: np.clip(r, -1.0, 1.0), [-1.0, 1.0]),
        ("soft_l1", lambda r: r / np.sqrt(1.0 + r * r), None),
        ("cauchy", lambda r: r / (1.0 + r * r), None),
    ],
)
def test_errors_of_a_robust_loss_are_those_of_least_squares_over_its_efficiency(
    loss: str, psi: Callable[[Any], Any], kinks: list[float] | None
) -> None:
    """They were those of least squares: 95 % intervals held 89 % of the truth at white noise by cauchy."""

    def mean(of: Callable[[float], float]) -> float:
        return float(quad(lambda r: of(r) * norm.pdf(r), -8.0, 8.0, points=kinks)[0])

    # E psi' = E r psi for a normal distribution.
    worse = math.sqrt(mean(lambda r: psi(r) ** 2)) / mean(lambda r: r * psi(r))

    random = np.random.default_rng(4)
    body = random_body(random)
    flight = flown(body, random, seconds=6.0, torque=1.0)
    by_loss, least_squares = (identify(guess(body), [flight], ["inertia"], loss=each) for each in (loss, "linear"))
    ratios = [
        float(robust.standard_error or 0.0) / float(linear.standard_error or math.inf)
        for robust, linear in zip(by_loss.parameters, least_squares.parameters, strict=True)
        if robust.name.startswith("inertia")
    ]
    assert ratios == pytest.approx([worse] * len(ratios), rel=0.05)


@pytest.mark.parametrize(
    ("loss", "most"), [("huber", 1.12), pytest.param("soft_l1", 1.12, marks=pytest.mark.slow), ("cauchy", 1.25)]
)
def test_errors_of_a_robust_loss_count_the_numbers_that_the_fit_took(loss: str, most: float) -> None:
    """Of 120 measurements and 12 parameters, squared errors were 1.27, 1.22 and 1.7 times the stated ones."""
    random, count, fitted_numbers = np.random.default_rng(0), 120, 12
    free, found = count - fitted_numbers, []
    for _ in range(150):
        by, noisy = random.standard_normal((count, fitted_numbers)), random.standard_normal(count)
        at, level = np.linalg.lstsq(by, noisy, rcond=None)[0], 1.0
        for _ in range(5):
            level = 1.4826 * float(np.median(np.abs(noisy - by @ at))) * math.sqrt(count / free)
            scaled, jacobian = noisy / level, by / level
            at = least_squares(lambda z: jacobian @ z - scaled, at, jac=lambda _: jacobian, loss=loss).x  # noqa: B023
        error = level * _times_larger((noisy - by @ at) / level, free, loss)
        found.append(float(np.sum((by @ at) ** 2)) / error**2 / fitted_numbers)
    assert 0.9 < np.mean(found) < most


@pytest.mark.parametrize("loss", ["huber", "soft_l1", "cauchy"])
def test_outliers_leave_a_robust_fit_known(loss: str) -> None:
    """Their squares judged whether errors are linear, so nothing was known of a third of such recordings.

    They judged, too, whether a fit leaves only noise, so all starts and joined segments were tried in vain.
    """
    for seed in (0, 2, 7):
        random = np.random.default_rng(seed)
        body = random_body(random)
        flight = flown(body, random, seconds=2.0, rate=20.0, torque=1.0)
        (gyro,) = flight.streams
        wild = random.random(len(gyro.values)) < 0.05
        values = gyro.values + 0.1 * wild[:, None] * random.standard_normal(gyro.values.shape)
        found = identify(
            guess(body), [replace(flight, streams=(replace(gyro, values=values),))], ["inertia"], loss=loss
        )
        assert found.starts == 1
        told = {each.name: each for each in found.parameters if each.name.startswith("inertia.")}
        assert all(each.known for each in told.values()), seed
        for axis, place in zip(AXES, PLACES, strict=True):
            each = told[f"inertia.{axis}"]
            assert abs(each.value - body.inertia[place[0]][place[1]]) < 4.0 * float(each.standard_error or 0.0)


def test_outliers_beyond_the_motion_leave_a_robust_fit_known() -> None:
    """Their squares alone were more than a tenth of the motion, as if the fit had missed it: nothing was known."""
    random = np.random.default_rng(1)
    body = random_body(random)
    flight = flown(body, random, seconds=3.0, rate=100.0, torque=1.0)
    (gyro,) = flight.streams
    values = gyro.values.copy()
    # More than may be spikes, which are left out.
    values[7::15] += 10.0 * np.abs(values).max() * random.choice([-1.0, 1.0], values[7::15].shape)
    found = identify(guess(body), [replace(flight, streams=(replace(gyro, values=values),))], ["inertia"], loss="huber")
    assert found.explained
    for axis, place in zip(AXES, PLACES, strict=True):
        each = next(number for number in found.parameters if number.name == f"inertia.{axis}")
        assert each.known
        assert abs(each.value - body.inertia[place[0]][place[1]]) < 4.0 * float(each.standard_error or 0.0)
