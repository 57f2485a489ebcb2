"""Identify a racket thrown in the air with a phone on it, and print the table of docs/identify.md.

    python tools/identify_racket.py FOLDER [LAG]

FOLDER is "data/round4" of the recordings of https://github.com/fbubbar/sci1-t2 (gyro of a phone at 100 Hz, one file of
several throws per folder, and the times of each throw), which have no licence and are not part of this package.
With LAG (s) the gyro is taken to be filtered by a first-order lag.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

from rb_dynamics import identify, parse_scene
from rb_dynamics.analysis.identification.flights import RATES, Flight, Stream

# A racket of 0.457 kg: a rod with a head, along y; what drag there is will be found.
SCENE = """
body: {mass: 0.457, inertia: {diagonal: [0.019, 0.0015, 0.020]}}
effects: [{type: linear_drag, rotation: [0, 0, 0]}]
"""
GOOD = 0.25


def throws(folder: Path, lag: float) -> list[Flight]:
    """Return the throws that the authors kept, with a lag (s) of the gyro undone."""
    found = []
    for path in sorted(folder.glob("*/Raw Data.csv")):
        rows = np.loadtxt(path, delimiter=",", skiprows=1)
        with (path.parent / "meta" / "segments.csv").open(encoding="utf-8") as text:
            segments = list(csv.DictReader(text, skipinitialspace=True))
        for segment in segments:
            if segment["keep"] == "false":
                continue
            within = (rows[:, 0] >= float(segment["start"])) & (rows[:, 0] <= float(segment["end"]))
            times = np.rint(rows[within, 0] * 1e9).astype(np.int64)
            rates = rows[within, 1:4] + lag * np.gradient(rows[within, 1:4], rows[within, 0], axis=0)
            stream = Stream("gyro", RATES, times - times[0], rates, gyro=True)
            found.append(Flight(f"{path.parent.name[-8:]} {segment['segment']}", (stream,)))
    return found


def main() -> None:
    """Print the table."""
    ratios, errors, left_over, good = [], [], [], 0
    print("| throw | s | rad/s at most | rms, rad/s | moments over the largest | starts that agree |")
    print("|---|---|---|---|---|---|")
    flights = throws(Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 0.0)
    for flight in flights:
        found = identify(parse_scene(SCENE), [flight], ["inertia_ratios", "effects[0].rotation"], starts=8)
        (left,) = found.residuals
        moments = np.linalg.eigvalsh(np.array(found.body.inertia))
        stream = flight.streams[0]
        seconds, fastest = stream.time_ns[-1] * 1e-9, np.linalg.norm(stream.values, axis=1).max()
        shares = moments / moments[-1]
        known = all(each.known for each in found.parameters if each.name.startswith("inertia_ratios"))
        good += left.rms < GOOD
        left_over.append(left.rms)
        if left.rms < GOOD and known:
            ratios.append(shares)
            # The racket is along y: its smallest moment is about that axis.
            (least,) = (each for each in found.parameters if each.name == "inertia_ratios.yy")
            errors.append(least.standard_error / least.value)
        shown = ", ".join(f"{share:.4f}" for share in shares) if known else "not told"
        name, agree = flight.name, f"{found.agreeing} of {found.starts}"
        print(f"| {name} | {seconds:.2f} | {fastest:.1f} | {left.rms:.3f} | {shown} | {agree} |", flush=True)
    spread = np.std(ratios, axis=0) / np.mean(ratios, axis=0)
    print(f"\n{good} of {len(flights)} throws are fitted to less than {GOOD} rad/s; the ratios of {len(ratios)} spread")
    print("by " + ", ".join(f"{100 * part:.1f} %" for part in spread[:2]))
    print(f"the median standard error of the smallest is {100 * np.median(errors):.1f} %, of the residuals", end=" ")
    print(f"{np.median(left_over):.4f} rad/s")


if __name__ == "__main__":
    main()
