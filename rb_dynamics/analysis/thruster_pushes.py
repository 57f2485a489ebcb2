"""What thrusters did to the body, by the commands that a bag has."""

from __future__ import annotations

import itertools

import numpy as np

from rb_dynamics.analysis.track import Array, Times
from rb_dynamics.loads.actuator_bank import ActuatorBank
from rb_dynamics.loads.gradual_wrench import Transient
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.scene.model import Scene

# A ramp, up to where another change ends it, counts as steps of their mean force, which keep its impulse: so many, and
# one more for each sample in it, at which the impulse so far is right, too.
_STEPS = 10


def pushes(thruster: Thruster, scene: Scene, time_ns: Times, values: Array, sampled_ns: Times) -> tuple[Times, Array]:
    """Return when the wrench of a thruster changes (ns), ascending, and rows of force and torque, body axes.

    Commands act as in a run: after their delay, in place of the one before; those that are invalid do not. Torques are
    about the centre of mass of the scene. At `sampled_ns`, ascending, the impulse is right within a ramp, too.
    """
    bank = ActuatorBank([thruster], scene.body, scene.frames, scene.combined_effects.magnetic_field)
    for at, value in zip(time_ns.tolist(), values.tolist(), strict=True):
        bank.post(thruster.topic, value, at)
    found: list[tuple[int, HeldWrench]] = []
    ramp: Transient | None = None
    while (now := bank.next_change_ns()) is not None:
        bank.apply(now)
        if not bank.changed:
            # A command that comes while the force ramps may act later, or never.
            continue
        if ramp is not None:
            found += _steps(ramp, now, sampled_ns)
        ramp = next(iter(bank.transients()), None)
        if ramp is None:
            found.append((now, bank.held()))
    rows = [(*held.force_body, *held.torque_body) for _, held in found]
    return np.array([at for at, _ in found], dtype=np.int64), np.array(rows, dtype=np.float64).reshape(-1, 6)


def _steps(ramp: Transient, until_ns: int, sampled_ns: Times) -> list[tuple[int, HeldWrench]]:
    """Return the steps of a ramp, each with its begin (ns)."""
    first, last = np.searchsorted(sampled_ns, (ramp.since_ns, until_ns))
    even = ramp.since_ns + np.round((until_ns - ramp.since_ns) * np.arange(_STEPS + 1) / _STEPS).astype(np.int64)
    ends = np.union1d(even, sampled_ns[first:last]).tolist()
    return [
        (begin, ramp.aged(1e-9 * (0.5 * ((begin - ramp.since_ns) + (end - ramp.since_ns)))))
        for begin, end in itertools.pairwise(ends)
    ]
