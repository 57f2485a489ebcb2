"""Steps from many starts at once, where one of them is refused."""

from __future__ import annotations

import numpy as np
import pytest

from rb_dynamics import METHODS, RigidBody, State
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.array_steps import steps_from
from rb_dynamics.motion.kernel_layout import phase_numbers
from rb_dynamics.motion.phase_state import PhaseState, inertia_of


@pytest.mark.parametrize("name", [each.name for each in METHODS.values() if each.takes_arrays and each.compiles])
def test_a_step_that_turns_too_far_refuses_all(name: str) -> None:
    """It ended with a TypeError: the message of the step formats numbers, here arrays."""
    body = RigidBody.from_diagonal(1.0, (1.0, 2.0, 3.0))
    phase = phase_numbers(PhaseState.of(body, State(angular_velocity_body=(0.0, 1.5, 30.0))))
    starts, lengths = np.array([phase, phase]).T, np.array([1e-3, 2.0])
    method, inertia = METHODS[name], inertia_of(body)
    assert steps_from(method, inertia, HeldWrench(), lengths, 1, starts, ()) is None
    kept = steps_from(method, inertia, HeldWrench(), lengths[:1], 1, starts[:, :1], ())
    assert kept is not None
    assert np.isfinite(kept).all()
