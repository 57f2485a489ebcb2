"""Measure how often the check of a campaign's control period is wrong, for laws that hear noisy sensors.

    python tools/try_loops.py [LOOPS] [SEED]     # 300 loops, seed 1: some minutes

Each loop has a body, an IMU and a star tracker with noise, a law of its own (damping, damping and stiffness, the same
with a filter, or with a gyroscopic torque that it computes), a period, a delay, and in half of them three wheels that
give the torque, one with momentum. Whether it is stable is known from the eigenvalues of small motion. Prints how many
stable loops are blamed, and how many unstable ones are named.
"""

from __future__ import annotations

import math
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from rb_dynamics.study.campaign.loop_stability import remarks
from rb_dynamics.study.campaign.read import read_campaign

Array = NDArray[np.float64]

STABLE, UNSTABLE = 0.99, 1.02
"""Growth per sample up to which a loop counts as stable, and from which as unstable; between them it is not counted."""

LAW = '''"""PD with what sensors say; `kind` 2 filters the rate, 3 adds the gyroscopic torque of the body."""
import numpy as np


def law(parameters):
    stiffness, damping, kind = (parameters[name][:, None] for name in ("stiffness", "damping", "kind"))
    moments, axes = parameters["moments"], parameters["wheels"]
    filtered = np.zeros((1, 3))

    def command(measured):
        nonlocal filtered
        rate, (x, y, z, w) = measured.angular_velocity_body, measured.orientation_xyzw.T
        filtered = np.where(kind == 2.0, 0.5 * filtered + 0.5 * rate, rate)
        angle = 2.0 * np.where(w < 0.0, -1.0, 1.0)[:, None] * np.stack([x, y, z], axis=-1)
        torque = -stiffness * angle - damping * filtered
        torque = torque + np.where(kind == 3.0, np.cross(rate, moments * rate), 0.0)
        if not axes.any():
            return torque
        return {name: -torque[:, k] for k, name in enumerate(("wheel_x", "wheel_y", "wheel_z"))}

    return command
'''


class Loop(NamedTuple):
    """Texts of a scene and a campaign, and the growth of small motion per sample."""

    scene: str
    campaign: str
    growth: float
    kind: int


def loop(random: np.random.Generator) -> Loop:
    """Return a loop drawn at random."""
    second = 10.0 ** random.uniform(-2.0, 1.0) * random.uniform(0.3, 1.0, 3)
    moments = second.sum() - second
    period, kind, wheels = 10.0 ** random.uniform(-1.0, 0.3), int(random.integers(0, 4)), bool(random.integers(0, 2))
    delay = round(random.uniform(0.0, 0.6) * period, 3)
    period = round(period, 3)
    scaled = 10.0 ** random.uniform(-1.3, 0.6)
    damping = scaled * float(moments.mean()) / period
    stiffness = 0.0 if kind == 0 else random.uniform(0.05, 0.25) * damping * damping / float(moments.mean())
    inside = random.uniform(0.0, 2.0) / period * float(moments.mean()) if wheels else 0.0
    slow = random.uniform(0.001, 0.1) / period
    noise = 10.0 ** random.uniform(-4.0, -1.0)
    start = (slow * random.standard_normal(3)).tolist()
    wheel = 1e-3 * float(moments.min())
    actuators = "".join(
        f"  - {{type: reaction_wheel, name: wheel_{name}, axis: {axis}, inertia: {wheel!r}, speed: {speed!r}}}\n"
        for name, axis, speed in (("x", [1, 0, 0], 0.0), ("y", [0, 1, 0], inside / wheel), ("z", [0, 0, 1], 0.0))
    )
    density = noise * slow * math.sqrt(2.0 * period)
    scene = (
        f"body: {{mass: 10, inertia: {{diagonal: {moments.tolist()}}}}}\n"
        f"initial: {{angular_velocity_body: {start}}}\nwrenches: []\nduration: {120.0 * period!r}\noutput_rate: 1\n"
        f"sensors:\n  - {{type: imu, name: imu, rate: {1.0 / period!r}, gyro: {{noise_density: {density!r}}}}}\n"
        f"  - {{type: star_tracker, name: tracker, rate: {1.0 / period!r}, noise: {noise * slow * period!r}}}\n"
    )
    scene += f"actuators:\n{actuators}" if wheels else ""
    campaign = (
        f"scene: scene.yaml\nruns: 1\nseed: 1\ndisperse: {{control.delay: {{choice: {{values: [{delay!r}]}}}}}}\n"
        f"control: {{law: noisy_law.law, rate: {1.0 / period!r}, delay: {delay!r}, "
        f"parameters: {{stiffness: {stiffness!r}, damping: {damping!r}, kind: {kind}, "
        f"moments: {moments.tolist()}, wheels: {[float(wheels)] * 3}}}}}\n"
        "metrics: {rate: {final: rate}}\n"
    )
    new = 0.5 if kind == 2 else 1.0
    growth = _growth(moments, wheel if wheels else 0.0, inside, (stiffness, damping), period, delay, new)
    return Loop(scene, campaign, growth, kind)


def _growth(
    moments: Array, wheel: float, inside: float, gains: tuple[float, float], period: float, delay: float, new: float
) -> float:
    """Return the growth per sample of small motion; `new` is the part of a new rate in the rate that the law uses."""
    one, none = np.eye(3), np.zeros((3, 3))
    each = np.diag(1.0 / (moments - wheel))
    turning = each @ np.array([[0.0, 0.0, inside], [0.0, 0.0, 0.0], [-inside, 0.0, 0.0]])
    rates = np.block([[none, one, none], [none, turning, each], [none, none, none]])
    before, after = expm(delay * rates)[:6], expm((period - delay) * rates)[:6]
    # Attitude and rate, the rate that the law uses, and what acts.
    used = np.hstack([none, new * one, (1.0 - new) * one, none])
    command = -gains[0] * np.hstack([one, none, none, none]) - gains[1] * used
    then = np.hstack([before[:, :6], np.zeros((6, 3)), before[:, 6:]])
    matrix = np.vstack([after[:, :6] @ then + after[:, 6:] @ command, used, command])
    # Without stiffness the attitude is free.
    return float(np.abs(np.linalg.eigvals(matrix if gains[0] else matrix[3:, 3:])).max())


def main() -> int:
    count, seed = map(int, [*sys.argv[1:], *("300", "1")[len(sys.argv) - 1 :]])
    random, blamed, named, stable, unstable = np.random.default_rng(seed), 0, 0, 0, 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "campaign.yaml")
        Path(folder, "noisy_law.py").write_text(LAW, encoding="utf-8")
        while stable < count:
            each = loop(random)
            if STABLE < each.growth < UNSTABLE:
                continue
            Path(folder, "scene.yaml").write_text(each.scene, encoding="utf-8")
            path.write_text(each.campaign, encoding="utf-8")
            said = any("depends on its period" in remark for remark in remarks(read_campaign(path)))
            if each.growth < 1.0:
                stable, blamed = stable + 1, blamed + said
                if said:
                    print(f"blamed although it shrinks by {each.growth:.4f} per sample:\n{each.scene}{each.campaign}")
            else:
                unstable, named = unstable + 1, named + said
                if not said:
                    print(f"not named although it grows by {each.growth:.4g} per sample: kind {each.kind}", flush=True)
    print(f"{blamed} of {stable} stable loops blamed, {named} of {unstable} unstable ones named")
    return 0


if __name__ == "__main__":
    sys.exit(main())
