"""What a run of a campaign costs: by number of runs, by workers, and beside a Monte Carlo of Basilisk.

Usage: python benchmarks/campaign.py runs [MOST] | workers | peer [RUNS] [--basilisk PYTHON] | memory

`runs`: 10 s of closed loop, 1 to MOST runs (default 100000) in blocks on one worker. `workers`: 10 000 runs of
config/campaigns/detumble.yaml on one process and on two. `peer`: 300 s of rate damping with steps of 0.05 s and samples
of 0.5 s, no delay, no noise; Basilisk by its own RK4 and its compiled modules, one simulation after the other, in the
interpreter that --basilisk names. `memory`: what a worker holds. Times are of one core of this machine, best of some
repeats, and of the clock for `workers`.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
DETUMBLE = ROOT / "config" / "campaigns" / "detumble.yaml"
MOMENTS, RATE, GAIN = (0.112, 0.135, 0.186), (0.05, 0.1, -0.03), 0.01
STEP, SAMPLE, END = 0.05, 0.5, 300.0
REPEATS = 3

SCENE = f"""\
body: {{mass: 14, inertia: {{diagonal: {list(MOMENTS)}}}}}
initial: {{angular_velocity_body: {list(RATE)}}}
wrenches: []
solver: {{method: rk4, step: {STEP}}}
"""
CAMPAIGN = """\
scene: scene.yaml
set: {{duration: {end}}}
runs: {runs}
sampling: random
disperse:
  initial.angular_velocity_body: {{normal: {{deviation: 0.12}}}}
  body.inertia: {{second_moments: 0.15, axes: 0.05}}
control: {{law: rate_damping, rate: {rate}, parameters: {{gain: {gain}}}}}
metrics: {{final_rate: {{final: rate}}}}
"""


def seconds(do: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the least time (s) of a processor that `do` takes: others may use the machine too."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        do()
        times.append(time.process_time() - begin)
    return min(times)


def campaign(folder: str, end: float, runs: int) -> Any:
    from rb_dynamics.campaign.read import read_campaign

    Path(folder, "scene.yaml").write_text(SCENE)
    path = Path(folder, "campaign.yaml")
    path.write_text(CAMPAIGN.format(end=end, runs=runs, rate=1.0 / SAMPLE, gain=GAIN))
    return read_campaign(path)


def by_runs(most: int) -> None:
    from rb_dynamics.campaign.engine import SIDE_BY_SIDE
    from rb_dynamics.campaign.flight import fly_block

    with tempfile.TemporaryDirectory() as folder:
        found = campaign(folder, 10.0, most)
        fly_block(found, 0, 2000, 1)
        print("    runs   us a run   (10 s of motion, 200 steps, 20 samples; one core)")
        for runs in [10**k for k in range(round(math.log10(most)) + 1)]:

            def fly(runs: int = runs) -> None:
                for first in range(0, runs, SIDE_BY_SIDE):
                    fly_block(found, first, min(runs, first + SIDE_BY_SIDE), 1)

            print(f"{runs:8d} {seconds(fly, REPEATS if runs <= 10_000 else 1) / runs * 1e6:10.1f}", flush=True)


def by_workers(runs: int) -> None:
    from rb_dynamics.campaign.engine import run_campaign
    from rb_dynamics.campaign.read import read_campaign
    from rb_dynamics.campaign.store import Store

    def processor_time() -> float:
        usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(usage.ru_utime + usage.ru_stime for usage in usages)

    def fly(count: int, workers: int, folder: str) -> tuple[float, float]:
        """Return the time of all processors, and the rate by the clock once all have started."""
        found, seen = read_campaign(DETUMBLE, {"runs": count}), []
        store, begin = Store(Path(folder, "rows.parquet"), found, overwrite=True), processor_time()

        def note(done: int, _: int) -> None:
            seen.append((time.perf_counter(), done))

        run_campaign(found, store, workers=workers, block=max(1, runs // 16), progress=note)
        first, last = seen[len(seen) // 4], seen[-1]
        return processor_time() - begin, (last[1] - first[1]) / (last[0] - first[0])

    each = {}
    with tempfile.TemporaryDirectory() as folder:
        for workers in (1, 2):
            # What starting costs drops out of the difference.
            (few, _), (many, rate) = fly(runs // 4, workers, folder), fly(runs, workers, folder)
            each[workers] = (many - few) / (runs - runs // 4)
            cost = f"{each[workers] * 1e3:.3f} ms of processors a run"
            print(f"{workers} workers: {cost}, {rate:.0f} runs a second", flush=True)
    print(f"two take {each[2] / each[1]:.2f} of the time of one: efficiency {each[1] / each[2]:.0%} on free cores")


def beside(runs: int, python: str) -> None:
    from rb_dynamics.campaign.flight import fly_block

    with tempfile.TemporaryDirectory() as folder:
        found = campaign(folder, END, 2000)
        fly_block(found, 0, 2000, 1)
        ours = seconds(lambda: fly_block(found, 0, 2000, 1)) / 2000
        print(f"rb_dynamics  {ours * 1e3:9.3f} ms a run, {1.0 / ours:8.0f} runs a second on one core")
        alone = seconds(lambda: fly_block(found, 0, 1, 1))
        print(f"   one run   {alone * 1e3:9.3f} ms")
        rows = fly_block(found, 0, runs, 1)
        tasks = {"spins": [rows[f"initial.angular_velocity_body[{i}]"].tolist() for i in range(3)]}
        tasks["inertias"] = _inertias(found, runs)
        answer = subprocess.run(
            [python, __file__, "basilisk"], input=json.dumps(tasks), capture_output=True, text=True, check=True
        )
        peer = json.loads(answer.stdout.splitlines()[-1])
        theirs = min(peer["times"])
        speed = f"{theirs * 1e3:9.3f} ms a run, {1.0 / theirs:8.0f} runs a second on one core"
        print(f"Basilisk     {speed} ({peer['version']})")
        worst = max(abs(a - b) for a, b in zip(peer["final_rates"], rows["final_rate"].tolist(), strict=True))
        print(f"ratio        {theirs / ours:9.1f}   largest difference of final rates {worst:.1e} rad/s")


def _inertias(found: Any, runs: int) -> list[Any]:
    from rb_dynamics.campaign.sampling import inputs
    from rb_dynamics.campaign.scenes import Scenes

    scenes, names = Scenes(found), [each.name for each in found.inputs]
    return [scenes.scene(dict(zip(names, row, strict=True))).body.inertia for row in inputs(found, 0, runs).tolist()]


def basilisk(tasks: Any) -> Any:
    """Fly the runs by Basilisk: navigation, guidance, a PD law without its P, and an external torque, all compiled."""
    import Basilisk
    from Basilisk.architecture import bskLogging, messaging
    from Basilisk.fswAlgorithms import attTrackingError, inertial3D, mrpPD
    from Basilisk.simulation import extForceTorque, simpleNav, spacecraft
    from Basilisk.utilities import SimulationBaseClass, macros

    bskLogging.setDefaultLogLevel(bskLogging.BSK_ERROR)

    def fly(spin: list[float], inertia: list[list[float]]) -> float:
        simulation = SimulationBaseClass.SimBaseClass()
        process = simulation.CreateNewProcess("process")
        # The flight software first, so that a sample takes effect at once.
        process.addTask(simulation.CreateNewTask("control", macros.sec2nano(SAMPLE)), 10)
        process.addTask(simulation.CreateNewTask("motion", macros.sec2nano(STEP)), 1)
        craft, push, sense = spacecraft.Spacecraft(), extForceTorque.ExtForceTorque(), simpleNav.SimpleNav()
        craft.hub.mHub, craft.hub.IHubPntBc_B = 14.0, inertia
        craft.hub.omega_BN_BInit = [[c] for c in spin]
        craft.addDynamicEffector(push)
        guide, error, law = inertial3D.inertial3D(), attTrackingError.attTrackingError(), mrpPD.mrpPD()
        law.K, law.P = 0.0, GAIN
        configuration = messaging.VehicleConfigMsgPayload(ISCPntB_B=[x for row in inertia for x in row])
        vehicle = messaging.VehicleConfigMsg().write(configuration)
        sense.scStateInMsg.subscribeTo(craft.scStateOutMsg)
        error.attNavInMsg.subscribeTo(sense.attOutMsg)
        error.attRefInMsg.subscribeTo(guide.attRefOutMsg)
        law.guidInMsg.subscribeTo(error.attGuidOutMsg)
        law.vehConfigInMsg.subscribeTo(vehicle)
        push.cmdTorqueInMsg.subscribeTo(law.cmdTorqueOutMsg)
        for module in (sense, guide, error, law):
            simulation.AddModelToTask("control", module)
        simulation.AddModelToTask("motion", craft)
        simulation.AddModelToTask("motion", push)
        simulation.InitializeSimulation()
        simulation.ConfigureStopTime(macros.sec2nano(END))
        simulation.ExecuteSimulation()
        return math.hypot(*(c[0] for c in craft.dynManager.getStateObject("hubOmega").getState()))

    spins = list(zip(*tasks["spins"], strict=True))
    times, rates = [], []
    fly(list(spins[0]), tasks["inertias"][0])
    for _ in range(REPEATS):
        begin = time.process_time()
        rates = [fly(list(spin), inertia) for spin, inertia in zip(spins, tasks["inertias"], strict=True)]
        times.append((time.process_time() - begin) / len(spins))
    return {"times": times, "final_rates": rates, "version": f"Basilisk {Basilisk.__version__}"}


def memory() -> None:
    from rb_dynamics.campaign.flight import fly_block
    from rb_dynamics.campaign.read import read_campaign

    found = read_campaign(DETUMBLE)
    fly_block(found, 0, 20, 1)
    for runs in (250, 1000, 2000, 4000):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        fly_block(found, 0, runs, 1)
        after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        print(
            f"{runs:6d} runs in a block: peak {after / 1024:7.1f} MiB, {(after - before) / 1024:6.1f} more than before"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("runs", "workers", "peer", "memory", "basilisk"))
    parser.add_argument("count", nargs="?", type=int)
    parser.add_argument("--basilisk", default=sys.executable, metavar="PYTHON")
    args = parser.parse_args()
    if args.what == "runs":
        by_runs(args.count or 100_000)
    elif args.what == "workers":
        by_workers(args.count or 10_000)
    elif args.what == "peer":
        beside(args.count or 20, args.basilisk)
    elif args.what == "memory":
        memory()
    else:
        print(json.dumps(basilisk(json.load(sys.stdin))))


if __name__ == "__main__":
    main()
