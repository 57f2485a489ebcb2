"""Compare the tumbling brick of NASA with four flight simulators: print who is right to which digit.

    python tools/compare_tumbling_brick.py FOLDER

FOLDER has the time histories tumbling_brick_sim_*.csv of atmospheric check case 2 of NASA/TM-2015-218675 (Jackson,
Shelton, Jackson, Castro, Noble, Murri), as distributed with nasa/simupy-flight under the NASA Open Source Agreement
1.3: Euler angles against the local level (yaw, pitch, roll) and body rates against inertial axes, in degrees. They are
no part of this repository. Each becomes a bag, as of another program, and is compared with the scene below by
`compare`.

The brick starts at the equator at rest against the Earth and falls for 30 s. Its local level turns with the Earth about
north, but for 1e-6 rad that it drifts east; with that turn, `attitude` is about inertial axes. Rates need no such care.
"""

from __future__ import annotations

import contextlib
import csv
import math
import sys
import tempfile
from pathlib import Path

import rb_dynamics as rb
from rb_dynamics.formats import cdr
from rb_dynamics.formats.channel_metadata import log_channel, qos_profile
from rb_dynamics.formats.mcap_writer import McapWriter
from rb_dynamics.formats.message_types import POSE, TWIST
from rb_dynamics.formats.output_file import OutputFile
from rb_dynamics.numerics.rotation import Quaternion, multiply

SLUG_FT2 = 14.593902937206364 * 0.3048**2  # kg m^2
EARTH = 7.292115e-5  # rad/s
MOMENTS = tuple(moment * SLUG_FT2 for moment in (0.00189422, 0.006211019, 0.007194665))
SCENE = f"""
body: {{mass: 1.0, inertia: {{diagonal: {list(MOMENTS)}}}}}
wrenches: []
duration: 30.0
output_rate: 10.0
"""
ANGLES = [f"eulerAngle_deg_{name}" for name in ("Yaw", "Pitch", "Roll")]
RATES = [f"bodyAngularRateWrtEi_deg_s_{name}" for name in ("Roll", "Pitch", "Yaw")]
Sample = tuple[int, Quaternion, tuple[float, float, float]]


def main(folder: Path) -> None:
    files = sorted(folder.glob("tumbling_brick_sim_*.csv"))
    if not files:
        sys.exit(f"{folder} has no tumbling_brick_sim_*.csv; give the folder of the time histories")
    print("| simulator | rate [°/s] | rms | at t [s] | attitude [rad] | drift of \\|L\\| |")
    print("|---|---|---|---|---|---|")
    for file in files:
        print(row(file))


def row(file: Path) -> str:
    """Return one line of the table."""
    samples = read(file)
    with tempfile.TemporaryDirectory() as place:
        bag = Path(place) / "brick.mcap"
        write(bag, samples)
        _, attitude, rate = samples[0]
        x, y, z, w = attitude
        start = {"orientation": {"x": x, "y": y, "z": z, "w": w}, "angular_velocity_body": list(rate)}
        found = rb.compare(rb.parse_scene(SCENE, "brick.yaml", {"initial": start}), bag)
    rates, attitudes = found.differences["angular_velocity"], found.differences["attitude"]
    largest, usual, at_s = math.degrees(rates.max), math.degrees(rates.rms), found.seconds(rates.max_ns)
    momentum = [math.hypot(*(j * part for j, part in zip(MOMENTS, rate, strict=True))) for _, _, rate in samples]
    drift = max(abs(size / momentum[0] - 1.0) for size in momentum)
    name = file.stem.rpartition("_")[2]
    return f"| {name} | {largest:.1e} | {usual:.1e} | {at_s:g} | {attitudes.max:.1e} | {drift:.1e} |"


def read(file: Path) -> list[Sample]:
    """Return time (ns), attitude against inertial axes and rates (rad/s) of each row."""
    samples: list[Sample] = []
    with file.open(newline="") as rows:
        for row in csv.DictReader(rows):
            time_s = float(row["time"])
            yaw, pitch, roll = (math.radians(float(row[name])) for name in ANGLES)
            # North, east, down: the Earth turns about north at the equator.
            level = about(0, EARTH * time_s)
            attitude = multiply(multiply(multiply(level, about(2, yaw)), about(1, pitch)), about(0, roll))
            p, q, r = (math.radians(float(row[name])) for name in RATES)
            samples.append((round(time_s * 1e9), attitude, (p, q, r)))
    return samples


def about(axis: int, angle: float) -> Quaternion:
    """Return the rotation about x, y or z."""
    part = [0.0, 0.0, 0.0]
    part[axis] = math.sin(0.5 * angle)
    return part[0], part[1], part[2], math.cos(0.5 * angle)


def write(target: Path, samples: list[Sample]) -> None:
    """Write pose and twist as a bag."""
    with contextlib.closing(OutputFile(target)) as file:
        writer = McapWriter(file, "tumbling brick")
        writer.begin()
        topics = ("/brick/pose", POSE), ("/brick/twist", TWIST)
        channels = [writer.add_channel(log_channel(*topic, qos_profile(10))) for topic in topics]
        for time_ns, attitude, rates in samples:
            pose = cdr.encode(POSE, time_ns, "world", (0.0, 0.0, 0.0, *attitude))
            twist = cdr.encode(TWIST, time_ns, "body", (0.0, 0.0, 0.0, *rates))
            writer.add_messages(channels, (pose, twist), time_ns, time_ns)
        writer.finish()


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
