"""Impulses and balances are exact where they claim to be, and have honest error bounds elsewhere."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rb_dynamics.analysis.checks import balanced
from rb_dynamics.analysis.impulse import Impulse, impulse_blocks, integral
from rb_dynamics.analysis.momentum_energy_balance import Balance, balances
from rb_dynamics.analysis.noise import Noise
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.track import Track
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.bag_reader import read_bag

BOUND = 1e-6


def impulses(track: Track, kind: str, time_ns: Any) -> Impulse:
    blocks = [*impulse_blocks(track, kind, time_ns)]
    return Impulse(*(np.concatenate([getattr(part, name) for part in blocks]) for name in Impulse.__annotations__))


def track_of(flight: Any) -> Track:
    return read_track(read_bag(flight.log))


def named(track: Track, name: str, bound: float = BOUND) -> Balance:
    return next(balance for balance in balances(track, bound) if balance.name == name)


def test_integral_of_held_values_is_exact() -> None:
    held_from = np.array([10, 20, 40])
    rates = np.array([[1], [5], [-2]])
    times = np.array([0, 10, 15, 20, 30, 40, 100])
    assert integral(held_from, rates, times)[:, 0].tolist() == [0, 0, 5, 10, 60, 110, -10]


def test_integral_starts_at_the_first_time() -> None:
    assert integral(np.array([0]), np.array([[2.0]]), np.array([5, 8]))[:, 0].tolist() == [0.0, 6.0]


def test_of_two_commands_at_one_time_the_later_counts() -> None:
    assert integral(np.array([0, 0]), np.array([[9], [1]]), np.array([0, 7]))[:, 0].tolist() == [0, 7]


def test_balances_agree_with_the_books_of_the_run(flight: Any) -> None:
    track = track_of(flight)
    covered = {balance.name: balance.covered for balance in balances(track, BOUND)}
    assert covered == {"energy": 1.0, "angular momentum": 1.0, "linear momentum": 1.0}
    assert max(balance.relative for balance in balances(track, BOUND)) < 1e-9
    # The run's own quadrature of the torque impulse is another one; both leave only their errors.
    samples = flight.samples
    own = np.linalg.norm(samples.angular_momentum_defect_world, axis=1).max()
    estimates = impulses(track, "torque", samples.time_ns).error
    error = estimates.sum()
    assert 0.0 < error < 1e-7
    assert named(track, "angular momentum").worst <= own + error


@pytest.mark.parametrize("block", [1, 7, 100_000])
def test_blocks_give_the_whole(flight: Any, block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    track = track_of(flight)
    whole = {kind: impulses(track, kind, flight.samples.time_ns) for kind in ("force", "torque")}
    monkeypatch.setattr("rb_dynamics.analysis.impulse._BLOCK", block)
    for kind, expected in whole.items():
        found = impulses(track, kind, flight.samples.time_ns)
        assert (found.idle == expected.idle).all()
        for name in ("exact", "turning", "error"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-12, atol=1e-12)


def test_over_a_hole_the_impulse_of_a_wrench_that_turns_is_unknown(flight: Any) -> None:
    """Quadrature over it gave numbers so large that they drowned the digits of all the others."""
    track, times = track_of(flight), flight.samples.time_ns
    hole = slice(len(times) // 4, 3 * len(times) // 4)
    far = np.arange(len(times)) >= hole.stop
    later = [replace(each, time_ns=each.time_ns + far * 10**15) for each in track.motion]
    whole = impulses(track, "torque", times)
    found = impulses(replace(track, pose=later[0], twist=later[1]), "torque", np.delete(times + far * 10**15, hole))
    before = slice(0, hole.start)
    assert np.array_equal(found.turning[before], whole.turning[before])
    assert np.isinf(found.error[hole.start])
    assert not found.turning[hole.start].any()


def test_force_in_world_axes_is_exact(flight: Any) -> None:
    balance = named(track_of(flight), "linear momentum")
    assert "exact" in balance.basis
    assert balance.worst < 1e-14
    assert balance.scale == pytest.approx(np.linalg.norm(flight.samples.linear_momentum_world, axis=1).max())


def test_coasting_is_drift(coasting: Any) -> None:
    track = track_of(coasting)
    assert named(track, "angular momentum").basis == "drift while no torque acts"
    assert named(track, "linear momentum").worst == 0.0
    assert named(track, "angular momentum").relative < 1e-9


@pytest.mark.parametrize("name", ["angular momentum", "linear momentum"])
def test_a_wrench_the_log_does_not_tell_of_is_found(flight: Any, name: str) -> None:
    track = track_of(flight)
    scaled = [replace(steps, force=1.001 * steps.force, torque=1.001 * steps.torque) for steps in track.wrenches]
    assert named(replace(track, wrenches=tuple(scaled)), name).relative > 1e-4
    assert named(replace(track, wrenches=()), name).relative > 1e-2


def test_an_energy_that_leaks_is_found_while_coasting(coasting: Any) -> None:
    track = track_of(coasting)
    kinetic = track.kinetic_energy
    assert kinetic is not None
    leaking = replace(kinetic, values=kinetic.values * np.linspace(1.0, 0.999, len(kinetic.values)))
    # Without the run's own books, as in a bag of another writer.
    balance = named(replace(track, kinetic_energy=leaking, energy_defect=None, work=None), "energy")
    assert balance.covered == 1.0
    assert balance.relative == pytest.approx(1e-3, rel=1e-3)


def test_error_of_the_quadrature_is_honest_and_of_fourth_order(flown: Any) -> None:
    command = [("push", Wrench((0.0, 0.0, 0.0), (0.4, -0.3, 0.2), "body", 0))]
    errors, estimates = [], []
    for rate in ("10.0", "20.0", "40.0"):
        track = track_of(flown(command, step="0.001", output_rate=rate))
        momentum = track.angular_momentum
        assert momentum is not None
        torque = impulses(track, "torque", momentum.time_ns)
        gained = momentum.values - momentum.values[0]
        errors.append(np.linalg.norm(np.cumsum(torque.turning, axis=0) - gained, axis=1).max())
        estimates.append(torque.error.sum())
    assert all(error <= estimate for error, estimate in zip(errors, estimates, strict=True))
    # h^5 in each interval, h^4 in the sum.
    orders = np.log2(np.array(errors)[:-1] / np.array(errors)[1:])
    assert orders == pytest.approx([4.0, 4.0], abs=0.3)


def test_samples_too_far_apart_are_not_judged(flight: Any) -> None:
    balance = named(track_of(flight), "angular momentum", bound=1e-14)
    assert 0.0 < balance.covered < 1.0
    known = f"known for {100.0 * balance.covered:.3g} % of the time; elsewhere the torque is not known, or acts in body"
    assert f"{known} axes and the samples do not give its impulse" in balance.basis
    # From 0.5 s to the timeout at 1.05 s torques act, and so in the intervals with these ends.
    assert balance.covered == pytest.approx(1.0 - 0.56 / 3.0, abs=0.01)
    held = (balance.time_ns > 520_000_000) & (balance.time_ns < 1_040_000_000)
    assert np.isnan(balance.defect[held]).all()
    assert not np.isnan(balance.defect[~held & (balance.time_ns < 500_000_000)]).any()


def test_a_command_between_two_samples_is_integrated_to_where_it_comes(flown: Any) -> None:
    commands = [
        ("push", Wrench((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), "body", 500_000_000)),
        ("push", Wrench((0.0, 0.0, 0.0), (0.2, 0.0, 0.0), "body", 507_000_000)),
        ("push", Wrench((0.0, 0.0, 0.0), (0.0, 0.3, 0.1), "body", 511_000_000)),
    ]
    errors, estimates = [], []
    for rate in ("10.0", "20.0", "40.0"):
        balance = named(track_of(flown(commands, step="0.001", output_rate=rate)), "angular momentum", bound=1.0)
        torque = impulses(track_of(flown(commands, step="0.001", output_rate=rate)), "torque", balance.time_ns)
        assert balance.covered == 1.0
        row = int(np.searchsorted(balance.time_ns, 500_000_001))
        errors.append(float(np.linalg.norm(balance.defect[row] - balance.defect[row - 1])))
        estimates.append(float(torque.error[row]))
    assert all(error <= estimate for error, estimate in zip(errors, estimates, strict=True))
    assert errors[0] < 1e-6
    assert errors[2] < errors[0] / 300.0


def test_a_change_of_axes_between_two_samples_counts_each_wrench_once(flown: Any) -> None:
    commands = [
        ("push", Wrench((1.0, 0.0, 0.0), (0.1, 0.0, 0.0), "body", 500_000_000)),
        ("push", Wrench((0.0, 2.0, 0.0), (0.0, 0.2, 0.0), "world", 507_000_000)),
        ("push", Wrench((0.0, 0.0, 3.0), (0.0, 0.3, 0.1), "body", 511_000_000)),
    ]
    flight = flown(commands, step="0.001", output_rate="100.0")
    for name in ("angular momentum", "linear momentum"):
        balance = named(track_of(flight), name)
        assert balance.covered == 1.0
        assert balance.relative < 1e-7


# In quarters of an interval of 0.1 s this leaves neither rate nor angle at its ends.
CANCELLING = ((500, 0.3), (525, -0.3), (575, 0.3), (600, 0.0))


@pytest.mark.parametrize("topics", [("push", "push"), ("thrust", "push")])
def test_torques_that_cancel_between_two_samples_still_turn_the_force(flown: Any, topics: tuple[str, str]) -> None:
    """Also where the force itself comes on a channel of its own and does not change."""
    force, torque = topics
    at_once = force == torque
    commands = [] if at_once else [(force, Wrench((1.0, 1.0, 0.0), (0.0, 0.0, 0.0), "body", 0))]
    push = (1.0, 1.0, 0.0) if at_once else (0.0, 0.0, 0.0)
    commands += [(torque, Wrench(push, (0.0, 0.0, size), "body", at * 1_000_000)) for at, size in CANCELLING]
    flight = flown(commands, step="0.001", output_rate="10.0", timeout="9.0")
    track = track_of(flight)
    momentum = track.linear_momentum
    assert momentum is not None
    force_impulse = impulses(track, "force", momentum.time_ns)
    gained = np.diff(momentum.values, axis=0)
    wrong = np.linalg.norm(gained - (force_impulse.turning + force_impulse.exact)[1:], axis=1)
    assert wrong.max() > 1e-6
    assert (wrong <= force_impulse.error[1:] + 1e-12).all()
    assert named(track, "linear momentum").relative < BOUND


@pytest.mark.parametrize(("size", "judged"), [(1e-3, True), (3.0, False)])
def test_noise_larger_than_the_quantity_judges_nothing(flight: Any, size: float, judged: bool) -> None:
    """Of a defect of 300 % it was said that the balance holds, as it was no more than noise."""
    track = track_of(flight)
    defects = np.array([[0.0], [size]])
    times = np.array([0, 1_000_000_000])
    noisy = Balance("energy", "J", times, lambda: iter([defects]), 1.0, 1.0, "", Noise(size, False, (1,)))
    check = balanced(track, noisy, BOUND)
    assert check.judged == judged
    assert ("noise of the recording is larger than the quantity itself" in check.detail) != judged
