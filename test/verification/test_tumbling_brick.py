"""The comparison with other simulators: a history that is right comes out right, and one that is wrong does not."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scripts import load_script

import rb_dynamics as rb


@pytest.mark.parametrize(("wrong", "least", "most"), [(0.0, 0.0, 1e-12), (2e-3, 1e-3, 3e-3)])
def test_the_rate_of_a_history_is_judged(root: Path, tmp_path: Path, wrong: float, least: float, most: float) -> None:
    tool = load_script(root / "tools" / "compare_tumbling_brick.py")
    rates = [math.radians(rate) for rate in (10.0, 20.0, 30.0)]
    body, start = rb.RigidBody.from_diagonal(1.0, tool.MOMENTS), rb.State(angular_velocity_body=tuple(rates))
    times = np.arange(31) * 0.1
    motion = rb.free_motion(body, start, times)
    level = Rotation.from_rotvec(np.outer(times * tool.EARTH, [1.0, 0.0, 0.0]))
    angles = (level.inv() * Rotation.from_quat(motion.orientation_xyzw)).as_euler("ZYX", degrees=True)
    turning = np.degrees(motion.angular_velocity_body) + wrong * times[:, None] / 3.0 * [0.0, 0.0, 1.0]
    file = tmp_path / "tumbling_brick_sim_99.csv"
    with file.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(["time", *tool.ANGLES, *tool.RATES])
        for row in np.column_stack([times, angles, turning]).tolist():
            writer.writerow(map(repr, row))
    name, rate, _, _, attitude, _ = (cell.strip() for cell in tool.row(file).strip("|").split("|"))
    assert name == "99"
    assert least <= float(rate) <= most
    assert float(attitude) < 1e-13
