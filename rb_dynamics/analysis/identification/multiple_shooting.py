"""Multiple shooting: a flight in segments, each from a state of its own, that are joined (Bock & Plitt, IFAC 1984).

Errors of the start grow along a flight, fast near a middle axis, and a search that flies from one start loses the
motion. Here each segment begins at a node, a state that is fitted, too. What is left between the end of a segment and
the next node counts as noise of some standard deviation. It begins large, so that the motion within each segment tells
the body, and shrinks until the nodes are joined, which is the flight from one start; or until the likelihood says that
a small disturbance acted between them, and how large (the filter-error method: Maine & Iliff, NASA RP-1168 (1986)).

Nodes are eliminated one after the other by QR decompositions, so that time is linear in the number of segments.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rb_dynamics.analysis.identification import rotations
from rb_dynamics.analysis.identification.flights import ATTITUDE, Flight, Stream
from rb_dynamics.analysis.identification.measurement_model import NODE, Model, Predicted
from rb_dynamics.analysis.identification.residuals import Fit
from rb_dynamics.analysis.identification.sensor_noise import Key, floor_of
from rb_dynamics.analysis.identification.stacked_rows import stacked, tame, triangle
from rb_dynamics.analysis.track import Array
from rb_dynamics.errors import LogError
from rb_dynamics.motion.variational_equations import STATE

TURN = 6.0
"""rad that the body turns in a segment, about."""

# Samples in a segment at least.
_SAMPLES = 12
# Fewer segments are as well flown at once.
_FEWEST = 5
# Of each flight, the first segments in which starts are compared: longer flights tell no more of which is right.
_COMPARED = 200
# What is left between segments, over what is plausible: from loose to as good as nothing.
_LOOSE = 10.0 ** -np.arange(1.0, 11.0)
# Of these, what rounding leaves.
_EXACT = 1.1e-8
# rad that the body turns in a step at last: the error of a step moves the time of a flip as a disturbance does.
_FINE = 0.015
# rad, root mean square of a component: attitudes at random are 1.3 from any motion, and none is known no better.
_ASTRAY = 0.5
# Twice the logarithm of a likelihood by which a disturbance must be the better explanation.
_BETTER = 10.0
# Times the noise that is left if nothing but noise is.
_ENOUGH = 1.3
# Of the plausible, how far parameters that are held may move.
_HELD = 1e-9
_ITERATIONS, _GAIN, _LAST_GAIN = 20, 1.0, 1e-3
# Of the plausible, by how much a number changes in an iteration at most.
_STRIDE = 2.0
_DAMPING, _MOST_DAMPING, _MISSES = 1e-4, 1e6, 2


@dataclass
class _Segment:
    """A segment.

    Attributes:
        model: that begins at its node.
        number: of the flight.
        flight: what was measured in it.
        own: where the numbers of its node are among the parameters.
        begin_ns: its node.
        end_ns: where the next one begins; None for the last of a flight.
        joined: whether it is not the first of a flight.
    """

    model: Model
    number: int
    flight: Flight
    own: slice
    begin_ns: int
    end_ns: int | None
    joined: bool


class _Flown(NamedTuple):
    """A segment that was flown, as [derivatives, residuals].

    Attributes:
        rows: (.., p + 1), of what was measured, over noise; as few as tell the same.
        gap: (m, p + 1), of the end against the next node, over what is plausible; none of the last segment.
        gap_by: (m, p), derivatives of these by the numbers of the next segment.
    """

    rows: Array
    gap: Array
    gap_by: Array


def joined(model: Model, starts: Sequence[Array], noise: dict[Key, float], far: float) -> Fit | None:
    """Return the likeliest fit of joined segments; None if the flights are short, or no motion follows them.

    What it leaves of each sample are innovations: what the samples before do not lead to, as white as the noise.

    Args:
        model: the model.
        starts: parameters to start from: what fits the segments best is joined.
        noise: of each sensor.
        far: of the plausible, how far the parameters may be.

    Raises:
        LogError: not even the motion within segments follows the attitudes.
    """
    segments = _segments(model)
    if len(segments) < _FEWEST:
        return None
    compared = _first(segments, _COMPARED)
    best, count = np.inf, 3 * sum(len(stream.time_ns) for each in compared for stream in each.flight.streams)
    for z in starts:
        other = _Shooting(model, compared, noise, far)
        there, likely = other.search(other.begun(z), _LOOSE[0])
        if likely < best:
            at, best, shooting = there, likely, other
            # No other start can improve what leaves only noise.
            if shooting.left(at) <= _ENOUGH**2 * count:
                break
    if len(compared) < len(segments) and np.isfinite(best):
        shooting = _Shooting(model, segments, noise, far)
        at, best = shooting.search(shooting.begun(at[0]), _LOOSE[0])
    if not np.isfinite(best):
        return None
    if topics := shooting.astray(at):
        raise LogError(
            f"{', '.join(dict.fromkeys(flight.name for flight in model.flights))}: found no motion that follows the "
            f"attitudes of {', '.join(topics)}, not even over segments in which the body turns by about {TURN:g} rad, "
            "expected attitudes of one body, times in seconds, and a scene with all that acts; write quaternions from "
            "angles in radians, name the unit of times, add what is missing, such as gravity, or leave attitudes out"
        )
    found, loosest = at, _LOOSE[0]
    for loose in _LOOSE[1:]:
        at, likely = shooting.search(at, loose)
        if likely > best + _BETTER:
            break
        found, loosest, best = at, loose, min(best, likely)
    for each in shooting.segments:
        each.model.turn = min(each.model.turn, _FINE)
    for _ in range(2):
        fit = shooting.outcome(found, loosest)
        shooting.noise = fit.noise
        found, _ = shooting.search(found, loosest, _LAST_GAIN)
    return shooting.outcome(found, loosest)


def _segments(model: Model) -> list[_Segment]:
    """Return the segments of all flights."""
    found = []
    for number, (flight, start) in enumerate(zip(model.flights, model.starts, strict=True)):
        blocks = [block.at for name, block in model.layout.blocks.items() if name.startswith(f"initial[{number}].")]
        own = slice(blocks[0].start, blocks[-1].stop)
        times = max((stream.time_ns for stream in flight.streams), key=len)
        first, last = flight.span_ns
        count = int(min((last - first) * 1e-9 * start.fastest / TURN, len(times) / _SAMPLES))
        # Between two samples: a command may come with one of them, and both segments would miss how it acts later.
        after = np.linspace(0, len(times), count + 1).astype(int)[1:-1]
        edges = [first, *((times[after - 1] + times[after]) // 2).tolist(), None]
        for begin, end in itertools.pairwise(edges):
            part = flight.between(begin, last + 1 if end is None else end)
            found.append(_Segment(model, number, part, own, begin, end, begin > first))
    return found


def _first(segments: Sequence[_Segment], most: int) -> list[_Segment]:
    """Return the first segments of each flight."""
    found: list[_Segment] = []
    for _, every in itertools.groupby(segments, lambda each: each.number):
        *some, last = itertools.islice(every, most)
        found += [*some, replace(last, end_ns=None)]
    return found


class _Shooting:
    """The segments of some flights. Their numbers are rows of (k, p): the parameters, with the node of each."""

    def __init__(self, model: Model, segments: Sequence[_Segment], noise: dict[Key, float], far: float) -> None:
        self.model, self.noise = model, noise
        # The parameters are taken to be near these.
        self.near, self.far, self.farthest = np.zeros(model.layout.count), far, far
        self.segments = [replace(each, model=copy.copy(each.model)) for each in segments]
        self.scale = np.concatenate([block.scale for block in model.layout.blocks.values()])

    def begun(self, z: Array) -> Array:
        """Return the numbers of nodes to which the segments before lead, corrected by the samples that follow."""
        every = np.tile(z, (len(self.segments), 1))
        for k, each in enumerate(self.segments):
            if each.joined:
                each.model = self.model.restarted(each.number, z, self._end(k - 1, every[k - 1]))
                every[k, each.own] = 0.0
                for _ in range(3):
                    left, by = stacked(self._fly(k, every[k])[0], self.noise)
                    left, by = tame(left, by)
                    size = each.own.stop - each.own.start
                    system = np.vstack([by[:, each.own], np.eye(size) / _LOOSE[0]])
                    wanted = np.append(-left, -every[k, each.own] / _LOOSE[0])
                    every[k, each.own] += np.linalg.lstsq(system, wanted, rcond=None)[0]
        return every

    def _fly(
        self, k: int, z: Array, end: Array | None = None, derivatives: bool = True
    ) -> tuple[list[Predicted], Predicted | None]:
        """Return what should have been measured in a segment, and its end against a state."""
        each, flight = self.segments[k], self.segments[k].flight
        if end is not None and each.end_ns is not None:
            node = Stream("", NODE, np.array([each.end_ns], dtype=np.int64), end[None])
            flight = replace(flight, streams=(*flight.streams, node))
        found = [
            part
            for block in each.model.of_flight(z, each.number, flight, derivatives, each.begin_ns)
            for part in block
            if len(part.left)
        ]
        ends = [part for part in found if part.key[1] == NODE]
        return [part for part in found if part.key[1] != NODE], ends[0] if ends else None

    def _end(self, k: int, z: Array) -> Array:
        """Return the state at the end of a segment."""
        state = np.zeros(STATE)
        state[3] = 1.0
        _, end = self._fly(k, z, state, derivatives=False)
        assert end is not None
        state[:4], rest = rotations.quaternions(end.left[0, :3]), end.left[0, 3:]
        state[4 : 4 + len(rest)] = rest
        return state

    def _flown(self, every: Array) -> list[_Flown]:
        found = []
        for k, each in enumerate(self.segments):
            if each.end_ns is None:
                measured, _ = self._fly(k, every[k])
                gap, gap_by = np.zeros((0, every.shape[1] + 1)), np.zeros((0, every.shape[1]))
            else:
                state, by = self.segments[k + 1].model.start_of(every[k + 1], each.number)
                measured, end = self._fly(k, every[k], state)
                assert end is not None
                left, scale = end.left[0], self.scale[each.own]
                gap_by = -by[: len(left)]
                gap_by[:3] = np.linalg.inv(rotations.right_jacobians(-left[:3])) @ gap_by[:3]
                gap, gap_by = np.column_stack([end.by[0], left]) / scale[:, None], gap_by / scale[:, None]
            left, by = tame(*stacked(measured, self.noise))
            found.append(_Flown(triangle(np.column_stack([by, left])), gap, gap_by))
        return found

    def left(self, every: Array) -> float:
        """Return the sum of squares of what was measured."""
        return sum(float(np.sum(each.rows[:, -1] ** 2)) for each in self._flown(every))

    def astray(self, every: Array) -> list[str]:
        """Return the topics of attitudes that the segments do not follow at all."""
        squares: dict[str, list[Array]] = {}
        for k, z in enumerate(every):
            for part in self._fly(k, z, derivatives=False)[0]:
                if part.key[1] == ATTITUDE:
                    squares.setdefault(part.key[0], []).append(np.ravel(part.left**2))
        return [topic for topic, found in squares.items() if np.mean(np.concatenate(found)) > _ASTRAY**2]

    def _cost(self, z: Array, flown: Sequence[_Flown], loose: float) -> float:
        """Return the sum of squares; infinite if a motion diverges."""
        found = float(np.sum(((z - self.near) / self.far) ** 2))
        found += sum(float(np.sum(f.rows[:, -1] ** 2) + np.sum((f.gap[:, -1] / loose) ** 2)) for f in flown)
        return found if np.isfinite(found) else np.inf

    def _step(self, every: Array, flown: Sequence[_Flown], loose: float, damping: float) -> tuple[Array, float]:
        """Return the step of all numbers, and the logarithm of the determinant of what tells the nodes."""
        p = every.shape[1]
        total = [np.column_stack([np.eye(p) / self.far, (every[0] - self.near) / self.far])]
        kept: dict[int, Array] = {}
        logarithm, carry = 0.0, np.zeros((0, p + 1))
        for k in reversed(range(len(self.segments))):
            each = self.segments[k]
            here = np.vstack([carry, flown[k].rows])
            if not each.joined:
                total.append(here)
                carry = np.zeros((0, p + 1))
                continue
            size = each.own.stop - each.own.start
            # The node, and the numbers of the segment before; the largest rows first, for the sake of rounding.
            gap_by = flown[k - 1].gap_by / loose
            joint = np.hstack([gap_by[:, each.own], flown[k - 1].gap / loose])
            gap_by[:, each.own] = 0.0
            joint[:, size:-1] += gap_by
            measured = np.hstack([here[:, each.own], here])
            measured[:, size:][:, each.own] = 0.0
            held = np.zeros((size, size + p + 1))
            held[:, :size] = np.diag(np.sqrt(damping) * np.linalg.norm(flown[k].rows[:, each.own], axis=0))
            both = np.vstack([joint, measured, held])
            root = triangle(both)
            kept[k], carry = root[:size], root[size:, size:]
            logarithm += 2.0 * float(np.sum(np.log(np.abs(np.diagonal(root)[:size]))))
        system = triangle(np.vstack(total))
        damped = np.vstack([system[:, :-1], np.diag(np.sqrt(damping) * np.linalg.norm(system[:, :-1], axis=0))])
        if not (np.isfinite(damped).all() and np.isfinite(system).all()):
            # The motion of some segment diverges.
            return np.full_like(every, np.nan), np.inf
        step = np.linalg.lstsq(damped, np.append(-system[:, -1], np.zeros(p)), rcond=None)[0]
        steps = np.tile(step, (len(self.segments), 1))
        for k, each in enumerate(self.segments):
            if each.joined:
                size = each.own.stop - each.own.start
                root = kept[k]
                wanted = root[:, size:-1] @ steps[k - 1] + root[:, -1]
                steps[k, each.own] = -np.linalg.solve(root[:, :size], wanted)
        return steps, logarithm

    def search(self, every: Array, loose: float, least_gain: float = _GAIN) -> tuple[Array, float]:
        """Return the numbers that fit best, and -2 times the logarithm of their likelihood, up to a constant."""
        damping, missed, flown = _DAMPING, 0, self._flown(every)
        cost = self._cost(every[0], flown, loose)
        best, least = (every, flown), cost
        for _ in range(_ITERATIONS if np.isfinite(cost) else 0):
            with np.errstate(all="ignore"):
                step, _ = self._step(every, flown, loose, damping)
                there = every + step
                cost = np.inf
                if np.abs(step).max() < _STRIDE and np.abs(there).max() < self.farthest:
                    every, flown = there, self._flown(there)
                    cost = self._cost(every[0], flown, loose)
            # What closes gaps to first order opens them to second order, and the next step closes these, too.
            missed = 0 if cost < least else missed + 1 if np.isfinite(cost) else _MISSES
            if missed >= _MISSES:
                (every, flown), missed, damping = best, 0, 10.0 * damping
                if damping > _MOST_DAMPING:
                    break
            elif not missed:
                gain, damping = least - cost, 0.1 * damping
                best, least = (every, flown), cost
                if gain < least_gain:
                    break
        every, flown = best
        if not np.isfinite(least):
            return every, np.inf
        gaps = sum(len(each.gap) for each in flown)
        return every, least + 2.0 * gaps * np.log(loose) + self._step(every, flown, loose, 0.0)[1]

    def profile(self, every: Array, loose: float, z: Array) -> float:
        """Return -2 times the logarithm of the likelihood of other parameters, with the nodes that fit them best."""
        other, moved = copy.copy(self), every + (z - every[0])
        other.near, other.far = z, _HELD
        for k, each in enumerate(self.segments):
            if each.joined:
                moved[k, each.own] = every[k, each.own]
        return other.search(moved, loose)[1]

    def outcome(self, every: Array, loose: float) -> Fit:
        """Return the fit with its innovations, and the noise that these show.

        They are those of a Kalman filter, linear near the nodes, all of a segment at once.
        """
        p = every.shape[1]
        predicted: dict[Key, list[tuple[Predicted, Array, Array]]] = {}
        # The node, by all parameters and at them, and a root of its covariance given them.
        node, root = np.zeros((0, p + 1)), np.zeros((0, 0))
        for k, (each, flown) in enumerate(zip(self.segments, self._flown(every), strict=True)):
            size = each.own.stop - each.own.start
            if not each.joined:
                node, root = np.eye(p, p + 1)[each.own], np.zeros((size, size))
            measured, _ = self._fly(k, every[k])
            left, by = stacked(measured, self.noise)
            rows = np.column_stack([by, left])
            rows[:, each.own] = 0.0
            rows += by[:, each.own] @ node
            across, sizes, along = np.linalg.svd(by[:, each.own] @ root, full_matrices=False)
            shares = across.T @ rows
            white = rows - across @ ((1.0 - 1.0 / np.hypot(1.0, sizes))[:, None] * shares)
            row = 0
            for part in measured:
                of = white[row : row + part.left.size]
                predicted.setdefault(part.key, []).append((part, of[:, :-1], of[:, -1]))
                row += part.left.size
            if each.end_ns is not None:
                node = node - root @ along.T @ ((sizes / (1.0 + sizes**2))[:, None] * shares)
                root = root @ along.T / np.hypot(1.0, sizes)
                back = -np.linalg.inv(flown.gap_by[:, each.own])
                rest, further = flown.gap.copy(), flown.gap_by.copy()
                rest[:, each.own] = further[:, each.own] = 0.0
                rest[:, :-1] += further
                node = back @ (flown.gap[:, each.own] @ node + rest)
                root = back @ triangle(np.hstack([flown.gap[:, each.own] @ root, loose * np.eye(size)]).T).T
        return self._fit(every, loose, predicted)

    def _fit(self, every: Array, loose: float, predicted: dict[Key, list[tuple[Predicted, Array, Array]]]) -> Fit:
        """Return the fit with these innovations of each stream, piece by piece."""
        streams, weighted, left, z = [], [], [], every[0]
        squares: dict[Key, tuple[float, int]] = {}
        for key, parts in predicted.items():
            over = np.concatenate([each for *_, each in parts])
            squares[key] = float(over @ over), len(over)
            weighted.append(np.vstack([by for _, by, _ in parts]))
            left.append(over)
            streams.append(
                parts[0][0]
                .without_derivatives()
                ._replace(
                    left=self.noise[key] * over.reshape(-1, 3),
                    by=np.empty((len(over) // 3, 3, 0)),
                    time_ns=np.concatenate([each.time_ns for each, *_ in parts]),
                    measured=np.concatenate([each.measured for each, *_ in parts]),
                )
            )
        count = sum(len(each) for each in left)
        levels = {key: float(np.sqrt(s / max(1.0, n * (1.0 - len(z) / count)))) for key, (s, n) in squares.items()}
        noise = {key: max(self.noise[key] * level, floor_of(self.model, key)) for key, level in levels.items()}
        factors = np.concatenate([np.full(each.left.size, self.noise[each.key] / noise[each.key]) for each in streams])
        disturbance = 0.0 if loose <= _EXACT else float(loose * max(each.fastest for each in self.model.starts))
        return Fit(
            z, noise, streams, np.vstack(weighted) * factors[:, None], np.concatenate(left) * factors, 1, 1, True,
            disturbance, lambda at: self.profile(every, loose, at),
        )  # fmt: skip
