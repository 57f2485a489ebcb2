"""Identify gravity from tosses of a cube, and see that ratios of its inertia are refused: docs/identify.md.

    python tools/identify_tosses.py FOLDER

FOLDER has toss_*.csv: time (s), position (m) and attitude (x, y, z, w) by motion capture at 148 Hz, velocity (m/s), as
of the tosses of ContactNets (Pfrommer, Halm & Posa, CoRL 2020). Each flies free and then hits a table.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from rb_dynamics import identify, parse_scene
from rb_dynamics.analysis.identification.flights import ATTITUDE, POSITION, Flight, Stream
from rb_dynamics.analysis.track import unit_rows

SCENE = """
body: {mass: 0.37, inertia: {shape: {type: box, size: [0.1048, 0.1048, 0.1048]}}}
effects: [{type: uniform_gravity, acceleration_world: [0, 0, 0]}]
"""
# m/s^2: nothing but a table pushes that hard.
PUSH = 25.0


def main() -> None:
    """Print the table."""
    print("| toss | free samples | impact, s | vertical acceleration, m/s² | 95 % interval | ratios known |")
    print("|---|---|---|---|---|---|")
    for path in sorted(Path(sys.argv[1]).glob("toss_*.csv")):
        rows = np.loadtxt(path, delimiter=",", skiprows=1)
        pushed = np.linalg.norm(np.diff(rows[:, 8:11], axis=0) / np.diff(rows[:, 0])[:, None], axis=1)
        hit = int(np.argmax(pushed > PUSH)) if (pushed > PUSH).any() else len(rows)
        # The velocity of a sample is smoothed over its neighbours.
        free = rows[: max(hit - 2, 0)]
        times = np.rint(free[:, 0] * 1e9).astype(np.int64)
        streams = (
            Stream("pose", ATTITUDE, times, unit_rows(free[:, 4:8])),
            Stream("pose", POSITION, times, free[:, 1:4]),
        )
        found = identify(
            parse_scene(SCENE), [Flight(path.stem, streams)], ["inertia_ratios", "effects[0].acceleration_world"]
        )
        known = sum(each.known for each in found.parameters if each.name.startswith("inertia_ratios"))
        (down,) = (each for each in found.parameters if each.name == "effects[0].acceleration_world.z")
        low, high = down.interval or (np.nan, np.nan)
        begins = f"{rows[hit, 0]:.3f}" if hit < len(rows) else "none"
        print(f"| {path.stem} | {len(free)} | {begins} | {down.value:.2f} | {low:.2f} … {high:.2f} | {known} of 6 |")


if __name__ == "__main__":
    main()
