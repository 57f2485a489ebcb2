"""Judge many noisy recordings of random bodies, and print what `inspect --scene` accuses and finds: docs/logs.md.

    python tools/calibrate_inspect.py 1000

The recordings are those of test/support/noisy_recordings.py: gyro noise of 1e-4 to 5e-3 rad/s, even, jittered or random
stamps, with and without commands. Each is judged with the body that flew, with a smallest moment that is 2, 5 and 20 %
too large, with a mass that is 2 % too large, and with an unrecorded torque in its middle third (of the largest moment,
rad/s^2); with the pose and the twist, and with either alone. An accused right body is a false alarm. "mass known" says
how often the mass is, and how often its 95 % interval holds the true one. Ctrl-C ends it with the recordings so far.
--jobs judges as many at a time; the counts are the same.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "support"))

from in_parallel import in_parallel
from noisy_recordings import Recording, recording

from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import EXPLAINS, summarize
from rb_dynamics.analysis.summary import MASS_EXPLAINS as MASS

# Factors of moment and mass, and the torque.
WRONG = {"none": (1.0, 1.0, 0.0), "mass 2 %": (1.0, 1.02, 0.0)}
WRONG |= {f"moment {100.0 * part:.0f} %": (1.0 + part, 1.0, 0.0) for part in (0.02, 0.05, 0.2)}
WRONG |= {f"torque {torque:g}": (1.0, 1.0, torque) for torque in (0.002, 0.01, 0.05)}
ACCUSED = ("inertia", "torque", "bias")
SENSORS = {"pose and twist": (), "pose": ("/b/twist",), "twist": ("/b/pose",)}


class Said(NamedTuple):
    """What is said of a recording: what is accused, whether the mass is and any check fails, and the error of the mass.

    The last is in standard errors; None where no mass is known.
    """

    of: str
    mass: bool
    failed: bool
    off: float | None


def verdict(made: Recording, moments: float, mass: float, without: tuple[str, ...]) -> Said:
    """Return what is said."""
    bag = replace(made.bag, topics={name: topic for name, topic in made.bag.topics.items() if name not in without})
    found = summarize(read_track(bag, made.scene(moments=moments, mass=mass)))
    check, heavy = (next((each for each in found.checks if each.name == name), None) for name in (EXPLAINS, MASS))
    left = found.residual
    off = None if left is None or left.mass is None else (left.mass - made.body.mass) / left.mass_error
    rest = heavy is not None and not heavy.passed, not found.passed, off
    if left is None or check is None or not check.judged:
        return Said("not judged", *rest)
    if check.passed:
        return Said("passed", *rest)
    return Said("inertia" if left.explainable else "torque" if left.bias is None else "bias", *rest)


def judged(seed: int, wrong: str, sensors: str) -> tuple[int, Said, float] | None:
    """Return the seed, what is said and the processor time, s; None if the recording has no pose to leave out."""
    moments, mass, torque = WRONG[wrong]
    begin = time.process_time()
    made = recording(seed, torque)
    recording.cache_clear()
    if sensors != "twist" and not made.facts["with_pose"]:
        return None
    return seed, verdict(made, moments, mass, SENSORS[sensors]), time.process_time() - begin


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, help="number of recordings")
    parser.add_argument("first", type=int, nargs="?", default=0, help="first seed")
    parser.add_argument("--wrong", nargs="*", default=list(WRONG), help="some of the errors only")
    parser.add_argument("--sensors", nargs="*", default=list(SENSORS), help="some of them only")
    parser.add_argument("--jobs", type=int, default=1, help="how many at a time")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.count)
    columns = ("not judged", *(f"{what} accused" for what in (*ACCUSED, "mass")), "any check", "mass known", "ms")
    print(f"| sensors | wrong | recordings | {' | '.join(columns)} |")
    print(f"|{'---|' * (3 + len(columns))}")
    for sensors in args.sensors:
        for wrong in args.wrong:
            each_judged = in_parallel(partial(judged, wrong=wrong, sensors=sensors), seeds, args.jobs)
            told = [each for each in each_judged if each is not None]
            said = [each for _, each, _ in told]
            took = 1e3 * sum(seconds for *_, seconds in told) / max(1, len(told))
            counts = [sum(word == each.of for each in said) for word in ("not judged", *ACCUSED)]
            counts += [sum(each.mass for each in said), sum(each.failed for each in said)]
            off = [abs(each.off) < 1.96 for each in said if each.off is not None]
            row = " | ".join(map(str, (sensors, wrong, len(said), *counts, f"{len(off)}, {sum(off)}", f"{took:.0f}")))
            print(f"| {row} |", flush=True)
            if wrong == "none":
                accused = [seed for seed, each, _ in told if each.failed]
                print(f"accused: {accused}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
