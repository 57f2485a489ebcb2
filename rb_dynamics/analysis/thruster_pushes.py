"""What thrusters did to the body, by the commands that a bag has."""

from __future__ import annotations

import numpy as np

from rb_dynamics.analysis.track import Array, Times
from rb_dynamics.loads.actuator_bank import ActuatorBank
from rb_dynamics.loads.gradual_wrench import Transient
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.scene.model import Scene

# A ramp, up to where another change ends it, counts as steps of its mean force, which keep its impulse.
_STEPS = 10


def pushes(thruster: Thruster, scene: Scene, time_ns: Times, values: Array) -> tuple[Times, Array]:
    """Return when the wrench of a thruster changes (ns), ascending, and rows of force and torque, body axes.

    Commands act as in a run: after their delay, in place of the one before; those that are invalid do not. Torques are
    about the centre of mass of the scene.
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
            span = now - ramp.since_ns
            found += [
                (ramp.since_ns + round(span * k / _STEPS), ramp.aged(1e-9 * span * (k + 0.5) / _STEPS))
                for k in range(_STEPS)
            ]
        ramp = next(iter(bank.transients()), None)
        if ramp is None:
            found.append((now, bank.held()))
    rows = [(*held.force_body, *held.torque_body) for _, held in found]
    return np.array([at for at, _ in found], dtype=np.int64), np.array(rows, dtype=np.float64).reshape(-1, 6)
