"""Balances of a recorded motion: momentum against the impulse of the wrenches, energy against work.

A wrench held in world axes gives an impulse that is exact between any two samples. One that turns with the body does
not: its impulse depends on the attitude between the samples. Such stretches are left out and counted, never estimated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.report.track import Array, Times, Track, WrenchSteps

Rates = TypeVar("Rates", Array, Times)


@dataclass(frozen=True)
class Balance:
    """One conservation law, checked on the samples of a log.

    Attributes:
        name: what is balanced.
        unit: of the values.
        time_ns: of the samples.
        defect: one row for each sample; NaN where it is not known. Zero at the start of each stretch that is known.
        covered: fraction of the time for which it is known.
        scale: the largest energy or momentum seen.
        basis: what the defect is measured against, for a person.
    """

    name: str
    unit: str
    time_ns: Times
    defect: Array
    covered: float
    scale: float
    basis: str

    @property
    def worst(self) -> float:
        """The largest defect, or 0 where none is known."""
        sizes = self._sizes()
        return float(np.nanmax(sizes)) if np.isfinite(sizes).any() else 0.0

    @property
    def worst_ns(self) -> int:
        """When the defect is largest."""
        sizes = self._sizes()
        return int(self.time_ns[np.nanargmax(sizes)]) if np.isfinite(sizes).any() else 0

    @property
    def relative(self) -> float:
        """The largest defect over `scale`."""
        return self.worst / self.scale if self.scale > 0.0 else (0.0 if self.worst == 0.0 else np.inf)

    def _sizes(self) -> Array:
        if self.defect.ndim == 1:
            return np.abs(self.defect)
        sizes: Array = np.linalg.norm(self.defect, axis=1)
        return sizes


def balances(track: Track) -> list[Balance]:
    """Return the balances that `track` has the data for: energy, angular momentum, linear momentum."""
    found = [_energy(track), _momentum(track, "angular momentum"), _momentum(track, "linear momentum")]
    return [balance for balance in found if balance is not None]


def _energy(track: Track) -> Balance | None:
    kinetic, logged, work = track.kinetic_energy, track.energy_defect, track.work
    if logged is not None and len(logged.time_ns):
        sizes = [np.abs(series.values).max(initial=0.0) for series in (kinetic, work) if series is not None]
        basis = "T - T0 - W, as the run booked the work of everything that acted"
        return Balance("energy", "J", logged.time_ns, logged.values, 1.0, float(max(sizes, default=0.0)), basis)
    if kinetic is None or not track.acted:
        return None
    flows = [_held(steps, kind, kinetic.time_ns) for steps in track.wrenches for kind in ("force", "torque")]
    coasting = _clear([flow.active for flow in flows], len(kinetic.time_ns))
    scale = float(kinetic.values.max(initial=0.0))
    defect, covered = _from_start(kinetic.values[:, None], coasting, kinetic.time_ns)
    basis = _basis("drift of T where no wrench acts", covered, "the log has no work of the wrenches")
    return Balance("energy", "J", kinetic.time_ns, defect[:, 0], covered, scale, basis)


def _momentum(track: Track, name: str) -> Balance | None:
    angular = name == "angular momentum"
    series = track.angular_momentum if angular else track.linear_momentum
    if series is None or not len(series.time_ns) or not track.acted:
        return None
    kind, unit = ("torque", "kg m^2/s") if angular else ("force", "kg m/s")
    flows = [_held(steps, kind, series.time_ns) for steps in track.wrenches]
    impulse = np.zeros_like(series.values) + sum(flow.impulse for flow in flows)
    exact = _clear([flow.inexact for flow in flows], len(series.time_ns))
    idle = _clear([flow.active for flow in flows], len(series.time_ns))
    defect, covered = _from_start(series.values - impulse, exact, series.time_ns)
    sizes = np.linalg.norm(np.concatenate([series.values, impulse]), axis=1)
    scale = float(sizes.max()) if angular else max(float(sizes.max()), _moved(track))
    what = "drift: no wrench acts" if bool((idle | ~exact).all()) else f"against the impulse of the world-axes {kind}s, exact"
    basis = _basis(what, covered, f"{kind}s in body axes act in the rest, where their impulse is not exact")
    return Balance(name, unit, series.time_ns, defect, covered, scale, basis)


def _moved(track: Track) -> float:
    """Return the momentum of the parts whose sum p is computed here; where they cancel, p itself is round-off."""
    if track.momenta_from == "the log" or track.body is None or track.twist is None:
        return 0.0
    velocity, omega = (np.linalg.norm(part, axis=1).max(initial=0.0) for part in np.hsplit(track.twist.values, 2))
    return float(track.body.mass * (velocity + omega * np.linalg.norm(track.body.center_of_mass)))


def _basis(what: str, covered: float, rest: str) -> str:
    if covered == 0.0:
        return f"not known at any time: {rest.replace(' in the rest', '')}"
    return what if covered == 1.0 else f"{what}; over {100.0 * covered:.3g} % of the time, {rest}"


@dataclass(frozen=True)
class _Flow:
    """What one channel does: the impulse from the first sample to each, and for each sample the ns, in the interval
    that ends there, in which its impulse is not exact and in which it acts at all.
    """

    impulse: Array
    inexact: Times
    active: Times


def _held(steps: WrenchSteps, kind: str, time_ns: Times) -> _Flow:
    vectors = steps.force if kind == "force" else steps.torque
    active = (vectors != 0.0).any(axis=1) | ~steps.known
    world = (steps.world & steps.known)[:, None]
    flags = np.column_stack([active & ~world[:, 0], active]).astype(np.int64)
    # Whether a wrench acts is counted in whole nanoseconds, so that no rounding makes a free stretch look forced.
    passed = np.diff(integral(steps.time_ns, flags, time_ns), axis=0, prepend=0)
    impulse = integral(steps.time_ns, np.where(world, vectors, 0.0), time_ns) * 1e-9
    return _Flow(impulse, passed[:, 0], passed[:, 1])


def integral(from_ns: Times, rates: Rates, time_ns: Times) -> Rates:
    """Return the integral over ns of what is held, from the first of `time_ns` to each.

    Row i of `rates` is held from `from_ns[i]` until the next; before the first there is nothing.
    """
    if not len(from_ns) or not len(time_ns):
        return np.zeros((len(time_ns), rates.shape[1]), dtype=rates.dtype)
    before = np.zeros_like(rates)
    np.cumsum(rates[:-1] * np.diff(from_ns)[:, None], axis=0, out=before[1:])
    row = np.searchsorted(from_ns, time_ns, side="right") - 1
    since = (time_ns - from_ns[row])[:, None]
    sums = np.where(row[:, None] >= 0, before[row] + rates[row] * since, 0)
    result: Rates = sums - sums[0]
    return result


def _clear(amounts: Sequence[Times], count: int) -> NDArray[np.bool_]:
    """Return for each sample whether the interval that ends there is free of what `amounts` measure."""
    return np.logical_and.reduce([amount == 0 for amount in amounts], axis=0) if amounts else np.ones(count, bool)


def _from_start(values: Array, good: NDArray[np.bool_], time_ns: Times) -> tuple[Array, float]:
    """Return `values` relative to the start of their stretch of good intervals, and the fraction of time these cover."""
    count = len(values)
    good = good.copy()
    good[0] = False
    starts = np.maximum.accumulate(np.where(good, 0, np.arange(count)))
    known = good | np.append(good[1:], False)
    defect: Array = np.where(known[:, None], values - values[starts], np.nan)
    lengths = np.diff(time_ns, prepend=time_ns[:1])
    total = int(lengths.sum())
    covered = float(lengths[good].sum() / total) if total else 0.0
    return defect, covered
