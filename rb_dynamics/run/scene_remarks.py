"""What is wrong with a scene or its commands, in full sentences: for `explain` and for the log of a run."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from statistics import median

from rb_dynamics.loads.wheel_imbalance import RESOLVED
from rb_dynamics.loads.wheel_set import shares
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import rotate_inverse
from rb_dynamics.numerics.vector import dot, norm
from rb_dynamics.run.simulation import Command, Simulation
from rb_dynamics.scene.model import Scene

_NEAR = 0.8
"""Part of what a wheel can hold from which it is near its limit."""

TURN_SEEN = 0.5
"""Angle between samples (rad) beyond which a controller does not see how the body turns."""

STREAM = 5
"""At least this many commands of a topic are a stream."""


def scene_remarks(scene: Scene) -> list[str]:
    """Return the remarks; empty for most scenes."""
    return [*_wheels_too_full(scene), *_sensors_too_slow(scene), *_steps_too_long(scene)]


def command_remarks(commands: Iterable[Command], rate: float) -> list[str]:
    """Return which streams of commands are slower than a body that turns with `rate` (rad/s); none if all keep up."""
    stamps: dict[str, list[int]] = {}
    for topic, command in commands:
        stamps.setdefault(topic, []).append(command.stamp_ns)
    found = []
    for topic, times in stamps.items():
        if len(times) >= STREAM:
            period_s = median(b - a for a, b in pairwise(sorted(times))) / NANOSECONDS
            if rate * period_s > TURN_SEEN:
                found.append(too_slow(topic, rate * period_s))
    return found


def too_slow(topic: str, turn: float) -> str:
    """Return the remark on commands between which a body turns by `turn` rad."""
    return (
        f"{topic}: the body turns by {turn:.2g} rad from one command to the next, while the last is held; if a "
        "controller sends them, raise its rate"
    )


def _wheels_too_full(scene: Scene) -> list[str]:
    """Return which wheels cannot hold the momentum of the body and would saturate; none if they can."""
    rows = shares([wheel.axis for wheel in scene.wheels])
    if rows is None:
        return []
    # About the centre of mass, body axes; a wheel turns with the body, and by itself.
    momentum = Simulation(scene).sample.angular_momentum_world
    momentum = rotate_inverse(scene.initial.orientation_xyzw, momentum)
    found = []
    for wheel, row in zip(scene.wheels, rows, strict=True):
        share, held = abs(dot(row, momentum)), wheel.inertia * wheel.max_speed
        if share > _NEAR * held:
            found.append(
                f"{wheel.name} holds {held:.3g} N m s at its max_speed, and would have to hold {share:.3g} N m s for "
                f"the wheels to bring the body to rest: it {'saturates' if share > held else 'comes near that'}; take "
                "momentum out otherwise, or allow it more speed"
            )
    return found


def _sensors_too_slow(scene: Scene) -> list[str]:
    """Return which sensors are slower than the body turns at first; none if all keep up."""
    rate = norm(scene.initial.angular_velocity_body)
    return [
        f"{sensor.name}: the body turns by {rate / sensor.rate:.2g} rad from one message to the next at its initial "
        "rate, too far for a controller that hears it; raise its rate"
        for sensor in scene.sensors
        if rate > TURN_SEEN * sensor.rate
    ]


def _steps_too_long(scene: Scene) -> list[str]:
    """Return in whose turning fixed steps may see no imbalance; none if they are short enough."""
    step, found = scene.solver.step, []
    for wheel in scene.wheels:
        speed = max(abs(wheel.speed), 0.0 if math.isinf(wheel.max_speed) else wheel.max_speed)
        if step is not None and not wheel.is_balanced and speed * step > RESOLVED:
            found.append(
                f"{wheel.name} turns by {speed * step:.2g} rad in a step of {step:g} s at {speed:g} rad/s, too far to "
                f"resolve its imbalance; take a step of {RESOLVED / speed:.1g} s or less, or give "
                "solver.accuracy"
            )
    return found
