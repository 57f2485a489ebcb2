"""A state keeps its numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rb_dynamics import State, Wrench


@pytest.mark.parametrize("made", [np.array, list])
@pytest.mark.parametrize("name", ["position_world", "linear_velocity_world", "angular_velocity_body"])
def test_a_later_change_of_what_was_given_does_not_change_it(made: Any, name: str) -> None:
    """A state that was made in a loop from one array was that of its last turn."""
    given = made([1.0, 2.0, 3.0])
    state: State = State(**{name: given})
    given[0] = 9.0
    assert tuple(getattr(state, name)) == (1.0, 2.0, 3.0)


def test_nor_does_one_of_the_attitude_or_of_a_wrench() -> None:
    attitude, force = np.array([0.0, 0.0, 0.0, 1.0]), np.array([1.0, 2.0, 3.0])
    state, wrench = State(orientation_xyzw=attitude), Wrench(force, force)  # type: ignore[arg-type]
    attitude[0] = force[0] = 9.0
    assert tuple(state.orientation_xyzw) == (0.0, 0.0, 0.0, 1.0)
    assert wrench == Wrench((1.0, 2.0, 3.0), (1.0, 2.0, 3.0))
