"""Identify a racket thrown in the air with a phone on it, and print the table of docs/identify.md.

    python tools/identify_racket.py FOLDER [--lag S] [--linear] [--trim FIRST LAST]
    python tools/identify_racket.py FOLDER --air

FOLDER is "data/round4" of the recordings of https://github.com/fbubbar/sci1-t2 (gyro of a phone at 100 Hz, one file of
several throws per folder, and the times of each throw), which have no licence and are not part of this package.
With --lag the gyro is taken to be filtered by a first-order lag, with --linear there is no quadratic drag, and with
--trim samples at both ends of each throw are left out.

With --air every fifth of the first 25 throws is also fitted with the air on its cylinders (`racket_air.py`), which
depends on how the racket flies: velocity and attitude at the start are fitted, from two directions of up.

What the ratios of one throw can tell follows from simulated flights: each is the fitted motion of a throw, with other
noise, fitted by the same call. One series has white noise of the phone, the other noise with the spectrum of what is
left of the throw, of the size of which the fit leaves as much as of the throw.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from racket_air import CrossFlow

from rb_dynamics import Identification, LogError, State, UniformGravity, identify, parse_scene
from rb_dynamics.analysis.identification.flights import RATES, Flight, Stream

# A racket of 0.457 kg: a rod with a head, along y; what drag there is will be found.
SCENE = """
body: {mass: 0.457, inertia: {diagonal: [0.019, 0.0015, 0.020]}}
effects: [{type: linear_drag, rotation: [0, 0, 0]}, {type: quadratic_drag, rotation: [0, 0, 0]}]
"""
GOOD = 0.25


def throws(folder: Path, lag: float, trim: Sequence[int]) -> list[Flight]:
    """Return the throws that the authors kept, with a lag (s) of the gyro undone, and without samples at the ends."""
    found = []
    for path in sorted(folder.glob("*/Raw Data.csv")):
        rows = np.loadtxt(path, delimiter=",", skiprows=1)
        with (path.parent / "meta" / "segments.csv").open(encoding="utf-8") as text:
            segments = list(csv.DictReader(text, skipinitialspace=True))
        for segment in segments:
            if segment["keep"] == "false":
                continue
            within = (rows[:, 0] >= float(segment["start"])) & (rows[:, 0] <= float(segment["end"]))
            kept = slice(trim[0], int(within.sum()) - trim[1])
            times = np.rint(rows[within, 0] * 1e9).astype(np.int64)[kept]
            rates = (rows[within, 1:4] + lag * np.gradient(rows[within, 1:4], rows[within, 0], axis=0))[kept]
            stream = Stream("gyro", RATES, times - times[0], rates, gyro=True)
            found.append(Flight(f"{path.parent.name[-8:]} {segment['segment']}", (stream,)))
    return found


def fitted(flight: Flight, linear: bool, starts: int) -> tuple[Identification, Any, float]:
    """Return the fit of a throw, moments over the largest, and the relative standard error of the smallest.

    The error is NaN where the ratios are not known.
    """
    names = ["inertia_ratios", "effects[0].rotation", *([] if linear else ["effects[1].rotation"])]
    found = identify(parse_scene(SCENE), [flight], names, starts=starts)
    moments = np.linalg.eigvalsh(np.array(found.body.inertia))
    # The racket is along y: its smallest moment is about that axis.
    (least,) = (each for each in found.parameters if each.name == "inertia_ratios.yy")
    return found, moments / moments[-1], np.nan if least.standard_error is None else least.standard_error / least.value


def coloured(random: Any, left: Any) -> Any:
    """Return noise with the spectrum of `left` (n, 3)."""
    spectrum = np.abs(np.fft.rfft(left, axis=0))
    return np.fft.irfft(spectrum * np.exp(2j * np.pi * random.random(spectrum.shape)), len(left), axis=0)


def simulated(flight: Flight, found: Identification, noise: Any) -> Flight:
    """Return the fitted motion of a throw with this noise."""
    (stream,), left = flight.streams, found.predicted[0].left
    return replace(flight, streams=(replace(stream, values=stream.values + left + noise),))


def in_air(flight: Flight) -> Identification:
    """Return the fit of a throw with the air on its cylinders, thrown up and caught at one height at first."""
    fall, seconds = UniformGravity((0.0, 0.0, -9.81)), flight.streams[0].time_ns[-1] * 1e-9
    tries = []
    # World z along y, and against z of the racket.
    for attitude in ((0.5**0.5, 0.0, 0.0, 0.5**0.5), (1.0, 0.0, 0.0, 0.0)):
        start = State(orientation_xyzw=attitude, linear_velocity_world=(0.0, 0.0, 0.5 * 9.81 * seconds))
        scene = replace(parse_scene(SCENE), effects=(CrossFlow(), fall), initial=start)
        tries.append(identify(scene, [flight], ["inertia_ratios", "effects[0].coefficient"], starts=1))
    return min(tries, key=lambda each: each.residuals[0].rms)


def compare_air(flights: Sequence[Flight]) -> None:
    """Print residuals of both models."""
    print("| throw | rms with drag, rad/s | with cylinders, rad/s | their coefficient | ratios known |")
    print("|---|---|---|---|---|")
    for flight in flights:
        (drag, *_), air = fitted(flight, False, 8), in_air(flight)
        (coefficient,) = (each.value for each in air.parameters if each.name.startswith("effects"))
        known = any(each.known for each in air.parameters if each.name.startswith("inertia_ratios"))
        left = " | ".join(f"{each.residuals[0].rms:.3f}" for each in (drag, air))
        print(f"| {flight.name} | {left} | {coefficient:.2f} | {'yes' if known else 'no'} |", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--lag", type=float, default=0.0, help="s")
    parser.add_argument("--linear", action="store_true", help="linear drag alone")
    parser.add_argument("--trim", type=int, nargs=2, default=(0, 0), help="samples left out at both ends")
    parser.add_argument("--air", action="store_true", help="compare with the air on cylinders")
    args = parser.parse_args()
    random, good, negative, left_over = np.random.default_rng(0), 0, 0, []
    ratios: dict[str, list[Any]] = {"as recorded": [], "white": [], "coloured": []}
    errors: dict[str, list[float]] = {name: [] for name in ratios}
    recordings: list[str] = []
    flights = throws(args.folder, args.lag, args.trim)
    if args.air:
        compare_air(flights[:25:5])
        return
    print("| throw | s | rad/s at most | rms, rad/s | times noise | moments over the largest | starts that agree |")
    print("|---|---|---|---|---|---|---|")
    for flight in flights:
        found, shares, error = fitted(flight, args.linear, 8)
        (stream,), (left,) = flight.streams, found.residuals
        seconds, fastest = stream.time_ns[-1] * 1e-9, np.linalg.norm(stream.values, axis=1).max()
        good += left.rms < GOOD
        negative += any(p.value < 0.0 for p in found.parameters if p.name.startswith("effects[1]"))
        left_over.append((left.rms, left.rms / left.times_noise))
        shown, row = "not known", found.predicted[0].left
        if np.isfinite(error) and left.rms < GOOD:
            shown = ", ".join(f"{share:.4f}" for share in shares)
            ratios["as recorded"].append(shares)
            errors["as recorded"].append(error)
            recordings.append(flight.name.split()[0])
            noises = {"white": left_over[-1][1] * random.standard_normal(row.shape), "coloured": coloured(random, row)}
            trial, *_ = fitted(simulated(flight, found, noises["coloured"]), args.linear, 1)
            noises["coloured"] *= left.rms / trial.residuals[0].rms
            for name, noise in noises.items():
                # A fit that loses the motion knows nothing.
                with contextlib.suppress(LogError):
                    _, others, error = fitted(simulated(flight, found, noise), args.linear, 4)
                    if np.isfinite(error):
                        # Over the truth of this flight, so that all have one.
                        ratios[name].append(others / shares)
                        errors[name].append(error)
        agree = f"{found.agreeing} of {found.starts}"
        numbers = f"{seconds:.2f} | {fastest:.1f} | {left.rms:.3f} | {left.times_noise:.1f}"
        print(f"| {flight.name} | {numbers} | {shown} | {agree} |", flush=True)
    rms, noise = np.median(left_over, axis=0)
    print(
        f"\n{good} of {len(flights)} throws are fitted to less than {GOOD} rad/s, in the median to {rms:.4f}, where the"
    )
    print(f"noise of the phone is {noise:.4f}\n")
    print(
        "| noise | throws | spread of the smallest ratio, of the middle one | standard error of the smallest, median |"
    )
    print("|---|---|---|---|")
    parts = {f"as recorded, {each}": [k for k, of in enumerate(recordings) if of == each] for each in set(recordings)}
    parts["as recorded, best known"] = np.argsort(errors["as recorded"])[:14].tolist()
    for name in sorted(parts):
        ratios[name], errors[name] = ([of["as recorded"][k] for k in parts[name]] for of in (ratios, errors))
    for name, some in ratios.items():
        spread = 100 * np.std(some, axis=0) / np.mean(some, axis=0)
        print(
            f"| {name} | {len(some)} | {spread[0]:.2f} %, {spread[1]:.2f} % | {100 * np.median(errors[name]):.2f} % |"
        )
    off = np.array(ratios["as recorded"])[:, 0] / np.mean(ratios["as recorded"], axis=0)[0] - 1.0
    ratio = np.sqrt(np.mean((off / errors["as recorded"]) ** 2))
    print(f"\nthe smallest ratio is {ratio:.2f} standard errors off its mean, rms")
    print(f"a coefficient of quadratic drag is negative in {negative} of {len(flights)} throws")


if __name__ == "__main__":
    main()
