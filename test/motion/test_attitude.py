"""The quaternion with every method: unit to round-off, and continuous in sign."""

from __future__ import annotations

import numpy as np
import pytest

from rb_dynamics import MemorySink, parse_scene, simulate
from rb_dynamics.motion import METHODS

# Some two and a half turns, with a flip over the middle axis, in a hundred outputs.
SCENE = """\
body: {{mass: 2.0, inertia: {{diagonal: [1, 2, 2.5]}}}}
initial: {{angular_velocity_body: [0.3, 3.0, 0.1]}}
solver: {{method: {method}, step: 0.01}}
duration: 5.0
output_rate: 20
"""


@pytest.mark.parametrize("method", METHODS)
def test_the_quaternion_is_unit_and_never_jumps(method: str) -> None:
    sink = MemorySink()
    simulate(parse_scene(SCENE.format(method=method)), sinks=[sink])
    q = sink.orientation_xyzw
    assert len(q) == 101
    assert np.abs(np.linalg.norm(q, axis=1) - 1.0).max() <= 4 * np.finfo(float).eps
    # 0.15 rad at most from one to the next: the cosine of half of it.
    assert np.einsum("ij,ij->i", q[1:], q[:-1]).min() > 0.99
    assert q[:, 3].min() < -0.5
