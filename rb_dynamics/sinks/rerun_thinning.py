"""Thinning of a run for pictures: which samples, wrench changes, path points and curve pieces to keep.

Everything that is kept happened; nothing is interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.loads.wrench_channels import AppliedWrench
from rb_dynamics.numerics.vector import ZERO, Vector, add
from rb_dynamics.run.event_arrays import chosen, stacked
from rb_dynamics.run.sample import Sample

Array = NDArray[np.float64]


@dataclass
class Thinner:
    """Which samples become rows: every `stride`-th, `stride` doubling after each `max_rows` rows."""

    max_rows: int
    stride: int = 1
    rows: int = 0

    @classmethod
    def of_run(cls, duration: float | None, output_rate: float, max_rows: int) -> Thinner:
        """Return one that keeps about `max_rows` samples where `duration` (s) and `output_rate` (Hz) are known."""
        if duration is None or output_rate <= 0.0:
            return cls(max_rows)
        return cls(max_rows, max(1, math.ceil(duration * output_rate / max_rows)))

    def kept(self, samples: range) -> list[int]:
        """Return the indices of the kept ones, and count them; asked once for each sample, in their order."""
        found: list[int] = []
        while samples:
            room = self.max_rows - self.rows % self.max_rows
            kept = samples[-samples[0] % self.stride :: self.stride][:room]
            found += kept
            self.rows += len(kept)
            if len(kept) < room:
                break
            self.stride *= 2
            samples = samples[kept[-1] + 1 - samples[0] :]
        return found


class Polyline:
    """A path in at most 2 `max_points` points, evenly thinned; the newest point is always its end."""

    def __init__(self, max_points: int) -> None:
        """Start before the first point."""
        self.stride = 1
        self._max_points = max_points
        self._points: Array = np.zeros((0, 3))
        self._last: Array = np.zeros((0, 3))
        self._seen = self._sent = 0

    def extend(self, points: Array) -> None:
        """Take the next points, (n, 3)."""
        self._points = np.concatenate([self._points, points[-self._seen % self.stride :: self.stride]])
        self._last = points[-1:] if len(points) else self._last
        self._seen += len(points)
        while len(self._points) > 2 * self._max_points:
            self._points = self._points[::2]
            self.stride *= 2

    def due(self) -> bool:
        """Return whether it has doubled since it was last sent: then all sendings together cost no more than two."""
        return self._seen >= 2 * self._sent

    def sent(self) -> None:
        """Take note that it has been sent."""
        self._sent = self._seen

    def line(self) -> Array:
        """Return the points kept and the newest one, (n, 3)."""
        return np.concatenate([self._points, self._last])


class WrenchPart(NamedTuple):
    """A channel's "force" or "torque" as given in one frame."""

    kind: str
    topic: str
    frame_id: str


class StepChange(NamedTuple):
    """A new value: when, and the index of the newest sample then."""

    time_ns: int
    sample: int
    value: Vector


@dataclass
class StepFunction:
    """One part of a wrench as a step function.

    The next `exact` changes are kept; later ones wait, each in place of the one before, until a kept sample comes.
    """

    changes: list[StepChange]
    exact: int
    value: Vector = ZERO
    waiting: StepChange | None = None

    def add(self, change: StepChange) -> None:
        """Take the next change."""
        self.value = change.value
        if self.exact > 0:
            self.exact -= 1
            self.changes.append(change)
        else:
            self.waiting = change

    def settle(self) -> None:
        """Keep the change that waited."""
        if self.waiting is not None:
            self.changes.append(self.waiting)
            self.waiting = None


class WrenchHistory:
    """The wrenches of all channels, one step function for each part that ever acts; each begins with zero."""

    def __init__(self, world_frame: str, start_ns: int, exact: int) -> None:
        """Start with nothing acting at `start_ns`; `exact` changes of each part are kept whatever comes."""
        self.parts: dict[WrenchPart, StepFunction] = {}
        self._held: HeldWrench | None = HeldWrench()
        self._world_frame, self._start_ns, self._exact = world_frame, start_ns, exact

    def take(self, event: AppliedWrench, sample: int) -> list[WrenchPart]:
        """Take a change that came after `sample`; return the parts that act for the first time."""
        new = []
        for kind, value in (("force", event.force), ("torque", event.torque)):
            part = WrenchPart(kind, event.topic, event.frame_id)
            # A channel holds one wrench: what it held in another frame has ended.
            for other, steps in self.parts.items():
                if other[:2] == part[:2] and other != part and any(steps.value):
                    steps.add(StepChange(event.time_ns, sample, ZERO))
            # What never acts has no line: three at zero for each silent part would hide the others.
            if part not in self.parts and any(value):
                self.parts[part] = StepFunction([StepChange(self._start_ns, 0, ZERO)], self._exact)
                new.append(part)
            if part in self.parts:
                self.parts[part].add(StepChange(event.time_ns, sample, value))
        self._held = None
        return new

    @property
    def held(self) -> HeldWrench:
        """The sum of the channels."""
        if self._held is None:
            self._held = self._total()
        return self._held

    def fetch(self) -> list[tuple[WrenchPart, list[StepChange]]]:
        """Return the changes kept since it was last called, for each part that has any."""
        fetched = [(part, steps.changes) for part, steps in self.parts.items() if steps.changes]
        for part, _ in fetched:
            self.parts[part].changes = []
        return fetched

    def settle(self) -> None:
        """Keep what waited: a kept sample has come."""
        for steps in self.parts.values():
            steps.settle()

    def finish(self, time_ns: int, sample: int) -> None:
        """Let the line of a held command reach the end of the run."""
        for steps in self.parts.values():
            steps.settle()
            steps.changes.append(StepChange(time_ns, sample, steps.value))

    def unsent(self) -> int:
        """Return how many changes wait to be fetched."""
        return sum(len(steps.changes) for steps in self.parts.values())

    def _total(self) -> HeldWrench:
        sums: dict[str, Vector] = {}
        for part, steps in self.parts.items():
            name = f"{part.kind}_{'world' if part.frame_id == self._world_frame else 'body'}"
            sums[name] = add(sums.get(name, ZERO), steps.value)
        return HeldWrench(**sums)


@dataclass(frozen=True)
class KeptSample:
    """A kept sample, with the sum of the wrenches held then."""

    index: int
    sample: Sample
    held: HeldWrench


class KeptRows(NamedTuple):
    """Kept samples: their indices, a `Sample` with arrays, and the sum of the wrenches held at each."""

    indices: Sequence[int]
    samples: Sample
    held: Sequence[HeldWrench]


class KeptSamples:
    """Kept samples, and the wrenches between them, until they are fetched."""

    def __init__(self, thinner: Thinner, wrenches: WrenchHistory) -> None:
        """Start before the first sample."""
        self.thinner, self.wrenches = thinner, wrenches
        self._samples = 0
        self._ready: list[KeptRows] = []
        self._single: list[KeptSample] = []
        self._pending: Sample | None = None
        self._pending_kept = False

    @property
    def newest(self) -> int:
        """Index of the newest sample; what comes before the first one counts with it."""
        return max(self._samples - 1, 0)

    def take_sample(self, sample: Sample) -> None:
        """Take the next sample. It waits, so that wrenches of the very same instant count for it."""
        self._settle()
        self._pending = sample
        self._pending_kept = bool(self.thinner.kept(range(self._samples, self._samples + 1)))
        self._samples += 1
        if self._pending_kept:
            self.wrenches.settle()

    def take_samples(self, samples: Sample) -> None:
        """Take the next samples, one with arrays; no wrench changes at their times."""
        self._settle()
        first, count = self._samples, len(cast("Array", samples.time_ns))
        self._samples += count
        if kept := self.thinner.kept(range(first, first + count)):
            self.wrenches.settle()
            self._join()
            held = [self.wrenches.held] * len(kept)
            self._ready.append(KeptRows(kept, chosen(samples, np.array(kept) - first), held))

    def take_wrench(self, event: AppliedWrench) -> list[WrenchPart]:
        """Take a change of a wrench; return the parts that act for the first time."""
        if self._pending is not None and event.time_ns > self._pending.time_ns:
            self._settle()
        return self.wrenches.take(event, self.newest)

    def finish(self, time_ns: int) -> None:
        """Keep the last sample whatever its index, and let every wrench reach the end at `time_ns`."""
        self._pending_kept = True
        self._settle()
        self.wrenches.finish(time_ns, self.newest)

    def fetch(self) -> list[KeptRows]:
        """Return the samples kept since it was last called."""
        self._join()
        ready, self._ready = self._ready, []
        return ready

    def unsent(self) -> int:
        """Return how many samples and changes wait to be fetched."""
        return len(self._single) + sum(len(rows.indices) for rows in self._ready) + self.wrenches.unsent()

    def _settle(self) -> None:
        sample, self._pending = self._pending, None
        if sample is not None and self._pending_kept:
            self._single.append(KeptSample(self.newest, sample, self.wrenches.held))

    def _join(self) -> None:
        """Make arrays of the samples that came one by one."""
        if self._single:
            single, self._single = self._single, []
            samples = stacked([row.sample for row in single])
            self._ready.append(KeptRows([row.index for row in single], samples, [row.held for row in single]))


class Piece(NamedTuple):
    """A part of a curve, complete at `time_ns`: polylines (m, k), a single point where the next one is not joined."""

    time_ns: int
    sample: int
    strips: list[Array]


class Trail:
    """A curve as it arises, in pieces of `stride` rows; each begins with the last point of the one before.

    `stride` doubles after each `max_pieces`, so that a run without end grows with its logarithm only; all points stay.
    """

    def __init__(self, width: int, max_pieces: int, rows: int | None = None) -> None:
        """Start a curve of points with `width` numbers; `rows` is their number, None if unknown."""
        self._max_pieces, self._pieces = max_pieces, 0
        self.stride = max(1, math.ceil((rows or 0) / max_pieces))
        self._times: NDArray[np.int64] = np.zeros((0, 2), dtype=np.int64)
        self._points: Array = np.zeros((0, width))
        self._joined: NDArray[np.bool_] = np.zeros(0, dtype=bool)

    def take(self, times: NDArray[np.int64], points: Array, joined: NDArray[np.bool_]) -> list[Piece]:
        """Take the next points and return the pieces that they complete.

        Args:
            times: (n, 2), time in ns and index of the sample.
            points: (n, width).
            joined: (n,), whether a line leads to each point from the one before.
        """
        self._times = np.concatenate([self._times, times])
        self._points = np.concatenate([self._points, points])
        self._joined = np.concatenate([self._joined, joined])
        pieces, start = [], 0
        while len(self._points) - start > self.stride:
            pieces.append(self._piece(start, start + self.stride))
            start += self.stride
            self._pieces += 1
            if self._pieces % self._max_pieces == 0:
                self.stride *= 2
        self._times, self._points, self._joined = self._times[start:], self._points[start:], self._joined[start:]
        return pieces

    def finish(self) -> list[Piece]:
        """Return what is left, as the last piece."""
        return [self._piece(0, len(self._points) - 1)] if len(self._points) else []

    def _piece(self, start: int, stop: int) -> Piece:
        breaks = 1 + np.flatnonzero(~self._joined[start + 1 : stop + 1])
        time_ns, sample = self._times[stop].tolist()
        return Piece(time_ns, sample, np.split(self._points[start : stop + 1], breaks))
