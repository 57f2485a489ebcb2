"""Find the methods worth keeping: those near the lowest cost for some error on one of the shipped scenes.

Usage: python benchmarks/front.py [--time S] [--rows FILE] [scene ...]

Runs `trade` on each scene, in plain Python and compiled, by processor time, and prints the table of docs/methods.md.
`--rows` stores the measurements in FILE and measures only scenes that are missing there. `REMOVED` are methods that
were once in the package; they are measured too.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path

import rb_dynamics as rb
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.logs.wrench_bags import read_wrenches
from rb_dynamics.motion import METHODS, splitting
from rb_dynamics.motion.composition import SUZUKI4
from rb_dynamics.scene.shipped import shipped

NEAR = 1.3
DECADES = range(3, 13)
RECORDED = {"slew": "examples/slew.mcap"}
REGIMES = {"plain": "never", "compiled": "always"}

REMOVED = (
    splitting.method("strang4", 4, splitting.kick_free_kick(SUZUKI4), "composed"),
    splitting.method("aba82", 2, splitting.ABA82_STAGES, "on the exact flow"),
    splitting.method("aba104", 4, splitting.ABA104_STAGES, "on the exact flow"),
    splitting.method("aba864", 4, splitting.ABA864_STAGES, "on the exact flow"),
)

# A run: error, time (s per simulated second, without outputs), steps. A scene: runs by regime and method.
Run = tuple[float, float, int]
Runs = dict[str, dict[str, list[Run]]]


def measured(name: str, seconds: float) -> Runs:
    """Return the measurements of `trade` on a scene, with about `seconds` of processor time per regime."""
    scene = rb.read_scene(shipped(f"config/{name}.yaml"))
    topics = [channel.topic for channel in scene.channels]
    commands = read_wrenches(shipped(RECORDED[name]), topics) if name in RECORDED else ()
    found: Runs = {}
    # No kernel supports loads that vary inside a step.
    for regime in REGIMES if scene.combined_effects.takes == LoadDependence.HELD else ("plain",):
        os.environ["RB_DYNAMICS_COMPILE"] = REGIMES[regime]
        # Without a target error, no setting is skipped.
        result = rb.trade(scene, commands, budget=1e-9, time_s=seconds, clock=time.process_time)
        for row in result.rows:
            run = (max(row.error, result.reference.error), row.bare_time_per_s, row.steps)
            found.setdefault(regime, {}).setdefault(row.method, []).append(run)
        print(f"{name}, {regime}: {len(result.rows)} runs, reference good to {result.reference.error:.1e}", flush=True)
    return found


def cost(runs: Iterable[Run], error: float) -> float:
    """Return the shortest time for an error, interpolated between settings by a power law; infinite if unreached."""
    front: list[tuple[float, float]] = []
    for e, t, _ in sorted(runs):
        if not front or t < front[-1][1]:
            front.append((e, t))
    for (e, t), (e2, t2) in pairwise([*front, (math.inf, 0.0)]):
        if e <= error < e2:
            return t if e2 == math.inf else t * (t2 / t) ** (math.log(error / e) / math.log(e2 / e))
    return math.inf


def by_steps(runs: list[Run]) -> list[Run]:
    """Return `runs` with times of steps times the shortest time per step, so that one slow run decides nothing."""
    least = min(t / n for _, t, n in runs)
    return [(e, least * n, n) for e, _, n in runs]


def ratios(scene: Runs, keeping: str) -> dict[tuple[str, int], float]:
    """Return cost over the least for each method and decade, the least of both ways to count and of all regimes.

    Of the methods that keep an invariant of free motion; "unit_quaternion" is kept by all.
    """
    found: dict[tuple[str, int], float] = {}
    for runs in scene.values():
        able = {m: each for m, each in runs.items() if m in METHODS and keeping in METHODS[m].invariants}
        for count in (list, by_steps):
            for k in DECADES:
                costs = {name: cost(count(each), 10.0**-k) for name, each in able.items()}
                least = min(costs.values(), default=math.inf)
                for name, t in costs.items():
                    if t < math.inf:
                        found[name, k] = min(t / least, found.get((name, k), math.inf))
    return found


def verdict(rows: Mapping[str, Runs]) -> dict[str, list[str]]:
    """Return, for each method, where its cost is near the lowest: of all, and of those that conserve an invariant.

    Scenes in closed form decide nothing: there the splittings take the very steps of `exact`.
    """
    found: dict[str, list[str]] = {name: [] for name in METHODS.own if METHODS[name].order is not None}
    for keeping in ("unit_quaternion", "energy", "angular_momentum"):
        near: dict[str, list[str]] = {name: [] for name in found}
        for scene, runs in sorted(rows.items()):
            if "exact" in runs["plain"]:
                continue
            each = ratios(runs, keeping)
            for name in found:
                if ks := [k for k in DECADES if each.get((name, k), math.inf) <= NEAR]:
                    near[name].append(f"{scene} 1e-{ks[0]}" + (f" to 1e-{ks[-1]}" if ks[-1] > ks[0] else ""))
        for name, where in near.items():
            found[name].append(", ".join(where))
    return found


def main(names: list[str], seconds: float, kept: str) -> None:
    METHODS.own = {**METHODS.own, **{method.name: method for method in REMOVED}}
    rows: dict[str, Runs] = json.loads(Path(kept).read_text()) if kept and Path(kept).exists() else {}
    for name in names or sorted(path.stem for path in shipped("config/slew.yaml").parent.glob("*.yaml")):
        if name not in rows:
            rows[name] = measured(name, seconds)
            if kept:
                Path(kept).write_text(json.dumps(rows))
    print(
        "| method | of all methods | of those that conserve energy | of those that conserve angular momentum |\n"
        + "| --- " * 4
        + "|"
    )
    removed = {method.name for method in REMOVED}
    for name, cells in verdict(rows).items():
        print(" | ".join((f"| *{name}*" if name in removed else f"| `{name}`", *cells)) + " |")


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("scenes", nargs="*", help="names of shipped scenes; all without")
    arguments.add_argument(
        "--time", type=float, default=30.0, metavar="S", help="processor time for a scene and regime"
    )
    arguments.add_argument("--rows", default="", metavar="FILE", help="keep what is measured; JSON")
    given = arguments.parse_args()
    main(given.scenes, given.time, given.rows)
