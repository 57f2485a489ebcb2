"""Identify bodies thrown by hand with a flywheel inside, and print the table of docs/identify.md.

    pip install orangebox==0.3.1
    python tools/identify_throws.py FOLDER [CONFIGURATION ...]

FOLDER is "input" of https://github.com/tudelft/inertiaEstimation (Blaha et al., arXiv 2503.13137), which has no licence
and is not part of this package: logs of Betaflight with a gyro at 4 kHz and the rate of the flywheel, and how the
bodies are built of blocks that were weighed. CONFIGURATIONS are a, b, c, empty, of final_tests.

The moments of inertia are told in units of the flywheel's. That comes from throws of the device alone and with a box of
known inertia, final_calibration: all throws of each are fitted together. Air takes up to a tenth of the momentum that
the flywheel gives: quadratic drag of rotation is fitted. The flywheel's vibration shifts the zero of the gyro, which
is therefore fitted too. The centre of mass, by which the device's share is taken off, is that at which the specific
force of a free fall is zero. Intervals hold the errors of throw and calibration.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rb_dynamics import identify, parse_scene
from rb_dynamics.analysis.identification.flights import RATES, Flight, Stream
from rb_dynamics.loads.gyrostat_rotor import Rotor

# Device, its box for calibration, the frame of the bodies and a block: kg, m.
DEVICE, BOX, FRAME, BLOCK = 0.10067, 0.346, 0.1785, 0.0701
BOX_SIZE, BLOCK_SIZE = (0.0600, 0.0700, 0.0302), (0.015, 0.015, 0.040)
FRAME_CENTER = np.array([0.0, 0.0, -0.0189])
FRAME_INERTIA = FRAME / 145.2 * np.diag([0.2994, 0.1004, 0.3506])
# Any: what is found is in units of it.
UNIT = 1e-5
SCENE = """
body: {{mass: 1, inertia: {{diagonal: [{0}, {0}, {0}]}}}}
effects: [{{type: quadratic_drag, rotation: [0, 0, 0]}}]
"""
# Where fits begin: of the device, and of all that is heavier.
SMALL, LARGE = 4e-4, 4e-3
COLUMNS = ("time", *(f"{name}[{k}]" for name in ("gyroADC", "accSmooth") for k in range(3)), "erpm[0]")
# Samples at rest; after the flywheel has started; and every which one is fitted.
REST, SKIP, EVERY = 400, 300, 4
LOWER = np.tril_indices(3)


@dataclass(frozen=True)
class Throw:
    """One throw: times (ns), rates (rad/s), specific force (m/s^2) and rate of the flywheel (rad/s) in device axes."""

    name: str
    time_ns: Any
    rates: Any
    force: Any
    wheel: Any


def read(path: Path) -> Throw:
    """Return the part of a log after the flywheel has started."""
    from orangebox import Parser

    log = Parser.load(str(path))
    places = [log.field_names.index(name) for name in COLUMNS]
    rows = np.array([[frame.data[k] for k in places] for frame in log.frames()], dtype=np.float64)
    rates, force = np.radians(rows[:, 1:4]) / 16.384, rows[:, 4:7] * 9.81 / 2048.0
    begins = range(0, len(rows) - REST, REST)
    quiet = min(begins, key=lambda k: float(rates[k : k + REST].std(axis=0).max()))
    rates = rates - rates[quiet : quiet + REST].mean(axis=0)
    wheel = -rows[:, 7] * 100.0 / 7.0 * 2.0 * np.pi / 60.0
    first = int(np.argmax(np.abs(wheel) > 10.0)) + SKIP
    times = np.rint((rows[first:, 0] - rows[first, 0]) * 1e3).astype(np.int64)
    # The board is turned by a quarter.
    turned = [np.column_stack([-v[first:, 1], v[first:, 0], v[first:, 2]]) for v in (rates, force)]
    return Throw(path.stem, times, *turned, wheel[first:])


class Found(NamedTuple):
    """An inertia, in units of the flywheel's over `UNIT`, and the covariance of its lower triangle."""

    inertia: Any
    covariance: Any


def fitted(throws: Sequence[Throw], start: float) -> Found:
    """Return the inertia of device and body that fits all `throws`, each with a start and a zero of the gyro."""
    flights, spins, begin = [], [], 0
    for throw in throws:
        times = throw.time_ns[::EVERY] + begin
        flights.append(Flight(throw.name, (Stream("gyro", RATES, times, throw.rates[::EVERY], gyro=True),)))
        spins += zip((times * 1e-9).tolist(), throw.wheel[::EVERY].tolist(), strict=True)
        begin = int(times[-1]) + 1_000_000_000
    scene = parse_scene(SCENE.format(start))
    scene = replace(scene, effects=(*scene.effects, Rotor((0.0, 0.0, 1.0), UNIT, tuple(spins))))
    result = identify(scene, flights, ["inertia", "gyro_bias", "effects[0].rotation"], starts=1)
    names = [each.name for each in result.parameters]
    rows = [names.index(f"inertia.{'xyz'[j]}{'xyz'[i]}") for i, j in zip(*LOWER, strict=True)]
    if not all(result.parameters[row].known for row in rows):
        raise SystemExit(f"{', '.join(throw.name for throw in throws)}: the inertia is not known")
    return Found(np.array(result.body.inertia), result.covariance[np.ix_(rows, rows)])


def center(throw: Throw) -> Any:
    """Return where the accelerometer is against the centre of mass, by least squares of smoothed signals."""
    from scipy.signal import butter, filtfilt

    low = butter(4, 20.0, fs=1e9 / float(np.median(np.diff(throw.time_ns))))
    rates, force = (filtfilt(*low, v, axis=0)[100:-100:EVERY] for v in (throw.rates, throw.force))
    bent = np.gradient(rates, throw.time_ns[100:-100:EVERY] * 1e-9, axis=0)
    arms = [hat(a) + hat(w) @ hat(w) for a, w in zip(bent, rates, strict=True)]
    return np.linalg.lstsq(np.vstack(arms), force.ravel(), rcond=None)[0]


def hat(v: Any) -> Any:
    """Return the matrix of v x."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def at(mass: float, arm: Any) -> Any:
    """Return the inertia of a point."""
    return mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))


def box(mass: float, size: tuple[float, ...]) -> Any:
    """Return the inertia of a box about its centre."""
    squares = np.square(size)
    return mass / 12.0 * np.diag(squares.sum() - squares)


def truth(folder: Path) -> tuple[str, float, Any]:
    """Return name, mass and inertia of a body, as it is built."""
    tree = ast.parse((folder / "config.py").read_text(encoding="utf-8"))
    set_to = {n.targets[0].id: n.value for n in tree.body if isinstance(n, ast.Assign) and hasattr(n.targets[0], "id")}
    grid = np.array(ast.literal_eval(set_to["grid"].args[0]))  # type: ignore[attr-defined]
    blocks = [np.array([9.0 + (i - 2) * 18.0, 9.0 + (j - 4) * 18.0, -22.0]) * 1e-3 for i, j in np.argwhere(grid)]
    mass = FRAME + BLOCK * len(blocks)
    middle = (FRAME * FRAME_CENTER + BLOCK * np.sum(blocks, axis=0)) / mass if blocks else FRAME_CENTER
    inertia = FRAME_INERTIA + at(FRAME, FRAME_CENTER - middle)
    inertia = inertia + sum((box(BLOCK, BLOCK_SIZE) + at(BLOCK, each - middle) for each in blocks), np.zeros((3, 3)))
    return ast.literal_eval(set_to["name"]), mass, inertia


def main() -> None:
    """Print the table."""
    folder, names = Path(sys.argv[1]), sys.argv[2:] or ["a", "b", "c", "empty"]
    alone, boxed = (
        [read(path) for path in sorted((folder / "final_calibration" / part).glob("*.BFL"))]
        for part in ("device_only", "proof_body")
    )
    device, both = fitted(alone, SMALL), fitted(boxed, LARGE)
    place, other = (np.mean([center(throw) for throw in part], axis=0) for part in (alone, boxed))
    moved = place - other
    expected = (box(BOX, BOX_SIZE) + at(BOX, DEVICE / BOX * moved) + at(DEVICE, moved))[LOWER]
    found = (both.inertia - device.inertia)[LOWER]
    scale = float(found @ expected / (found @ found))
    # How the scale changes with what is found.
    scale_by = (expected - 2.0 * scale * found) / (found @ found)
    misfit = np.linalg.norm(scale * found - expected) / np.linalg.norm(expected)
    error = np.sqrt(scale_by @ (both.covariance + device.covariance) @ scale_by)
    print(f"Flywheel: {scale * UNIT:.4g} +- {error * UNIT:.1g} kg m^2; the box is found to {100 * misfit:.1f} %.\n")
    print("| body | throws | mean error of the moments | spread | mean of the error of a throw | in the interval |")
    print("|---|---|---|---|---|---|")
    for name in names:
        label, mass, inertia = truth(folder / "final_tests" / f"config_{name}")
        true = np.linalg.eigvalsh(inertia)
        errors, held = [], []
        for path in sorted((folder / "final_tests" / f"config_{name}").glob("*.BFL")):
            throw = read(path)
            result = fitted([throw], LARGE)
            arm, own = place - center(throw), result.inertia - device.inertia
            moments, axes = np.linalg.eigh(scale * own - at(mass, DEVICE / mass * arm) - at(DEVICE, arm))
            off = moments - true
            errors.append(off)
            # Of each moment: by what is found of the throw, of the box and of the device.
            twice = 2.0 - np.eye(3)
            along = np.array([(twice * np.outer(axis, axis))[LOWER] for axis in axes.T])
            rescaled = np.outer(along @ own[LOWER], scale_by)
            parts = ((scale * along, result), (rescaled, both), (-scale * along - rescaled, device))
            variance = sum(np.einsum("ij,jk,ik->i", by, each.covariance, by) for by, each in parts)
            held.append(np.abs(off) <= 1.96 * np.sqrt(variance))
            print(f"{path.stem}: " + ", ".join(f"{100 * e:+.1f} %" for e in off / true), file=sys.stderr, flush=True)
        mean, spread = (
            ", ".join(f"{100 * e:+.1f} %" for e in part)
            for part in (np.mean(errors, axis=0) / true, np.std(errors, axis=0) / true)
        )
        each = np.linalg.norm(errors, axis=1) / np.linalg.norm(true)
        inside = f"{int(np.sum(held))} of {np.size(held)}"
        print(
            f"| {label} | {len(errors)} | {mean} | {spread.replace('+', '')} | {100 * each.mean():.1f} % | {inside} |"
        )


if __name__ == "__main__":
    main()
