"""Fly many random bodies with noisy sensors, identify each, and print how true the error bars are: docs/identify.md.

    python tools/calibrate_identify.py 1000

Half of the flights have a gyro with noise of 5e-4 rad/s, half of 5e-3 rad/s. All have a bias, a pose with noise of 1e-3
(rad, m) at 100 Hz, commands that act 20 ms later than recorded, and a scene whose mass is wrong by a half and whose
inertia is a ball's. Coverage is of 95 % intervals; scatter is that of the errors over the standard errors, which are
those of the Cramér-Rao bound at the solution. Ctrl-C ends it with the flights so far.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "support"))

from identified_flights import flown, guess, random_body

from rb_dynamics import Identification, identify
from rb_dynamics.analysis.identification.parameters import AXES, PLACES

DELAY = 0.02
# A fit is in a wrong minimum if a number is this many standard errors off.
WRONG = 6.0
GROUPS = ("mass", "center_of_mass", "inertia", "inertia_ratios", "gyro_bias", "delay")


def flight(seed: int) -> tuple[dict[str, list[tuple[float, bool]]], int, Identification]:
    """Return (value - truth) / standard error and whether the interval holds the truth, by group; unknown; the fit."""
    random = np.random.default_rng(seed)
    body = random_body(random, center=0.05)
    bias, gyro = 0.02 * random.standard_normal(3), (5e-4, 5e-3)[seed % 2]
    made = flown(body, random, torque=1.0, force=2.0, gyro=gyro, pose=1e-3, bias=bias)
    (channel,) = made.channels
    made = replace(made, channels=(replace(channel, time_ns=channel.time_ns - round(DELAY * 1e9)),))
    names = ["mass", "center_of_mass", "inertia", "gyro_bias", "delay"]
    found = identify(guess(body), [made], names, starts=4)
    truth = {"mass": body.mass, "delay.commands": DELAY, "delay.pose": 0.0}
    truth |= {f"center_of_mass.{a}": c for a, c in zip("xyz", body.center_of_mass, strict=True)}
    truth |= {f"gyro_bias.imu.{a}": b for a, b in zip("xyz", bias, strict=True)}
    inertia = np.array(body.inertia)
    for axis, place in zip(AXES, PLACES, strict=True):
        truth[f"inertia.{axis}"] = inertia[place]
        truth[f"inertia_ratios.{axis}"] = inertia[place] / np.trace(inertia)
    errors: dict[str, list[tuple[float, bool]]] = {}
    unknown = 0
    for each in found.parameters:
        if each.name not in truth:
            continue
        if each.standard_error is None or each.interval is None:
            unknown += 1
            continue
        low, high = each.interval
        off = (each.value - truth[each.name]) / each.standard_error
        errors.setdefault(each.name.split(".")[0], []).append((off, low <= truth[each.name] <= high))
    return errors, unknown, found


def main() -> None:
    """Print the table."""
    count, first = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0
    every: dict[str, list[tuple[float, bool]]] = {}
    wrong = unknown = restless = coloured = unexplained = 0
    begin = time.monotonic()
    done = 0
    for seed in range(first, first + count):
        try:
            errors, missing, found = flight(seed)
        except KeyboardInterrupt:
            break
        done += 1
        unknown, restless = unknown + missing, restless + (not found.converged)
        coloured += not all(each.white for each in found.residuals)
        unexplained += not found.explained
        if max((abs(off) for group in errors.values() for off, _ in group), default=0.0) > WRONG:
            wrong += 1
            print(f"wrong: seed {seed}", file=sys.stderr, flush=True)
            continue
        for name, group in errors.items():
            every.setdefault(name, []).extend(group)
    print(f"{done} flights; wrong minima: {wrong}; not at rest: {restless}; numbers not known: {unknown}")
    print(f"false alarms: {coloured} not white, {unexplained} not explained\n")
    print("| number | values | coverage of 95 % | scatter over Cramér–Rao |\n|---|---|---|---|")
    for name in GROUPS:
        off = np.array([value for value, _ in every[name]])
        held = np.mean([inside for _, inside in every[name]])
        print(f"| {name} | {len(off)} | {100 * held:.1f} % | {off.std():.3f} |")
    print(f"{time.monotonic() - begin:.0f} s", file=sys.stderr)


if __name__ == "__main__":
    main()
