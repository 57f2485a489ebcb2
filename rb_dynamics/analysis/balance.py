"""Balances of a recorded motion: momentum against the impulse of the wrenches, energy against work.

If the log does not determine an impulse or a work, the balance is unknown.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.impulse import Impulse, impulses, wander
from rb_dynamics.analysis.noise import Noise, judge
from rb_dynamics.analysis.track import Array, Times, TimeSeries, Track
from rb_dynamics.logs.messages import SET_STATE

_BLOCK = 1 << 16


@dataclass(frozen=True)
class Balance:
    """One conservation law, checked on the samples of a log.

    Attributes:
        name: the quantity.
        unit: of the values.
        time_ns: of the samples.
        defect: one row per sample; NaN if unknown. Zero at the start of each known stretch.
        covered: fraction of the time for which it is known.
        scale: largest energy or momentum.
        basis: what the defect is relative to, as text.
        noise: noise of the recording, and whether the defect exceeds it; None for a log of this package.
    """

    name: str
    unit: str
    time_ns: Times
    defect: Array
    covered: float
    scale: float
    basis: str
    noise: Noise | None = None

    @property
    def worst(self) -> float:
        """The largest defect, 0 if none is known."""
        sizes = self._sizes()
        return float(np.nanmax(sizes)) if np.isfinite(sizes).any() else 0.0

    @property
    def worst_ns(self) -> int:
        """Time of the largest defect."""
        sizes = self._sizes()
        return int(self.time_ns[np.nanargmax(sizes)]) if np.isfinite(sizes).any() else 0

    @property
    def relative(self) -> float:
        """The largest defect relative to `scale`."""
        return self.worst / self.scale if self.scale > 0.0 else (0.0 if self.worst == 0.0 else np.inf)

    def onset_ns(self, bound: float) -> int | None:
        """First time at which the defect exceeds `bound` times `scale`; None if it never does."""
        beyond = self._sizes() > bound * self.scale
        return int(self.time_ns[beyond.argmax()]) if beyond.any() else None

    def _sizes(self) -> Array:
        if self.defect.ndim == 1:
            return np.abs(self.defect)
        return sizes_of(self.defect)


def sizes_of(rows: Array) -> Array:
    """Return the length of each row; in blocks, for the squares of a long log take as much memory as the log."""
    blocks = [np.linalg.norm(rows[k : k + _BLOCK], axis=1) for k in range(0, len(rows), _BLOCK)]
    return np.concatenate(blocks) if blocks else np.empty(0)


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
        sizes = [np.abs(series.values).max(initial=0.0) for series in (kinetic, work) if series is not None]
        basis = "T − T₀ − W, with the work W of everything that acted as the run itself counted it"
        return Balance("energy", "J", logged.time_ns, logged.values, 1.0, float(max(sizes, default=0.0)), basis)
    if kinetic is None or not len(kinetic.time_ns) or not track.acted:
        return None
    idle = impulses(track, "force", kinetic.time_ns).idle & impulses(track, "torque", kinetic.time_ns).idle
    defect, covered, noise = _from_start(kinetic.values[:, None], idle, kinetic.time_ns, track.own)
    scale = float(kinetic.values.max(initial=0.0))
    basis = _basis("drift of T while no wrench acts", covered, "the recording does not say what work a wrench does")
    return Balance("energy", "J", kinetic.time_ns, defect[:, 0], covered, scale, basis, noise)


def _momentum(track: Track, name: str, kind: str, unit: str, series: TimeSeries, accepted: float) -> Balance | None:
    if not len(series.time_ns) or not track.acted:
        return None
    impulse = impulses(track, kind, series.time_ns)
    largest = max(float(sizes_of(series.values).max()), _largest_sum(impulse.exact))
    scale = max(largest, _moved(track) if name == "linear momentum" else 0.0)
    least_first = np.argsort(impulse.error, kind="stable")
    good = np.zeros(len(least_first), dtype=bool)
    good[least_first] = np.cumsum(impulse.error[least_first]) <= accepted * scale
    moved = _moved_by_others(track, series.time_ns)
    good &= ~moved
    by_quadrature = float(impulse.error[good].sum())
    del least_first
    # In place: a long log has millions of rows.
    impulse.turning[~good] = 0.0
    measured = _measured(impulse, good, kind, by_quadrature, unit)
    steps = None if track.own else wander(track, impulse, series.time_ns)
    total = np.add(impulse.exact, impulse.turning, out=impulse.exact)
    del impulse
    np.cumsum(total, axis=0, out=total)
    np.subtract(series.values, total, out=total)
    defect, covered, noise = _from_start(total, good, series.time_ns, track.own, steps)
    rest = f"a {kind} acts in body axes or none is logged, and the samples do not give its impulse"
    if moved.any():
        rest += ", or the body was moved from outside (set_state)"
    basis = _basis(measured, covered, rest)
    return Balance(name, unit, series.time_ns, defect, covered, scale, basis, noise)


def _largest_sum(rows: Array) -> float:
    """Return the largest size of the sum of the first rows, of however many; in blocks, as there are millions."""
    largest, total = 0.0, np.zeros((1, 3))
    for first in range(0, len(rows), _BLOCK):
        sums = np.cumsum(np.concatenate([total, rows[first : first + _BLOCK]]), axis=0)
        largest, total = max(largest, float(sizes_of(sums).max())), sums[-1:]
    return largest


def _measured(impulse: Impulse, good: NDArray[np.bool_], kind: str, by_quadrature: float, unit: str) -> str:
    if bool(impulse.idle[good].all()):
        return f"drift while no {kind} acts"
    text = f"against the impulse of the applied {kind}s"
    if by_quadrature == 0.0:
        return f"{text}, which is exact: they are held in world axes"
    return (
        f"{text}; those in body axes are integrated over the recorded attitude, with an error of at most about "
        f"{by_quadrature:.1g} {unit}"
    )


def _moved_by_others(track: Track, time_ns: Times) -> NDArray[np.bool_]:
    """Return for each sample whether the body was moved to another state since the one before."""
    name, type_name = SET_STATE
    moved = np.zeros(len(time_ns) + 1, dtype=bool)
    for topic in track.bag.topics.values():
        if track.own and topic.type_name == type_name and topic.name.rpartition("/")[2] == name:
            # A sample of the same time is the state before.
            moved[np.searchsorted(time_ns, topic.log_times, side="right")] = True
    return moved[:-1]


def _moved(track: Track) -> float:
    """Return the momentum of the parts from which p is computed here; if they cancel, p itself is round-off."""
    if track.momenta_from == "the log" or track.body is None or track.twist is None:
        return 0.0
    velocity, omega = (np.linalg.norm(part, axis=1).max(initial=0.0) for part in np.hsplit(track.twist.values, 2))
    return float(track.body.mass * (velocity + omega * np.linalg.norm(track.body.center_of_mass)))


def _basis(what: str, covered: float, rest: str) -> str:
    if covered == 1.0:
        return what
    if covered == 0.0:
        return f"not known at any time: {rest}"
    return f"{what}; known for {100.0 * covered:.3g} % of the time; elsewhere {rest}"


def _from_start(
    values: Array, good: NDArray[np.bool_], time_ns: Times, own: bool, steps: Array | None = None
) -> tuple[Array, float, Noise | None]:
    """Return `values` relative to the start of their stretch of valid intervals, and the fraction of the time covered.

    The last result is their noise, and whether they change by more; None for a log of this package.
    """
    count = len(values)
    good = good.copy()
    good[0] = False
    starts = np.maximum.accumulate(np.where(good, 0, np.arange(count)))
    known = good | np.append(good[1:], False)
    defect = values[starts]
    np.subtract(values, defect, out=defect)
    defect[~known] = np.nan
    lengths = np.diff(time_ns, prepend=time_ns[:1])
    total = int(lengths.sum())
    covered = float(lengths[good].sum() / total) if total else 0.0
    if own:
        return defect, covered, None
    return defect, covered, judge(values[known], starts[known], None if steps is None else steps[known])
