"""Balances of a recorded motion: momentum against the impulse of the wrenches, energy against work.

If the log does not determine an impulse or a work, the balance is unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.impulse import impulse_blocks, wander
from rb_dynamics.analysis.noise import Noise, judge
from rb_dynamics.analysis.track import Array, Times, TimeSeries, Track, in_blocks, largest, sizes_of
from rb_dynamics.numerics.growing_array import give_back, stored

Blocks: TypeAlias = Callable[[], Iterator[Array]]
"""Returns rows in blocks, computed anew at each call, because those of a long log would take as much memory as it."""


@dataclass(frozen=True)
class Balance:
    """One conservation law, checked on the samples of a log.

    Attributes:
        name: the quantity.
        unit: of the values.
        time_ns: of the samples.
        blocks: gives `defect` in blocks.
        covered: fraction of the time for which it is known.
        scale: largest energy or momentum.
        basis: what the defect is relative to, as text.
        noise: noise of the recording, and whether the defect exceeds it; None for a log of this package.
    """

    name: str
    unit: str
    time_ns: Times
    blocks: Blocks
    covered: float
    scale: float
    basis: str
    noise: Noise | None = None

    def without_colour(self) -> Balance:
        """Return the same with noise that is taken as independent from sample to sample."""
        return replace(self, noise=self.noise and replace(self.noise, coloured=False))

    @property
    def defect(self) -> Array:
        """One row per sample; NaN if unknown. Zero at the start of each known stretch."""
        return np.concatenate([*self.blocks()])

    @property
    def worst(self) -> float:
        """The largest defect, 0 if none is known."""
        return self._worst[0]

    @property
    def worst_ns(self) -> int:
        """Time of the largest defect."""
        _, row = self._worst
        return int(self.time_ns[row]) if row is not None else 0

    @property
    def relative(self) -> float:
        """The largest defect relative to `scale`."""
        return self.worst / self.scale if self.scale > 0.0 else (0.0 if self.worst == 0.0 else np.inf)

    def onset_ns(self, bound: float) -> int | None:
        """First time at which the defect exceeds `bound` times `scale`; None if it never does."""
        first = 0
        for sizes in self._sizes() if self.worst > bound * self.scale else ():
            beyond = sizes > bound * self.scale
            if beyond.any():
                return int(self.time_ns[first + int(beyond.argmax())])
            first += len(sizes)
        return None

    @cached_property
    def _worst(self) -> tuple[float, int | None]:
        """The largest defect, and its row; 0 and None if none is known."""
        largest, row, first = 0.0, None, 0
        for sizes in self._sizes():
            if np.isfinite(sizes).any():
                at = int(np.nanargmax(sizes))
                if row is None or sizes[at] > largest:
                    largest, row = float(sizes[at]), first + at
            first += len(sizes)
        return largest, row

    def _sizes(self) -> Iterator[Array]:
        for rows in self.blocks():
            yield sizes_of(rows)


def balances(track: Track, bound: float) -> list[Balance]:
    """Return the balances that the data of `track` allow: energy, angular momentum, linear momentum.

    An impulse by quadrature counts only if its accumulated error stays below a tenth of `bound` (relative to the
    largest momentum), so that it cannot make a check fail.
    """
    found = [_energy(track)]
    if track.angular_momentum is not None:
        found.append(_momentum(track, "angular momentum", "torque", "kg m²/s", track.angular_momentum, 0.1 * bound))
    if track.linear_momentum is not None:
        found.append(_momentum(track, "linear momentum", "force", "kg m/s", track.linear_momentum, 0.1 * bound))
    return [balance for balance in found if balance is not None]


def _energy(track: Track) -> Balance | None:
    kinetic, logged, work = track.kinetic_energy, track.energy_defect, track.work
    if logged is not None and len(logged.time_ns):
        defects = logged.values
        sizes = [largest(series.values) for series in (kinetic, work) if series is not None]
        basis = "T − T₀ − W, with the work W of everything that acted as the run itself counted it"
        return Balance(
            "energy", "J", logged.time_ns, lambda: in_blocks(defects), 1.0, float(max(sizes, default=0.0)), basis
        )
    if kinetic is None or not len(kinetic.time_ns) or not track.acted:
        return None
    idle = ~track.moved_before(kinetic.time_ns)
    for kind in ("force", "torque"):
        idle &= np.concatenate([part.idle for part in impulse_blocks(track, kind, kinetic.time_ns)])
    energies = kinetic.values
    blocks, covered, noise = _from_start(lambda: in_blocks(energies), 1, idle, kinetic.time_ns, track.own)
    scale = float(kinetic.values.max(initial=0.0))
    basis = _basis("drift of T while no wrench acts", covered, "the recording does not say what work a wrench does")
    return Balance("energy", "J", kinetic.time_ns, blocks, covered, scale, basis, noise)


def _momentum(track: Track, name: str, kind: str, unit: str, series: TimeSeries, accepted: float) -> Balance | None:
    if not len(series.time_ns) or not track.acted:
        return None
    time_ns, count = series.time_ns, len(series.time_ns)
    # A series that is zero throughout takes no memory.
    error, idle = np.zeros(count), np.ones(count, dtype=bool)
    peak, sums, first = largest(series.values), np.zeros((1, 3)), 0
    for part in impulse_blocks(track, kind, time_ns):
        sums = np.cumsum(np.concatenate([sums[-1:], part.exact]), axis=0)
        peak = max(peak, float(sizes_of(sums).max()))
        rows = slice(first, first + len(part.error))
        first = rows.stop
        idle[rows] = part.idle
        if part.error.any():
            error[rows] = part.error
    scale = max(peak, _moved(track) if name == "linear momentum" else 0.0)
    good = _smallest(error, accepted * scale)
    moved = track.moved_before(time_ns)
    good &= ~moved

    def turning() -> Iterator[tuple[Array, Array]]:
        """Yield the two parts of the impulse; of that by quadrature, only what is accurate enough."""
        first = 0
        for part in impulse_blocks(track, kind, time_ns):
            part.turning[~good[first : first + len(part.error)]] = 0.0
            first += len(part.error)
            yield part.exact, part.turning

    def left() -> Iterator[Array]:
        sums, first = np.zeros((1, 3)), 0
        for exact, turned in turning():
            sums = np.cumsum(np.concatenate([sums[-1:], exact + turned]), axis=0)
            yield series.values[first : first + len(exact)] - sums[1:]
            give_back(series.values)
            first += len(exact)

    by_quadrature = float(error[good].sum())
    measured = _measured(bool(idle[good].all()), kind, by_quadrature, unit)
    steps = None if track.own else wander(track, (turned for _, turned in turning()), time_ns)
    blocks, covered, noise = _from_start(left, 3, good, time_ns, track.own, steps)
    rest = f"the {kind} is not known, or acts in body axes and the samples do not give its impulse"
    if moved.any():
        rest += ", or the body was moved from outside (set_state)"
    basis = _basis(measured, covered, rest)
    return Balance(name, unit, time_ns, blocks, covered, scale, basis, noise)


def _smallest(errors: Array, accepted: float) -> NDArray[np.bool_]:
    """Return which of the errors, from the smallest on, have a sum of at most `accepted`."""
    # If all of them do, no sorting is needed; the sum may differ by rounding, because of its order.
    if float(errors.sum()) <= (1.0 - 1e-6) * accepted or not errors.any():
        return np.full(len(errors), accepted >= 0.0)
    least_first = np.argsort(errors, kind="stable")
    good = np.zeros(len(errors), dtype=bool)
    good[least_first] = np.cumsum(errors[least_first]) <= accepted
    return good


def _measured(idle: bool, kind: str, by_quadrature: float, unit: str) -> str:
    if idle:
        return f"drift while no {kind} acts"
    text = f"against the impulse of the applied {kind}s"
    if by_quadrature == 0.0:
        return f"{text}, which is exact: they are held in world axes"
    return (
        f"{text}; those in body axes are integrated over the recorded attitude, with an error of at most about "
        f"{by_quadrature:.1g} {unit}"
    )


def _moved(track: Track) -> float:
    """Return the momentum of the parts from which p is computed here; if they cancel, p itself is round-off."""
    if track.momenta_from == "the log" or track.body is None or track.twist is None:
        return 0.0
    parts = (slice(0, 3), slice(3, 6))
    velocity, omega = (largest(track.twist.values[:, part]) for part in parts)
    return float(track.body.mass * (velocity + omega * np.linalg.norm(track.body.center_of_mass)))


def _basis(what: str, covered: float, rest: str) -> str:
    if covered == 1.0:
        return what
    if covered == 0.0:
        return f"not known at any time: {rest}"
    return f"{what}; known for {100.0 * covered:.3g} % of the time; elsewhere {rest}"


def _from_start(
    values: Blocks, columns: int, good: NDArray[np.bool_], time_ns: Times, own: bool, steps: Array | None = None
) -> tuple[Blocks, float, Noise | None]:
    """Return `values`, in rows of `columns`, relative to the start of their stretch of valid intervals.

    The other results are the fraction of the time covered, and the noise of the values, and whether they change by
    more; None for a log of this package.
    """
    good = good.copy()
    good[0] = False
    known = good | np.append(good[1:], False)

    def blocks() -> Iterator[Array]:
        first, start = 0, None
        for rows in values():
            here = slice(first, first + len(rows))
            first = here.stop
            bases = rows if start is None else np.concatenate([start, rows])
            before = len(bases) - len(rows)
            at = np.maximum.accumulate(np.where(good[here], 0, np.arange(before, len(bases))))
            start = bases[at[-1:]]
            defect = rows - bases[at]
            defect[~known[here]] = np.nan
            yield defect

    total = int(time_ns[-1] - time_ns[0])
    covered = float(int(np.diff(time_ns).sum(where=good[1:])) / total) if total else 0.0
    if own:
        return blocks, covered, None
    starts = np.maximum.accumulate(np.where(good, 0, np.arange(len(good))))[known]

    def judged() -> Iterator[Array]:
        first = 0
        for rows in blocks():
            yield rows[known[first : first + len(rows)]]
            first += len(rows)

    return blocks, covered, judge(stored(judged(), columns), starts, None if steps is None else steps[known])
