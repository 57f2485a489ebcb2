"""What one recording says about the given inertia and mass, by the model and the fit of `identify`.

The start of the motion is fitted with the given inertia and the recorded torques. Each candidate for what may be wrong
is then added to the model, and one Gauss-Newton step is taken with it, from exact derivatives: the score test (Rao,
Proc. Cambridge Phil. Soc. 44 (1948) 50). Where residuals stay coloured, the covariance is that of coloured noise,
doubled. If one counts, each is fitted to the end: beside a start that does not fit, one step tells little. So is
the mass, to the translation.

The time of a fit grows with the recording: of a long one, a part is fitted.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from rb_dynamics.analysis.gaps import holes
from rb_dynamics.analysis.identification.estimation import followed, starts_of
from rb_dynamics.analysis.identification.flights import (
    ATTITUDE,
    POSITION,
    RATES,
    VELOCITY,
    Flight,
    Stream,
    WrenchSeries,
    held_rows,
)
from rb_dynamics.analysis.identification.measurement_model import Model, Predicted
from rb_dynamics.analysis.identification.model_omissions import TOLD
from rb_dynamics.analysis.identification.other_units import POSITIONS, is_far
from rb_dynamics.analysis.identification.parameters import PLACES, rows_of
from rb_dynamics.analysis.identification.residual_whiteness import bands_of, root_of, whiteness, widened
from rb_dynamics.analysis.identification.residuals import EXPLAINED, noise_of
from rb_dynamics.analysis.identification.sensor_noise import Key, floor_of, is_smooth, noise_shown
from rb_dynamics.analysis.identification.stacked_rows import covariance_of, sane, stacked
from rb_dynamics.analysis.track import Array, Times, TimeSeries, Track, in_blocks, unit_rows
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.scheduled_wrench import ScheduledWrench
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.loads.wrench import Wrench, WrenchFrames
from rb_dynamics.motion.fixed_step_kernel import Tally, counted_by
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.vector import ZERO
from rb_dynamics.scene.model import Scene

# Of a recording of the right body, the chance that a candidate counts.
_CHANCE = 3e-4
# Pieces of time in each of which a torque is constant.
_PIECES = 12
# rad that the body turns in the part that is fitted, and samples of each sensor there.
_TURN, _MOST, _FEWEST = 60.0, 500, 16
# Parts that are fitted where nothing but the fit judges.
_PARTS = 8
# Of the least noise that `identify` believes in: other programs integrate and stamp less exactly.
_LESS_EXACT = 10.0
# Standard errors of a change of six numbers that is found in 95 of 100 recordings at this chance.
_SURELY = 7.0
# What their parameters are called: inertia, delays, bias, torque.
_CANDIDATES = (("size", "shape"), "delay.", "gyro_bias", "effects")
_GYRO = ("gyro_bias", "gyro_scale", "gyro_alignment")
# A torque is believed in if it leaves at most this part of what is left beyond noise by any error of a sensor: where
# only noise is left, and otherwise.
_LESS, _MUCH_LESS = 0.5, 0.1
# Standard error of a factor, or of a turn (rad), with which it is not told.
_VAGUE = 0.01
# A mass is known if its relative standard error is less than this.
_KNOWN = 0.1


@dataclass(frozen=True)
class FittedMass:
    """The mass that fits best.

    Attributes:
        value: kg; None if noise, another centre of mass, or what acted beside the recorded forces, hides it.
        error: its standard error, kg.
        explained: whether the given mass explains the motion as well.
        unit: of the positions, if none fits that are in m as they should be; "" for m.
    """

    value: float | None
    error: float
    explained: bool
    unit: str = ""


@dataclass(frozen=True)
class FittedInertia:
    """The inertia that fits best.

    Attributes:
        matrix: kg m^2, body axes.
        errors: standard errors of the principal moments, ascending, kg m^2; without that of the scale if no torque
            determines it.
        scaled: whether a torque determines the scale; otherwise it is that of the given inertia.
        explains: whether it leaves only noise.
        criterion: that of Schwarz, up to a constant.
    """

    matrix: Array
    errors: tuple[float, float, float]
    scaled: bool
    explains: bool
    criterion: float


@dataclass(frozen=True)
class FittedTorque:
    """A torque that is constant in each of some pieces of time.

    Attributes:
        edges_ns: (n + 1,), begin of each piece, and end of the last.
        body: (n, 3), N m, body axes.
        world: (n, 3), the same in world axes, at the middle of each piece.
    """

    edges_ns: Times
    body: Array
    world: Array


@dataclass(frozen=True)
class InertiaScore:
    """What a fit says about the inertia.

    Attributes:
        begin_ns: begin of the part that was fitted.
        end_ns: its end.
        explained: whether the given inertia leaves only noise.
        noise: standard deviation of a sample of the attitude, all components together, rad.
        noiseless: whether no sensor shows noise.
        scaled: whether a torque determines the scale of the inertia.
        unseen: for each principal moment, ascending, the relative error that noise may hide.
        inertia: the best-fitting one; None if the given one explains the motion, or no motion follows the recording.
        bias: the constant error of the rates that leaves only noise, rad/s, body axes; None if none does.
        late: whether a delay of a sensor or of the commands leaves only noise, and is likelier than another inertia.
        gyro: factors of the measured rates along each axis and rotation vector of its axes (rad) that leave only noise
            where no constant error does, and are likelier than another inertia; NaN if the rates do not tell which;
            None if none are.
        torque: the unrecorded torque that leaves only noise, and less than an error of a sensor; None if none does.
        pushed: whether a torque acted, by the fit: it leaves much less than an error of a sensor, or no sensor's error
            alone can be the cause.
    """

    begin_ns: int
    end_ns: int
    explained: bool
    noise: float
    scaled: bool
    unseen: tuple[float, float, float]
    noiseless: bool
    inertia: FittedInertia | None = None
    bias: Array | None = None
    late: bool = False
    gyro: Array | None = None
    torque: FittedTorque | None = None
    pushed: bool = False


def score_inertia_in_parts(track: Track, body: RigidBody, moving: TimeSeries) -> InertiaScore | None:
    """Return `score_inertia` of a part that the inertia does not explain; if there is none, of the parts together.

    Of a recording that is longer than `_PARTS` parts, those in the middle are fitted.
    """
    middle = score_inertia(track, body, moving)
    if middle is None or not middle.explained:
        return middle
    begin, end = middle.begin_ns, middle.end_ns
    first, last = track.span_ns
    length = end - begin
    for _ in range(_PARTS - 1):
        # The next part is on the side of which more is left, and begins where the last one ends.
        left, right = begin - first, last - end
        if max(left, right) <= 0.01 * (last - first):
            break
        around = end + length // 2 if right > left else begin - length // 2
        part = score_inertia(track, body, moving, around_ns=min(max(around, first), last))
        if part is None or part.begin_ns > end or part.end_ns < begin:
            break
        if not part.explained:
            return part
        if part.begin_ns >= begin and part.end_ns <= end:
            break
        begin, end = min(begin, part.begin_ns), max(end, part.end_ns)
    return replace(middle, begin_ns=begin, end_ns=end)


def score_inertia(
    track: Track, body: RigidBody, moving: TimeSeries, near_ns: int | None = None, around_ns: int | None = None
) -> InertiaScore | None:
    """Return what the attitude and the measured rates of `track` say about the inertia of `body`.

    None if no part in which the torque is known is long enough.

    Args:
        track: with a pose.
        body: the body.
        moving: a twist, also one that is computed from the pose: it tells how fast the body turns.
        near_ns: a time at which the inertia is known to leave something unexplained; what would explain it is asked
            for, and a long recording is judged around that time.
        around_ns: the time around which it is judged if nothing is known; None: its middle.
    """
    part = _part(track, moving, around_ns if near_ns is None else near_ns)
    if part is None:
        return None
    # A fit waits for its kernel: without it each step takes a hundred times as long.
    with counted_by(Tally()):
        return _Judge(body, *part).score(near_ns is not None)


def fitted_mass(track: Track, body: RigidBody, moving: TimeSeries, found: bool = False) -> FittedMass | None:
    """Return the mass that the forces and the translation of `track` tell; None without forces.

    Args:
        track: with a pose.
        body: the body, with an inertia that explains how it turned.
        moving: as in `score_inertia`.
        found: whether its inertia was found, not given: it is then fitted beside the mass, so that its error counts.
    """
    forces = [each for each in track.acting if not each.weight and len(each.time_ns)]
    sizes = [np.linalg.norm(each.force, axis=1) for each in forces]
    if not any(size.any() for size in sizes):
        return None
    strongest = max(zip(forces, sizes, strict=True), key=lambda each: each[1].max())
    part = _part(track, moving, int(strongest[0].time_ns[strongest[1].argmax()]), translation=True)
    if part is None:
        return None
    weights = [each.force[0] / body.mass for each in track.acting if each.weight]
    gravity, (flight, begin_ns) = tuple(UniformGravity(tuple(each.tolist())) for each in weights), part
    beside = ("inertia",) if found else ()
    with counted_by(Tally()):
        fitted = _Judge(body, flight, begin_ns, gravity).mass(beside)
        if fitted is not None and fitted.value is not None:
            return fitted
        for unit, size in POSITIONS.items():
            other = _Judge(body, _in_metres(flight, size), begin_ns, gravity).mass(beside)
            if other is not None and other.value is not None and not is_far(other.value, body.mass):
                return replace(other, explained=False, unit=unit)
    return fitted


def _in_metres(flight: Flight, size: float) -> Flight:
    """Return a flight of which positions and velocities are recorded in a unit of another size, m."""
    streams = (
        replace(each, values=size * each.values) if each.kind in (POSITION, VELOCITY) else each
        for each in flight.streams
    )
    return replace(flight, streams=tuple(streams))


def _part(
    track: Track, moving: TimeSeries, near_ns: int | None, translation: bool = False
) -> tuple[Flight, int] | None:
    """Return what is fitted, with times from its begin, and that; None for too few samples."""
    some = moving.values[:: max(1, len(moving.values) // _MOST), 3:]
    rate = float(np.median(np.linalg.norm(some, axis=1)))
    stretches = _known(track, rate)
    begin, end = next(
        (each for each in stretches if near_ns is not None and each[0] <= near_ns <= each[1]),
        max(stretches, key=lambda each: np.diff(np.searchsorted(moving.time_ns, each))[0], default=(0, 0)),
    )
    half = round(0.5 * _TURN / max(rate, 1e-9) * NANOSECONDS)
    if 2 * half < end - begin:
        middle = (begin + end) // 2 if near_ns is None else near_ns
        begin = min(max(begin, middle - half), end - 2 * half)
        end = begin + 2 * half
    every = [*_streams(track), *(_translation(track) if translation else [])]
    streams = [_thinned(stream, begin, end) for stream in every]
    if not streams or min(len(stream.time_ns) for stream in streams) < _FEWEST:
        return None
    first = min(int(stream.time_ns[0]) for stream in streams)
    channels = tuple(
        WrenchSeries(each.topic, each.time_ns[each.known] - first, held_rows(each)[each.known])
        for each in track.acting
        if each.known.any() and not each.weight
    )
    moved = tuple(replace(stream, time_ns=stream.time_ns - first) for stream in streams)
    return Flight(str(track.bag.path), moved, channels), first


def _known(track: Track, rate: float) -> list[tuple[int, int]]:
    """Return the stretches of time without holes in which all wrenches are known and nobody moved the body."""
    begin, end = track.span_ns
    found = [(begin, end)]
    unknown = [(track.breaks_ns, track.breaks_ns + 1)]
    measured = [each.time_ns for each in (track.pose, track.twist) if each is not None]
    unknown += [(np.array([begin]), np.array([end])) for begin, end in holes(measured, rate)]
    unknown += [(each.time_ns[~each.known], np.append(each.time_ns[1:], end)[~each.known]) for each in track.acting]
    for since, until in unknown:
        for low, high in zip(since.tolist(), until.tolist(), strict=True):
            found = [part for a, b in found for part in ((a, min(b, low)), (max(a, high), b)) if part[1] > part[0]]
    return found


def _streams(track: Track) -> list[Stream]:
    """Return what measures the rotation; attitudes as recorded, as those of a long recording take much memory."""
    found = []
    if track.pose is not None:
        found.append(Stream(track.pose.topic, ATTITUDE, track.pose.time_ns, track.pose.values[:, 3:]))
    if track.twist is not None and any(rows[:, 3:].any() for rows in in_blocks(track.twist.values)):
        rates, gyro = track.twist.values[:, 3:], track.from_imu(track.twist)
        found.append(
            Stream(track.twist.topic, RATES, track.twist.time_ns, rates, track.twist_in_world and not gyro, gyro=gyro)
        )
    return found


def _translation(track: Track) -> list[Stream]:
    """Return what measures the translation."""
    found = []
    if track.pose is not None:
        found.append(Stream(track.pose.topic, POSITION, track.pose.time_ns, track.pose.values[:, :3]))
    if track.twist is not None and not track.twist.partial:
        velocity = track.twist.values[:, :3]
        found.append(Stream(track.twist.topic, VELOCITY, track.twist.time_ns, velocity, track.twist_in_world))
    # Where another program left a field empty, it is not measured.
    return [stream for stream in found if any(rows.any() for rows in in_blocks(stream.values))]


def _thinned(stream: Stream, begin: int, end: int) -> Stream:
    """Return what a stream measured in a part, once at each stamp; of many samples, some evenly."""
    first, last = np.searchsorted(stream.time_ns, [begin, end + 1]).tolist()
    once = first + np.flatnonzero(np.diff(stream.time_ns[first:last], prepend=-1))
    rows = once[:: max(1, -(-len(once) // _MOST))]
    times, values = stream.time_ns[rows], stream.values[rows]
    kept = np.isfinite(values).all(axis=1)
    values = unit_rows(values[kept]) if stream.kind == ATTITUDE else values[kept]
    return replace(stream, time_ns=times[kept], values=values)


class _Tried(NamedTuple):
    """One step with a candidate in the model.

    Attributes:
        covariance: of the parameters of the candidate.
        chance: that a recording without what the candidate stands for looks like this.
        white: whether what is left is noise.
        level: mean square of what is left over the noise, at least 1.
        criterion: that of Schwarz, up to a constant: of two candidates, the one with less is the likelier.
    """

    covariance: Array
    chance: float
    white: bool
    level: float
    criterion: float

    @property
    def explains(self) -> bool:
        """Whether the candidate counts, and leaves only noise."""
        return self.white and self.chance <= _CHANCE


class _Fitted(NamedTuple):
    """A fit with a candidate in the model: its parameters, and a last step of the candidate's."""

    model: Model
    z: Array
    tried: _Tried

    def values(self, starts: str) -> Array:
        """Return the numbers of blocks whose names start like that."""
        layout = self.model.layout
        return np.concatenate([layout[name].values(self.z) for name in layout.blocks if name.startswith(starts)])


class _Judge:
    """A fit of the start alone, and what is tried beside it."""

    def __init__(self, body: RigidBody, flight: Flight, begin_ns: int, effects: tuple[Effect, ...] = ()) -> None:
        self.scene = Scene(body, WrenchFrames(), State(), effects=effects)
        self.flight, self.begin_ns = flight, begin_ns
        gyro = any(stream.gyro for stream in flight.streams)
        self.base = ("initial", "gyro_bias") if gyro else ("initial",)
        self.model = Model(self.scene, [flight], self.base)
        shown = noise_shown(self.model)
        self.floor = {key: _LESS_EXACT * floor_of(self.model, key) for key in shown}
        self.noise = {key: max(level, self.floor[key]) for key, level in shown.items()}
        self.noiseless = all(map(is_smooth, flight.streams))

    def score(self, doubtful: bool) -> InertiaScore:
        """Return what is found."""
        first, last = self.flight.span_ns
        attitude = (level for (_, kind, _), level in self.noise.items() if kind == ATTITUDE)
        noise, hidden = float(np.sqrt(3.0)) * next(attitude, 0.0), (np.inf, np.inf, np.inf)
        found = InertiaScore(self.begin_ns + first, self.begin_ns + last, False, noise, False, hidden, self.noiseless)
        return self._beside(followed(self.model, np.zeros(self.model.layout.count), self.noise), found, doubtful)

    def mass(self, beside: Sequence[str]) -> FittedMass | None:
        """Return the mass that fits best beside a delay and `beside`; None if no motion follows the recording."""
        # A delay may look like another mass.
        found = self._fitted(self.scene, ("mass", "delay", *beside))
        if found is None:
            return None
        model, at, tried = found
        change, deviation = float(at[model.layout["mass"].at][0]), float(np.sqrt(tried.covariance[0, 0]))
        mass = model.body(at).mass
        known = deviation <= _KNOWN and self._near_noise(list(model.predict(at, derivatives=False)))
        explained = not known or math.erfc(abs(change) / deviation / math.sqrt(2.0)) > _CHANCE
        return FittedMass(mass if known else None, mass * deviation, explained)

    def _beside(self, z: Array, found: InertiaScore, doubtful: bool) -> InertiaScore:
        """Return what is found beside a start."""
        edges = np.linspace(0.0, self.flight.span_ns[1] / NANOSECONDS, _PIECES + 1)
        nothing = Wrench(ZERO, ZERO, self.scene.frames.body_frame)
        pushed = replace(self.scene, effects=(ScheduledWrench(tuple((t, nothing) for t in edges[:-1].tolist())),))
        pieces = [f"effects[0].schedule[{k}].torque" for k in range(_PIECES)]
        wide = Model(pushed, [self.flight], (*self.base, "inertia", "delay", "gyro_bias", *pieces))
        at = self._within(wide, z)
        predicted = list(wide.predict(at))
        if not self._sane(predicted):
            # With an inertia in other units, no motion follows the recording.
            return replace(found, inertia=self._inertia())
        base = _columns(wide, self.model.layout.blocks)
        own = [[name for name in self._own(wide) if name.startswith(of)] for of in _CANDIDATES]
        tried = [self._tried(predicted, at, base, _columns(wide, names)) for names in own if names]
        found = replace(
            found,
            explained=self._near_noise(predicted) and all(each.chance > _CHANCE for each in tried),
            scaled=_scaled(tried[0].covariance),
            unseen=_unseen(wide, at, tried[0].covariance),
        )
        if found.explained and not doubtful:
            return found
        inertia, start = self._inertia(), self._tried(predicted, at, base, base[:0]).level - 1.0
        bias, gyro, late = (self._fitted(self.scene, groups, z) for groups in (_GYRO[:1], _GYRO, ("delay",)))
        pushes = self._fitted(pushed, pieces, z)
        errors = [each.tried.level - 1.0 for each in (bias, gyro, late) if each is not None]
        least, torque = min([start, *errors]), None
        beats, alone = False, [self._alone(stream) for stream in self.flight.streams]
        blameless = min(alone) > EXPLAINED**2 and min(errors, default=start) > _MUCH_LESS * start
        if pushes is not None:
            white, left = pushes.tried.white, pushes.tried.level - 1.0
            beats = left <= (_LESS if white else _MUCH_LESS) * least and (white or least > 0.0)
            if white and beats:
                torque = self._torque(edges, pushes.values("effects").reshape(-1, 3))
        rival = np.inf if inertia is None or not inertia.explains else inertia.criterion
        of_bias = None if bias is None or not bias.tried.explains else bias.values("gyro_bias")
        of_gyro = None
        if gyro is not None and gyro.tried.explains and gyro.tried.criterion < rival and of_bias is None:
            of_gyro = np.append(gyro.values("gyro_scale"), gyro.values("gyro_alignment"))
            if np.linalg.norm(gyro.tried.covariance, 2) > _VAGUE**2:
                of_gyro = np.full(6, np.nan)
        return replace(
            found,
            inertia=inertia,
            bias=of_bias,
            late=late is not None and late.tried.explains and late.tried.criterion < rival,
            gyro=of_gyro,
            torque=torque,
            pushed=beats or blameless,
        )

    def _within(self, wide: Model, z: Array) -> Array:
        """Return the parameters of a start as those of a model that has more."""
        found = np.zeros(wide.layout.count)
        for name, block in self.model.layout.blocks.items():
            found[wide.layout[name].at] = z[block.at]
        return found

    def _near_noise(self, predicted: Sequence[Predicted]) -> bool:
        """Return whether residuals are about the noise beneath them: one step tells little of what leaves more."""
        return all(
            float(np.sqrt(np.mean(each.left**2))) <= EXPLAINED * max(noise_of(self.model, each), self.floor[each.key])
            for each in predicted
        )

    def _sane(self, predicted: Iterable[Predicted]) -> bool:
        return all(sane(each.left, each.by, unit=self.noise[each.key]) for each in predicted)

    def _tried(
        self,
        predicted: Sequence[Predicted],
        z: Array,
        base: npt.NDArray[np.int64],
        own: npt.NDArray[np.int64],
        noise: dict[Key, float] | None = None,
    ) -> _Tried:
        """Return a step with the parameters `own` besides those of the `base`; `noise` is that of each sensor."""
        from scipy.special import fdtrc

        noise = self.noise if noise is None else noise
        left, weighted = stacked(predicted, noise)
        by = weighted[:, np.concatenate([base, own])]
        covariance = covariance_of(by)
        step = -covariance @ (by.T @ left)
        after, root = left + by @ step, root_of(covariance)
        counts = [len(each.left) for each in predicted]
        bands = bands_of(after, by, root, counts)
        parts = np.split(after.reshape(-1, 3), np.cumsum(counts)[:-1])
        white = all(
            whiteness([part], [of])[0] or float(np.sqrt(np.mean(part**2))) <= self.floor[each.key] / noise[each.key]
            for part, of, each in zip(parts, bands, predicted, strict=True)
        )
        freedom = max(1.0, float(len(left) - by.shape[1]))
        level = max(1.0, float(after @ after) / freedom)
        criterion = len(left) * np.log(level) + by.shape[1] * np.log(len(left))
        if white:
            covariance = covariance * level
        else:
            covariance, freedom = widened(root, bands)
        mine, change = covariance[len(base) :, len(base) :], z[own] + step[len(base) :]
        sizes, axes = np.linalg.eigh(mine)
        seen = axes[:, sizes < TOLD**2]
        chance = 1.0
        if seen.shape[1]:
            along = seen.T @ change
            statistic = float(along @ np.linalg.solve(seen.T @ mine @ seen, along)) / len(along)
            chance = float(fdtrc(len(along), freedom, statistic))
        return _Tried(mine, chance, white, level, float(criterion))

    def _inertia(self) -> FittedInertia | None:
        """Return the inertia that fits best; None if no motion follows the recording."""
        found = self._fitted(self.scene, ("inertia",))
        if found is None:
            return None
        model, at, tried = found
        matrix, scaled, covariance = model.body(at).inertia, _scaled(tried.covariance), tried.covariance
        if not scaled:
            matrix = matrix * model.inertia.trace / np.trace(matrix)
            covariance = covariance.copy()
            covariance[0] = covariance[:, 0] = 0.0
        by = _of_moments(model, at, matrix)
        errors = np.sqrt(np.einsum("ij,jk,ik->i", by, covariance, by)).tolist()
        return FittedInertia(matrix, (errors[0], errors[1], errors[2]), scaled, tried.white, tried.criterion)

    def _fitted(self, scene: Scene, groups: Sequence[str], z: Array | None = None) -> _Fitted | None:
        """Return the best fit with `groups` besides the start, from that start or several.

        None if they add nothing, or no motion follows the recording. A fit that leaves only noise is the best: no other
        start can improve it.
        """
        model = Model(scene, [self.flight], (*self.base, *groups))
        own = _columns(model, self._own(model))
        base = np.setdiff1d(np.arange(model.layout.count), own)
        best: _Fitted | None = None
        for start in starts_of(model, self.noise) if z is None else [self._within(model, z)] * bool(len(own)):
            # From an inertia in other units, a search may go far astray.
            with np.errstate(over="ignore", invalid="ignore"):
                at = followed(model, start, self.noise)
                predicted = list(model.predict(at))
            if not self._sane(predicted):
                continue
            tried = self._tried(predicted, at, base, own)
            if not tried.white and tried.level == 1.0:
                at, tried = self._quieter(model, at, predicted, base, own)
            if best is None or tried.criterion < best.tried.criterion:
                best = _Fitted(model, at, tried)
            if tried.white:
                break
        return best

    def _quieter(
        self,
        model: Model,
        z: Array,
        predicted: Sequence[Predicted],
        base: npt.NDArray[np.int64],
        own: npt.NDArray[np.int64],
    ) -> tuple[Array, _Tried]:
        """Return a fit that leaves less than the noise with each sensor weighted by what it leaves, and its last step.

        A sensor between whose samples torques change shows more noise than it has. It then counts too little, and what
        the others leave to it is not white.
        """
        left = {each.key: float(np.sqrt(np.mean(each.left**2))) for each in predicted}
        noise = {key: max(min(level, left.get(key, level)), self.floor[key]) for key, level in self.noise.items()}
        at = followed(model, z, noise)
        return at, self._tried(list(model.predict(at)), at, base, own, noise)

    def _own(self, model: Model) -> list[str]:
        """Return the blocks of a model besides the start."""
        return [name for name in model.layout.blocks if name not in self.model.layout]

    def _alone(self, stream: Stream) -> float:
        """Return the mean square that the given inertia leaves of one sensor over its noise; inf if it diverges."""
        model = Model(self.scene, [replace(self.flight, streams=(stream,))], self.base)
        # Under torques in other units, even what follows one sensor may diverge.
        with np.errstate(over="ignore", invalid="ignore"):
            at = followed(model, np.zeros(model.layout.count), self.noise)
            predicted = list(model.predict(at))
        if not self._sane(predicted):
            return np.inf
        return self._tried(predicted, at, _columns(model, model.layout.blocks), _columns(model, ())).level

    def _torque(self, edges: Array, body: Array) -> FittedTorque:
        """Return a torque; in world axes by the attitude that was measured next to the middle of each piece."""
        from rb_dynamics.numerics.rotation_arrays import rotate_all

        attitude = next(stream for stream in self.flight.streams if stream.kind == ATTITUDE)
        ends = np.rint(edges * NANOSECONDS).astype(np.int64)
        near = np.searchsorted(attitude.time_ns, (ends[1:] + ends[:-1]) // 2)
        world = rotate_all(attitude.values[np.minimum(near, len(attitude.values) - 1)], body)
        return FittedTorque(self.begin_ns + ends, body, world)


def _columns(model: Model, names: Iterable[str]) -> npt.NDArray[np.int64]:
    """Return where the parameters of some blocks are."""
    every = np.arange(model.layout.count, dtype=np.int64)
    return np.concatenate([every[:0], *(every[model.layout[name].at] for name in names)])


def _scaled(covariance: Array) -> bool:
    """Return whether the size of an inertia, the first of its numbers, is determined."""
    return bool(covariance[0, 0] < TOLD**2)


def _of_moments(model: Model, z: Array, matrix: Array) -> Array:
    """Return the derivatives (3, 6) of the principal moments of an inertia, ascending, by its size and shape."""
    _, axes = np.linalg.eigh(matrix)
    six = model.inertia.derivative(*model.size_and_shape(z))[1]
    found: Array = np.array([[axis @ rows_of(column) @ axis for column in six.T] for axis in axes.T])
    return found


def _unseen(model: Model, z: Array, covariance: Array) -> tuple[float, float, float]:
    """Return the relative error of each principal moment, ascending, that noise may hide."""
    matrix = model.body(z).inertia
    moments, axes = np.linalg.eigh(matrix)
    by = model.inertia.derivative(*model.size_and_shape(z))[1]
    told, found = np.linalg.inv(covariance), []
    for moment, axis in zip(moments, axes.T, strict=True):
        change = [moment * axis[i] * axis[j] for i, j in PLACES]
        numbers = np.linalg.lstsq(by, np.array(change), rcond=None)[0]
        effect = float(np.sqrt(numbers @ told @ numbers))
        found.append(_SURELY / effect if effect > 0.0 else np.inf)
    return found[0], found[1], found[2]
