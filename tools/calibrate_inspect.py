"""Judge many noisy recordings of random bodies, and print what `inspect --scene` accuses and finds: docs/logs.md.

    python tools/calibrate_inspect.py 1000

The recordings are those of test/support/noisy_recordings.py: gyro noise of 1e-4 to 5e-3 rad/s, even, jittered or random
stamps, with and without commands. Each is judged with the body that flew, with a smallest moment that is 2, 5 and 20 %
too large, and with an unrecorded torque in its middle third (of the largest moment, rad/s^2); with the pose and the
twist, and with either alone. An accused right body is a false alarm. Ctrl-C ends it with the recordings so far.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "support"))

from noisy_recordings import Recording, recording

from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import EXPLAINS, summarize

WRONG = {"none": (1.0, 0.0), "moment 2 %": (1.02, 0.0), "moment 5 %": (1.05, 0.0), "moment 20 %": (1.2, 0.0)}
WRONG |= {"torque 0.002": (1.0, 0.002), "torque 0.01": (1.0, 0.01), "torque 0.05": (1.0, 0.05)}
ACCUSED = ("inertia", "torque", "bias")
SENSORS = {"pose and twist": (), "pose": ("/b/twist",), "twist": ("/b/pose",)}


def verdict(made: Recording, moments: float, without: tuple[str, ...]) -> tuple[str, bool]:
    """Return what is accused, and whether any check fails."""
    bag = replace(made.bag, topics={name: topic for name, topic in made.bag.topics.items() if name not in without})
    found = summarize(read_track(bag, made.scene(moments=moments)))
    check = next((each for each in found.checks if each.name == EXPLAINS), None)
    if check is None or not check.judged:
        return "not judged", not found.passed
    if check.passed:
        return "passed", not found.passed
    left = found.residual
    assert left is not None
    return ("inertia" if left.explainable else "torque" if left.bias is None else "bias"), not found.passed


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, help="number of recordings")
    parser.add_argument("first", type=int, nargs="?", default=0, help="first seed")
    parser.add_argument("--wrong", nargs="*", default=list(WRONG), help="some of the errors only")
    parser.add_argument("--sensors", nargs="*", default=list(SENSORS), help="some of them only")
    args = parser.parse_args()
    columns = ("not judged", *(f"{what} accused" for what in ACCUSED), "any check", "ms")
    print(f"| sensors | wrong | recordings | {' | '.join(columns)} |")
    print(f"|{'---|' * (3 + len(columns))}")
    for sensors in args.sensors:
        without = SENSORS[sensors]
        for wrong in args.wrong:
            moments, torque = WRONG[wrong]
            said: list[tuple[str, bool]] = []
            seeds = []
            begin = time.process_time()
            for seed in range(args.first, args.first + args.count):
                try:
                    made = recording(seed, torque)
                    if sensors != "twist" and not made.facts["with_pose"]:
                        continue
                    seeds.append(seed)
                    said.append(verdict(made, moments, without))
                    recording.cache_clear()
                except KeyboardInterrupt:
                    break
            took = 1e3 * (time.process_time() - begin) / max(1, len(said))
            counts = [sum(word == of for of, _ in said) for word in ("not judged", *ACCUSED)]
            failed = sum(any_failed for _, any_failed in said)
            row = " | ".join(map(str, (sensors, wrong, len(said), *counts, failed, f"{took:.0f}")))
            print(f"| {row} |", flush=True)
            if wrong == "none":
                accused = [s for s, (of, _) in zip(seeds, said, strict=False) if of in ACCUSED]
                print(f"accused: {accused}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
