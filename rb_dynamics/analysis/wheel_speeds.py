"""Speeds of reaction wheels as a bag recorded them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rb_dynamics.analysis.gaps import after_gaps, longest_usual
from rb_dynamics.analysis.track import Array, Times
from rb_dynamics.errors import LogError
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.formats.joint_states import names_of, velocities
from rb_dynamics.formats.message_types import JOINTS
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.logs.bag_reader import Bag
from rb_dynamics.logs.topics_of_channels import foreign_to
from rb_dynamics.numerics.nanoseconds import NANOSECONDS

# A curve between two samples has this many straight parts: they are nearer to it than the chord by its square.
_FINER = 4
# Samples follow each other evenly where none is later than the usual by this factor.
_EVEN = 1.5
# Of differences that tell the noise of speeds, and the median of the size of a normal number.
_ORDERS, _MEDIAN = (3, 5, 7), 0.6745
# Steps to which speeds may be rounded, rad/s, the coarsest first: from 10 rpm and 1 rad/s; speeds fit to this share.
_STEPS = tuple(unit * part * 10.0**-digits for digits in range(4) for part in (1.0, 0.5) for unit in (math.pi / 3, 1.0))
_OFF_STEP = 1e-4
# A recorder hears of topics one after the other, within so many ns.
_LATE_NS = NANOSECONDS
# Noise, or a body that turns a wheel at its limit, takes it no further beyond its `max_speed`, by this factor.
_BEYOND = 1.5


class WheelSpeeds(NamedTuple):
    """Speeds relative to the body (rad/s), linear between the times; of all wheels of a scene, in its order.

    Attributes:
        topic: as recorded.
        time_ns: (n,), ascending, each once.
        speeds: (n, wheels).
        stamped: whether the messages have stamps; without, times are those at which they were logged.
    """

    topic: str
    time_ns: Times
    speeds: Array
    stamped: bool = True

    @classmethod
    def of(cls, topic: str, time_ns: Times, speeds: Array) -> WheelSpeeds:
        """Return the same of times in any order, of which some may come again, and of speeds that may be missing."""
        whole = np.isfinite(speeds).all(axis=1)
        at, first = np.unique(time_ns[whole], return_index=True)
        return cls(topic, at, speeds[whole][first])

    def since(self, zero_ns: int) -> WheelSpeeds:
        """Return the same with times from `zero_ns`."""
        return self._replace(time_ns=self.time_ns - zero_ns)

    @property
    def remarks(self) -> list[str]:
        """What is assumed about the speeds, for the user."""
        after = after_gaps(self.time_ns)
        gaps = "" if self.stamped else "; without stamps, they count from when they were logged"
        if len(after):
            longest = float(np.diff(self.time_ns)[after - 1].max()) / NANOSECONDS
            some = f"{len(after)} gaps, the longest of" if len(after) > 1 else "a gap of"
            gaps += f"; it has {some} {longest:.3g} s"
        return [f"{self.topic}: speeds of the wheels are taken as recorded, and as linear in between{gaps}"]

    def beyond(self, wheels: Sequence[ReactionWheel]) -> list[str]:
        """Return a remark on wheels, in the order of the speeds, that turn far beyond their `max_speed`."""
        fastest = np.abs(self.speeds).max(axis=0, initial=0.0).tolist()
        told = [
            f"{wheel.name} turns at up to {speed:.4g} rad/s, with a max_speed of {wheel.max_speed:g} rad/s"
            for wheel, speed in zip(wheels, fastest, strict=True)
            if speed > _BEYOND * wheel.max_speed
        ]
        unit = "an inertia is wrong by 9.55 if the speeds are in rpm, by 57.3 if in degrees/s"
        return [f"{self.topic}: {'; '.join(told)}: {unit}"] if told else []

    def curved(self, draw: np.random.Generator | None = None) -> WheelSpeeds:
        """Return the same on a finer grid, with a smooth curve between the samples; Akima, J. ACM 17 (1970) 589.

        With `draw`, the curve lies on this or on the other side of the straight line, between any two samples anew.
        """
        if len(self.time_ns) < 3:
            return self
        from scipy.interpolate import Akima1DInterpolator

        steps = np.diff(self.time_ns)[:, None] * np.arange(1, _FINER) // _FINER
        between = (self.time_ns[:-1, None] + steps).ravel()
        curve = Akima1DInterpolator((self.time_ns - self.time_ns[0]) * 1e-9, self.speeds)
        finer = curve((between - self.time_ns[0]) * 1e-9)
        if draw is not None:
            share = np.tile(np.arange(1, _FINER) / _FINER, len(steps))[:, None]
            straight = np.repeat(self.speeds[:-1], _FINER - 1, axis=0)
            straight += share * np.repeat(np.diff(self.speeds, axis=0), _FINER - 1, axis=0)
            sides = np.repeat(draw.choice((-1.0, 1.0), (len(steps), finer.shape[1])), _FINER - 1, axis=0)
            finer = straight + sides * (finer - straight)
        return self.of(self.topic, np.append(self.time_ns, between), np.vstack([self.speeds, finer]))

    @property
    def noise(self) -> Array:
        """Standard deviation of each wheel's speeds, rad/s, by differences of high order; rounding counts as noise.

        Of white noise those of any order tell the same, of what the wheels did the highest tell least; the median
        passes over jumps of a torque.
        """
        spans = np.diff(self.time_ns)
        found = np.full(self.speeds.shape[1], np.inf)
        for order in _ORDERS:
            if len(spans) < order:
                break
            even = np.convolve(spans <= _EVEN * np.median(spans), np.ones(order, dtype=int), "valid") == order
            sizes = np.abs(np.diff(self.speeds, order, axis=0)[even]) / math.comb(2 * order, order) ** 0.5
            if not len(sizes):
                break
            median, mean = np.median(sizes, axis=0) / _MEDIAN, np.sqrt(np.mean(sizes**2, axis=0))
            # Where most do not change at all, they are rounded.
            found = np.minimum(found, np.where(median > 0.0, median, mean))
        return np.where(np.isfinite(found), found, 0.0)

    @property
    def offset(self) -> Array:
        """Standard deviation by rounding of each wheel's speeds where these hold still, rad/s: no sample shows it.

        Those of a wheel at rest are taken as true.
        """
        still = [len(np.unique(each)) <= 2 and bool(each.any()) for each in self.speeds.T]
        for step in _STEPS if any(still) else ():
            levels = self.speeds / step
            if np.abs(levels - np.rint(levels)).max() <= _OFF_STEP:
                return np.where((np.ptp(levels, axis=0) < 1.5) & still, step / math.sqrt(12.0), 0.0)
        return np.zeros(len(still))

    def disturbed(self, number: int, by: float = 1.0) -> WheelSpeeds:
        """Return the same with more noise, `by` times as large as that in it; of a `number` the same at every call."""
        draw = np.random.default_rng(number)
        more = self.noise * draw.standard_normal(self.speeds.shape)
        return self._replace(speeds=self.speeds + by * (more + self.offset * draw.standard_normal(len(more.T))))

    def part_of(self, first_ns: int, last_ns: int) -> tuple[int, int]:
        """Return an interval without a second or less at an end, for which no speeds were recorded.

        It is left as it is where the speeds reach beyond the other end: those of another clock do.
        """
        if len(self.time_ns) < 2:
            return first_ns, last_ns
        usual = longest_usual(self.time_ns) if len(self.time_ns) > 3 else 0.0
        late, early = int(self.time_ns[0]) - first_ns, last_ns - int(self.time_ns[-1])
        begins_late = usual < late <= _LATE_NS and -2 * early < late
        ends_early = usual < early <= _LATE_NS and -2 * late < early
        return first_ns + late * begins_late, last_ns - early * ends_early

    def reaching(self, first_ns: int, last_ns: int, path: str) -> WheelSpeeds:
        """Return the same from `first_ns` to `last_ns`: what an interval misses goes on as the samples next to it do.

        Raises:
            LogError: more than an interval is missing at an end.
        """
        if not len(self.time_ns):
            raise LogError(f"{path}: {self.topic}: no speed is a number, expected those of the wheels; record it again")
        begin, end = int(self.time_ns[0]), int(self.time_ns[-1])
        usual = longest_usual(self.time_ns) if len(self.time_ns) > 3 else 0.0
        if begin - first_ns > usual or last_ns - end > usual:
            raise LogError(
                f"{path}: {self.topic} has speeds of the wheels from {begin * 1e-9:.6g} to {end * 1e-9:.6g} s, and the "
                f"motion is recorded from {first_ns * 1e-9:.6g} to {last_ns * 1e-9:.6g} s, expected speeds throughout; "
                "stamp both by one clock, or cut the recording with convert --from or --to"
            )
        at = np.array([*[first_ns] * (first_ns < begin), *[last_ns] * (last_ns > end)], dtype=np.int64)
        if len(self.time_ns) < 2 or not len(at):
            return self
        rows = np.where(at < begin, 0, len(self.time_ns) - 2)
        slopes = np.diff(self.speeds, axis=0)[rows] / np.diff(self.time_ns)[rows, None]
        there = self.speeds[rows] + slopes * (at - self.time_ns[rows])[:, None]
        return self.of(self.topic, np.append(self.time_ns, at), np.vstack([self.speeds, there]))


def wheel_speeds(bag: Bag, wheels: Sequence[ReactionWheel], near: str = "") -> WheelSpeeds:
    """Return the speeds of all `wheels` from the topic that has most of them, by its stamps, if it has any.

    Of several bodies in one bag it is that of the motion `near`, by their namespaces.

    Raises:
        LogError: no topic tells them.
    """
    names = [wheel.name for wheel in wheels]
    parts: dict[str, list[tuple[Times, Times, Array]]] = {}
    listed: dict[str, list[str]] = {}
    joints = {topic.name for topic in bag.topics.values() if topic.type_name == JOINTS}
    for block in open_source(bag.path).blocks() if joints else ():
        if block.channel.topic in joints:
            told, stamps, speeds = velocities(block, names)
            listed.setdefault(block.channel.topic, names_of(block))
            parts.setdefault(block.channel.topic, []).append((block.log_times[told], stamps, speeds))
    found = {
        topic: [np.concatenate(columns) for columns in zip(*each, strict=True)]
        for topic, each in parts.items()
        if any(len(stamps) for _, stamps, _ in each)
    }
    if not found:
        heard = "; ".join(f"{topic} has {', '.join(each) or 'no joint'}" for topic, each in sorted(listed.items()))
        raise LogError(
            f"{bag.path}: speeds of {', '.join(names)} are not recorded, expected a topic of {JOINTS} that has the "
            f"velocities of joints of these names ({heard or 'no such topic'}); name the wheels of the scene like the "
            "joints, or leave them out with --set actuators=[] if they stood still"
        )
    foreign = foreign_to(near, found) if near else []
    topic = max(found, key=lambda name: (name not in foreign, len(found[name][0])))
    log_times, stamps, speeds = found[topic]
    stamped = bool(stamps.any())
    return WheelSpeeds.of(topic, stamps if stamped else log_times, speeds)._replace(stamped=stamped)
