"""Warnings about a scene or its commands, in full sentences: for `explain` and for the log of a run."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING

from rb_dynamics.loads.magnetic_field import MagneticField
from rb_dynamics.loads.reaction_wheel import friction_rate
from rb_dynamics.loads.wheel_imbalance import RESOLVED
from rb_dynamics.loads.wheel_set import WheelSet, shares
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import rotate_inverse
from rb_dynamics.numerics.vector import dot, norm
from rb_dynamics.run.sample import Sample, SampleBuilder
from rb_dynamics.scene.model import Scene

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers

_NEAR = 0.8
"""Fraction of the momentum that a wheel can hold from which it counts as near its limit."""

# Number of times by which friction would slow a wheel by a factor e within a step.
_SLOWED = 2.0

# Change of the Earth's field in a year: root mean square and largest on its surface, nT.
_SECULAR_RMS, _SECULAR_MOST, _YEAR, _MONTH = 80.0, 220.0, 365.25 * 86400.0, 30.0 * 86400.0

TURN_SEEN = 0.5
"""Angle between samples (rad) beyond which a controller cannot follow the body."""

STREAM = 5
"""Least number of commands of a topic that count as a stream."""


def scene_remarks(scene: Scene) -> list[str]:
    """Return the remarks; empty for most scenes."""
    return [*_wheels_too_full(scene), *_sensors_too_slow(scene), *_steps_too_long(scene), *_field_too_old(scene)]


def command_remarks(commands: Iterable[tuple[str, int]], scene: Scene, end: Sample) -> list[str]:
    """Return which streams of commands are slower than the body of a run that came to `end`; none if all keep up.

    Of each command, `commands` has topic and stamp (ns).
    """
    topics = *(each.topic for each in scene.channels), *(each.topic for each in scene.actuators)
    known = {topic.lstrip("/") for topic in topics}
    stamps: dict[str, list[int]] = {}
    for topic, stamp_ns in commands:
        if topic.lstrip("/") in known:
            stamps.setdefault(topic, []).append(stamp_ns)
    streams = {topic: times for topic, times in stamps.items() if len(times) >= STREAM}
    if not streams:
        return []
    rate = max(norm(scene.initial.angular_velocity_body), norm(end.angular_velocity_body))
    nutation, found = nutation_rate(scene, end), []
    for topic, times in streams.items():
        period_s = median(b - a for a, b in pairwise(sorted(times))) / NANOSECONDS
        found += too_slow(topic, rate, nutation, period_s)
    return found


def too_slow(topic: str, rate: float, nutation: float, period_s: float) -> list[str]:
    """Return the remark on commands between which a body turns or nutates (rad/s) too far; none if not."""
    turn, moves = max((rate * period_s, "turns"), (nutation * period_s, "nutates"))
    found = (
        f"{topic}: the body {moves} by {turn:.2g} rad from one command to the next, while the last is held; if a "
        "controller sends them, raise its rate"
    )
    return [found] if turn > TURN_SEEN else []


def _wheels_too_full(scene: Scene) -> list[str]:
    """Return which wheels would saturate, or nearly so, if they brought the body to rest."""
    rows = shares([wheel.axis for wheel in scene.wheels])
    if rows is None:
        return []
    # About the centre of mass, body axes.
    momentum = _first_sample(scene).angular_momentum_world
    momentum = rotate_inverse(scene.initial.orientation_xyzw, momentum)
    found = []
    for wheel, row in zip(scene.wheels, rows, strict=True):
        share, held = abs(dot(row, momentum)), wheel.inertia * wheel.max_speed
        if share > _NEAR * held:
            found.append(
                f"{wheel.name} holds {held:.3g} N m s at its max_speed, and would have to hold {share:.3g} N m s for "
                f"the wheels to bring the body to rest: it {'saturates' if share > held else 'comes near that'}; "
                "unload momentum by other means, or raise max_speed"
            )
    return found


def _sensors_too_slow(scene: Scene) -> list[str]:
    """Return which sensors are too slow for the initial rate or the nutation of the body; none if all keep up."""
    if not scene.sensors:
        return []
    rate, moves, why = norm(scene.initial.angular_velocity_body), "turns", "at its initial rate"
    if (nutation := nutation_rate(scene)) > rate:
        rate, moves, why = nutation, "nutates", "with the momentum of its wheels and rotors"
    return [
        f"{sensor.name}: the body {moves} by {rate / sensor.rate:.2g} rad from one message to the next {why}, too far "
        "for a controller to follow; raise the sensor's rate"
        for sensor in scene.sensors
        if rate > TURN_SEEN * sensor.rate
    ]


def nutation_rate(scene: Scene, at: Sample | None = None) -> float:
    """Return how fast small motion about rest nutates, rad/s; 0 without wheels and rotors that turn.

    With the momentum of wheels and rotors in the sample `at`, or at the start.
    """
    if not has_momentum_inside(scene):
        return 0.0
    import numpy as np

    _, _, turning = gyrostat(scene, at)
    return float(np.abs(np.linalg.eigvals(turning)).max())


def has_momentum_inside(scene: Scene) -> bool:
    """Return whether wheels or rotors may turn inside the body."""
    return bool(scene.wheels) or scene.combined_effects.storing() is not None


def gyrostat(scene: Scene, at: Sample | None = None) -> tuple[Numbers, Numbers, Numbers]:
    """Return the linear model of a body with wheels and rotors, in body axes and with their speeds in the sample `at`.

    Without one, with those at the start.

    The momentum h of the wheels and rotors (N m s), the inverse of the inertia without the wheels about their axes, and
    A of small motion about rest, w' = A w = I^-1 (h x w).
    """
    import numpy as np

    at = at or _first_sample(scene)
    whole = rotate_inverse(at.orientation_xyzw, at.angular_momentum_world)
    inertia: Numbers = np.array(scene.body.inertia)
    x, y, z = inside = np.array(whole) - inertia @ np.array(at.angular_velocity_body)
    axes = [(wheel.inertia, np.array(wheel.axis) / norm(wheel.axis)) for wheel in scene.wheels]
    inverse = np.linalg.inv(inertia - sum((j * np.outer(a, a) for j, a in axes), np.zeros((3, 3)))).astype(np.float64)
    turning: Numbers = inverse @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return inside, inverse, turning


def _first_sample(scene: Scene) -> Sample:
    """Return the sample at time 0; defects of balances are 0, also where the scene continues a run."""
    earlier_ns = 0 if scene.past is None else scene.past.length_ns
    phase = PhaseState.of(scene.body, scene.initial, earlier_ns / NANOSECONDS)
    wheels = WheelSet(scene.wheels, scene.body) if scene.wheels else None
    if wheels is not None:
        phase = phase.with_inner(wheels.begin(phase.angular_velocity))
    return SampleBuilder(scene.combined_effects, phase, wheels).sample(phase, 0)


def _steps_too_long(scene: Scene) -> list[str]:
    """Return the wheels whose imbalance or friction fixed steps are too long to resolve; none if short enough."""
    step, found = scene.solver.step, []
    slowing, slowed = friction_rate(scene.wheels, scene.body)
    if step is not None and slowing * step > _SLOWED:
        found.append(
            f"{slowed}, which steps of {step:g} s do not resolve: its speed and the energy may be far off; take a step "
            f"of {1.0 / slowing:.1g} s or less, or give solver.accuracy"
        )
    for wheel in scene.wheels:
        speed = max(abs(wheel.speed), 0.0 if math.isinf(wheel.max_speed) else wheel.max_speed)
        if step is not None and not wheel.is_balanced and speed * step > RESOLVED:
            found.append(
                f"{wheel.name} turns by {speed * step:.2g} rad in a step of {step:g} s at {speed:g} rad/s, too far to "
                f"resolve its imbalance; take a step of {RESOLVED / speed:.1g} s or less, or give "
                "solver.accuracy"
            )
    return found


def _field_too_old(scene: Scene) -> list[str]:
    """Return that the Earth's field stays that of its epoch, for a run in which it changes noticeably."""
    if not any(isinstance(each, MagneticField) and each.model == "igrf" for each in scene.effects):
        return []
    if scene.duration is None or scene.duration <= _MONTH:
        return []
    days, years = scene.duration / 86400.0, scene.duration / _YEAR
    changed = f"{years * _SECULAR_RMS:.0f} nT, at places by {years * _SECULAR_MOST:.0f} nT"
    frozen = f"the coefficients of igrf stay those of its epoch; after {days:.0f} days the field has changed by about"
    return [f"magnetic_field: {frozen} {changed}; divide the run, with an epoch for each part"]
