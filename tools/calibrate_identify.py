"""Fly many random bodies with noisy sensors, identify each, and print how true the error bars are: docs/identify.md.

    python tools/calibrate_identify.py 1000
    python tools/calibrate_identify.py 40 --scale 1000
    python tools/calibrate_identify.py 200 --wrong
    python tools/calibrate_identify.py 20 --flips
    python tools/calibrate_identify.py 100 --validate

Half of the flights have a gyro with noise of 5e-4 rad/s, half of 5e-3 rad/s. All have a bias, a pose with noise of 1e-3
(rad, m) at 100 Hz, commands that act 20 ms later than recorded, and a scene whose mass is wrong by a half and whose
inertia is a ball's. Coverage is of 95 % intervals; scatter is that of the errors over the standard errors, which are
those of the Cramér-Rao bound at the solution. Ctrl-C ends it with the flights so far.

With --wrong the model lacks something, of a size from 3e-4 to 0.3: a constant torque or gusts (of the torques that are
commanded), an alignment of the gyro (rad), or a delay of the commands (0.1 s). A gyro alone measures, without a bias.

With --flips the body spins within 1e-7 to 1e-3 of its middle axis for 30 to 600 s, free of torque or, in every second
flight, with gusts that are not recorded; a gyro measures at 20 Hz.

With --validate a flight of 0.6 s is fitted, and one of 6 s is held out: of the same body, and of another.

--jobs makes as many fits at a time; the numbers are the same.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "support"))

from identified_flights import flown, guess, random_body
from in_parallel import in_parallel

from rb_dynamics import Identification, RigidBody, identify
from rb_dynamics.analysis.identification.model_omissions import CHANCE
from rb_dynamics.analysis.identification.parameters import AXES, PLACES

DELAY = 0.02
# A fit is in a wrong minimum if a number is this many standard errors off.
WRONG = 6.0
LACKS = ("a constant torque", "gusts", "an alignment", "a delay")
GROUPS = ("mass", "center_of_mass", "inertia", "inertia_ratios", "gyro_bias", "delay")


def flight(seed: int, scale: float) -> tuple[dict[str, list[tuple[float, bool]]], int, Identification]:
    """Return (value - truth) / standard error and whether the interval holds the truth, by group; unknown; the fit."""
    random = np.random.default_rng(seed)
    body = random_body(random, center=0.05)
    bias, gyro = 0.02 * random.standard_normal(3), (5e-4, 5e-3)[seed % 2]
    made = flown(body, random, torque=1.0, force=2.0, gyro=gyro, pose=1e-3, bias=bias)
    (channel,) = made.channels
    made = replace(made, channels=(replace(channel, time_ns=channel.time_ns - round(DELAY * 1e9)),))
    names = ["mass", "center_of_mass", "inertia", "gyro_bias", "delay"]
    found = identify(guess(body, scale=scale), [made], names, starts=4)
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


def lacking(seed: int) -> tuple[str, Identification, list[float]]:
    """Return what the model lacks, the fit, and errors of the moments and products over their standard errors."""
    random = np.random.default_rng(seed)
    body, kind, gyro = random_body(random), LACKS[seed % len(LACKS)], (5e-4, 5e-3)[seed // len(LACKS) % 2]
    size, seconds = 10.0 ** random.uniform(-3.5, -0.5), np.arange(300) / 100.0
    torque: Any = 0.0
    if kind == "a constant torque":
        torque = size * random.standard_normal(3)
    elif kind == "gusts":
        waves = np.sin(np.outer(seconds, random.uniform(1.0, 30.0, 12)) + random.uniform(0.0, 7.0, 12))
        torque = size * waves @ random.standard_normal((12, 3)) / 3.0
    made = flown(body, random, torque=1.0, gyro=gyro, unrecorded=torque)
    (stream,), (channel,) = made.streams, made.channels
    if kind == "an alignment":
        turned = stream.values @ (np.eye(3) + size * random.standard_normal((3, 3)))
        made = replace(made, streams=(replace(stream, values=turned),))
    elif kind == "a delay":
        made = replace(made, channels=(replace(channel, time_ns=channel.time_ns - round(size * 1e8)),))
    found = identify(guess(body), [made], ["inertia"])
    truth = {f"inertia.{axis}": np.array(body.inertia)[place] for axis, place in zip(AXES, PLACES, strict=True)}
    known = [p for p in found.parameters if p.name in truth and p.standard_error is not None]
    return kind, found, [abs(p.value - truth[p.name]) / (p.standard_error or np.inf) for p in known]


def print_lacking(seeds: range, jobs: int) -> None:
    """Print the table of fits that lack something."""
    rows: dict[str, list[tuple[Identification, list[float]]]] = {kind: [] for kind in LACKS}
    for kind, found, off in in_parallel(lacking, seeds, jobs):
        rows[kind].append((found, off))
    print("| the model lacks | flights | found | nothing known | not explained | coverage of 95 % | worst number |")
    print("|---|---|---|---|---|---|---|")
    for kind, some in {**rows, "all": [each for part in rows.values() for each in part]}.items():
        off = np.concatenate([each for _, each in some])
        unknown, told = sum(not each for _, each in some), sum(not found.explained for found, _ in some)
        named = sum(any(each.found for each in found.omissions) for found, _ in some)
        shown = f"{100 * np.mean(off < 1.96):.1f} % | {off.max():.1f} standard errors off"
        print(f"| {kind} | {len(some)} | {named} | {unknown} | {told} | {shown} |")


def flips(seed: int) -> tuple[Identification, list[float]]:
    """Return the fit of a spin near the middle axis, and errors of the ratios over their standard errors."""
    random = np.random.default_rng(seed)
    body, rate = random_body(random), 20.0
    seconds, off, gusts = 10.0 ** random.uniform((1.5, -7.0, -4.0), (2.8, -3.0, -2.0))
    _, axes = np.linalg.eigh(np.array(body.inertia))
    spin = 2.0 * (axes[:, 1] + off * random.standard_normal(3))
    acting = gusts * random.standard_normal((round(seconds * rate), 3)) * (seed % 2)
    made = flown(body, random, seconds=seconds, rate=rate, spin=spin, unrecorded=acting)
    found = identify(guess(body), [made], ["inertia_ratios"])
    inertia = np.array(body.inertia)
    truth = {f"inertia_ratios.{a}": inertia[place] / np.trace(inertia) for a, place in zip(AXES, PLACES, strict=True)}
    known = [p for p in found.parameters if p.name in truth and p.standard_error is not None]
    return found, [abs(p.value - truth[p.name]) / (p.standard_error or np.inf) for p in known]


def print_flips(seeds: range, jobs: int) -> None:
    """Print the table of spins near the middle axis."""
    columns = ("acting", "flights", "in joined segments", "a disturbance said", "nothing known", "not explained")
    print(f"| {' | '.join(columns)} | coverage of 95 % | worst number |\n|{'---|' * (len(columns) + 2)}")
    done = {}
    for seed, fitted in zip(seeds, in_parallel(flips, seeds, jobs), strict=False):
        done[seed] = fitted
        print(f"seed {seed}: {max(done[seed][1], default=0.0):.1f} standard errors off", file=sys.stderr, flush=True)
    for kind, acts in (("nothing", 0), ("gusts", 1)):
        some = [each for seed, each in done.items() if seed % 2 == acts]
        off = np.concatenate([np.zeros(0), *(each for _, each in some)])
        notes = [" ".join(found.notes) for found, _ in some]
        parts, moved = (sum(word in each for each in notes) for word in ("segments", "a small disturbance"))
        unknown = sum(not each for _, each in some)
        told = sum(not found.explained for found, _ in some)
        shown = f"{100 * np.mean(off < 1.96):.1f} % | {off.max(initial=0.0):.1f} standard errors off"
        print(f"| {kind} | {len(some)} | {parts} | {moved} | {unknown} | {told} | {shown} |")


def validated(seed: int, factor: float) -> bool | None:
    """Return what is said of a long flight, of a body with `factor` times the moments, held out from a short one."""
    random = np.random.default_rng(seed)
    body = random_body(random)
    other = RigidBody.from_matrix(body.mass, (factor * np.array(body.inertia)).tolist())
    made, held_out = (flown(each, random, seconds=s, torque=2.0) for each, s in ((body, 0.6), (other, 6.0)))
    return identify(guess(body), [made], ["inertia"], validate=[held_out]).validated


def print_validated(seeds: range, jobs: int) -> None:
    """Print what is said of long flights of the same body or another."""
    print("| moments of the body held out | flights | predicted | too uncertain to tell | another body |")
    print("|---|---|---|---|---|")
    for factor in (1.0, 1.05, 1.6):
        said = list(in_parallel(partial(validated, factor=factor), seeds, jobs))
        row = " | ".join(str(said.count(word)) for word in (True, None, False))
        print(f"| {factor:g} times | {len(said)} | {row} |", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, help="number of flights")
    parser.add_argument("first", type=int, nargs="?", default=0, help="first seed")
    parser.add_argument("--scale", type=float, default=1.0, help="by how much mass and inertia of the scene are off")
    parser.add_argument("--wrong", action="store_true", help="the model lacks something")
    parser.add_argument("--flips", action="store_true", help="spins near the middle axis")
    parser.add_argument("--validate", action="store_true", help="a long flight is held out from a short one")
    parser.add_argument("--jobs", type=int, default=1, help="how many at a time")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.count)
    for wanted, printed in ((args.wrong, print_lacking), (args.flips, print_flips), (args.validate, print_validated)):
        if wanted:
            printed(seeds, args.jobs)
            return
    every: dict[str, list[tuple[float, bool]]] = {}
    wrong = unknown = restless = coloured = unexplained = lacking_something = 0
    begin = time.monotonic()
    done = 0
    fits = in_parallel(partial(flight, scale=args.scale), seeds, args.jobs)
    for seed, (errors, missing, found) in zip(seeds, fits, strict=False):
        done += 1
        unknown, restless = unknown + missing, restless + (not found.converged)
        coloured += any(each.coloured for each in found.residuals)
        unexplained += not found.explained
        lacking_something += any(each.chance <= CHANCE for each in found.omissions)
        if max((abs(off) for group in errors.values() for off, _ in group), default=0.0) > WRONG:
            wrong += 1
            print(f"wrong: seed {seed}", file=sys.stderr, flush=True)
            continue
        for name, group in errors.items():
            every.setdefault(name, []).extend(group)
    print(f"{done} flights; wrong minima: {wrong}; not at rest: {restless}; numbers not known: {unknown}")
    print(f"false alarms: {coloured} not white, {unexplained} not explained, {lacking_something} of what is lacking\n")
    print("| number | values | coverage of 95 % | scatter over Cramér–Rao |\n|---|---|---|---|")
    for name in GROUPS:
        off = np.array([value for value, _ in every[name]])
        held = np.mean([inside for _, inside in every[name]])
        print(f"| {name} | {len(off)} | {100 * held:.1f} % | {off.std():.3f} |")
    print(f"{time.monotonic() - begin:.0f} s", file=sys.stderr)


if __name__ == "__main__":
    main()
