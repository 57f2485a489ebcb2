"""Measure the time and memory of campaign runs by number of runs and workers, and compare with Basilisk's Monte Carlo.

Usage: python benchmarks/campaign.py WHAT [COUNT] [--basilisk PYTHON]

`runs`: 1 to COUNT runs (default 100000) of 10 s in closed loop, in blocks on one worker.
`workers`: COUNT runs (default 10000) of config/campaigns/detumble.yaml on one worker and on two, twice, and in two
    processes without dask; prints the share of the machine that other processes used.
`limits`: time of the client per block, with workers that return made-up rows; COUNT blocks (default 200).
`peer`: COUNT runs (default 20) of 300 s of rate damping, steps of 0.05 s and samples of 0.5 s, without delay or noise;
    Basilisk uses its own RK4 and compiled modules, one simulation after the other, in the interpreter given by
    --basilisk.
`effects`: COUNT runs (default 500) of that with one effect, against the same runs without.
`accuracy`: COUNT runs (default 200) of config/campaigns/capture.yaml, by accuracy under an effect, in a block and each
    alone, in turn.
`spacecraft`: COUNT runs (default 400) of config/campaigns/spacecraft.yaml, as `accuracy`.
`devices`: COUNT runs (default 400) of 150 s of that satellite without magnetorquers, as `accuracy`: with six thrusters,
    pulsed at 2 Hz by the gyro, beside its wheels and in their place, and with wheels by a law that reads the
    accelerometer.
`satellite`: 300 s of a 6U satellite in orbit: three wheels with friction, noisy gyro and star tracker at 2 Hz,
    attitude_pd, gravity gradient; in turn in Basilisk, COUNT runs (default 100) as for `peer`, with steps of 0.1 s, and
    in a block of 2000 runs by `dverk` and by `auto`, three times; what Basilisk's error and time are by step; and where
    the time goes.
`memory`: memory of a worker.
Times are for one core of this machine, the best of several repeats; `workers` measures wall-clock time.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parent.parent
DETUMBLE = ROOT / "config" / "campaigns" / "detumble.yaml"
CAPTURE = ROOT / "config" / "campaigns" / "capture.yaml"
SPACECRAFT = ROOT / "config" / "campaigns" / "spacecraft.yaml"
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

MU, ORBIT = 3.986004418e14, (6878137.0, 7612.6)
SATELLITE_MOMENTS, WHEEL, FASTEST = (0.05, 0.12, 0.14), 3e-5, 600.0
COULOMB, VISCOUS, MOST_TORQUE = 2e-6, 1e-8, 2e-3
STIFFNESS, DAMPING, GYRO_NOISE, TRACKER_NOISE = 0.002, 0.02, 1e-4, 1e-4
PEER_STEP = 0.1
_WHEEL = f"inertia: {WHEEL}, max_torque: {MOST_TORQUE}, max_speed: {FASTEST}"
_FRICTION = f"friction: {{coulomb: {COULOMB}, viscous: {VISCOUS}}}"
SATELLITE = f"""\
body: {{mass: 10.0, inertia: {{diagonal: {list(SATELLITE_MOMENTS)}}}}}
initial: {{position_world: [{ORBIT[0]}, 0, 0], linear_velocity_world: [0, 0, {ORBIT[1]}],
  angular_velocity_body: [0, 0, 0]}}
wrenches: []
effects: [{{type: central_gravity, gravitational_parameter: {MU}, gravity_gradient: true}}]
actuators:
  - {{type: reaction_wheel, name: x, axis: [1, 0, 0], {_WHEEL}, {_FRICTION}}}
  - {{type: reaction_wheel, name: y, axis: [0, 1, 0], {_WHEEL}, {_FRICTION}}}
  - {{type: reaction_wheel, name: z, axis: [0, 0, 1], {_WHEEL}, {_FRICTION}}}
sensors:
  - {{type: imu, name: imu, rate: 2.0, gyro: {{noise_density: {GYRO_NOISE}}}}}
  - {{type: star_tracker, name: tracker, rate: 2.0, noise: {TRACKER_NOISE}}}
solver: {{method: METHOD, accuracy: 1.0e-6}}
output_rate: 2.0
"""
SATELLITES = """\
scene: scene.yaml
set: {{duration: {end}}}
runs: {runs}
sampling: random
disperse:
  initial.angular_velocity_body: {{normal: {{deviation: 0.01}}}}
  body.inertia: {{second_moments: 0.05, axes: 0.02}}
control:
  law: attitude_pd
  rate: 2
  through: [x, y, z]
  parameters: {{proportional: {stiffness}, derivative: {damping}}}
metrics: {{final_rate: {{final: rate}}, pointing: {{final: attitude}}}}
"""

_SENSES = f"""\
sensors: [{{type: imu, name: imu, rate: 2.0, gyro: {{noise_density: {GYRO_NOISE}}},
  accelerometer: {{noise_density: 1.0e-5}}}}]
"""
# Frames on the body; force along their x axes gives torques about x, y and z.
_FRAMES = """\
  frames:
    x: {position: [0, 0.1, 0], orientation: {x: 0, y: -0.7071067811865476, z: 0, w: 0.7071067811865476}}
    less_x: {position: [0, -0.1, 0], orientation: {x: 0, y: -0.7071067811865476, z: 0, w: 0.7071067811865476}}
    y: {position: [0, 0, 0.1]}
    less_y: {position: [0, 0, -0.1]}
    z: {position: [0.1, 0, 0], orientation: {x: 0, y: 0, z: 0.7071067811865476, w: 0.7071067811865476}}
    less_z: {position: [-0.1, 0, 0], orientation: {x: 0, y: 0, z: 0.7071067811865476, w: 0.7071067811865476}}
"""
_THRUSTERS = "".join(
    f"  - {{type: thruster, name: jet_{at}, frame: {at}, force: 0.05, minimum_on: 0.01}}\n"
    for at in ("x", "less_x", "y", "less_y", "z", "less_z")
)
DEVICES_LAW = """\
import numpy as np


def with_wheels(parameters):
    return lambda measured: turned(measured, 0.01)


def with_thrusters(parameters):
    return lambda measured: pulsed(measured)


def with_both(parameters):
    return lambda measured: turned(measured, 0.01) | pulsed(measured)


def with_forces(parameters):
    def command(measured):
        force = measured.sensors["imu"].specific_force
        return {name: value + 1e-6 * force[:, 0] for name, value in turned(measured, 0.01).items()}

    return command


def turned(measured, gain):
    return {axis: gain * measured.angular_velocity_body[:, i] for i, axis in enumerate("xyz")}


def pulsed(measured):
    found = {}
    for i, axis in enumerate("xyz"):
        on = -4.0 * measured.angular_velocity_body[:, i]
        for name, time in ((axis, on), ("less_" + axis, -on)):
            found["jet_" + name] = np.where(time < 0.01, 0.0, np.minimum(time, 0.4))
    return found
"""
DEVICES = """\
scene: scene.yaml
set: {duration: 150, solver.method: METHOD}
runs: 400
sampling: random
disperse:
  initial.angular_velocity_body: {normal: {deviation: 0.03}}
  body.inertia: {second_moments: 0.05, axes: 0.02}
  control.delay: {uniform: {low: 0.02, high: 0.2}}
control: {law: devices_law.LAW, rate: 2, delay: 0.05, parameters: {}}
metrics: {final_rate: {final: rate}}
"""


def seconds(do: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the shortest processor time (s) of `do`, since other processes may use the machine too."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        do()
        times.append(time.process_time() - begin)
    return min(times)


def campaign(folder: str, end: float, runs: int) -> Any:
    from rb_dynamics.study.campaign.read import read_campaign

    Path(folder, "scene.yaml").write_text(SCENE)
    path = Path(folder, "campaign.yaml")
    path.write_text(CAMPAIGN.format(end=end, runs=runs, rate=1.0 / SAMPLE, gain=GAIN))
    return read_campaign(path)


def by_runs(most: int) -> None:
    from rb_dynamics.study.campaign.block_of_runs import simulate_block
    from rb_dynamics.study.campaign.engine import SIDE_BY_SIDE

    with tempfile.TemporaryDirectory() as folder:
        found = campaign(folder, 10.0, most)
        simulate_block(found, 0, 2000, 1)
        print("    runs   us a run   (10 s of motion, 200 steps, 20 samples; one core)")
        for runs in [10**k for k in range(round(math.log10(most)) + 1)]:

            def fly(runs: int = runs) -> None:
                for first in range(0, runs, SIDE_BY_SIDE):
                    simulate_block(found, first, min(runs, first + SIDE_BY_SIDE), 1)

            print(f"{runs:8d} {seconds(fly, REPEATS if runs <= 10_000 else 1) / runs * 1e6:10.1f}", flush=True)
        print(f"of which {making(found) * 1e6:10.1f} to make and check its scene")


def making(found: Any, runs: int = 200) -> float:
    """Return the time (s) to make and check the scene of a run."""
    from rb_dynamics.study.campaign.block_of_runs import values_of
    from rb_dynamics.study.campaign.scenes import Scenes

    scenes, values = Scenes(found), [values_of(found, run) for run in range(runs)]
    return seconds(lambda: [scenes.scene(values[run], run) for run in range(runs)]) / runs


class Flown(NamedTuple):
    """Cost of a campaign: runs per second while all workers are busy, and total time (s)."""

    rate: float
    clock: float
    processors: float
    commanding: float
    others: float


def by_workers(runs: int) -> None:
    from rb_dynamics.study.campaign.engine import run_campaign
    from rb_dynamics.study.campaign.read import read_campaign
    from rb_dynamics.study.campaign.store import Store

    found, best = read_campaign(DETUMBLE, {"runs": runs}), dict[int, Flown]()

    def fly(workers: int, folder: str) -> Flown:
        seen: list[tuple[float, int]] = []
        store = Store(Path(folder, "rows.parquet"), found, overwrite=True)
        begin, used, own, busy = time.perf_counter(), processor_time(), time.process_time(), machine_time()
        run_campaign(found, store, workers=workers, progress=lambda done, _: seen.append((time.perf_counter(), done)))
        clock, own, used = time.perf_counter() - begin, time.process_time() - own, processor_time() - used
        # From the time at which each worker has returned its first block.
        (first, before), (last, done) = seen[workers - 1], seen[-1]
        return Flown((done - before) / (last - first), clock, used, own, (machine_time() - busy - used) / clock)

    with tempfile.TemporaryDirectory() as folder:
        for workers in (1, 2) * 2:
            took = fly(workers, folder)
            whole = f"{took.rate:6.0f} runs a second, {took.clock:5.1f} s with start and end"
            spent = f"processors {took.processors / runs * 1e3:.3f} ms a run, {took.commanding:.1f} s of who commands"
            print(f"{workers} at work: {whole}; {spent}; others took {took.others:.0%} of a core", flush=True)
            best[workers] = max(took, best.get(workers, took))
    one, two = best[1], best[2]
    print(f"efficiency of two {two.rate / one.rate / 2:.0%}, with start and end {one.clock / two.clock / 2:.0%}")
    bare = {count: side_by_side(count) for count in (1, 2)}
    print(f"two processes that know nothing of each other: {bare[1] / bare[2]:.0%}")


def processor_time() -> float:
    """Return the processor time (s) of this process and of its children that have ended."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def machine_time() -> float:
    """Return the processor time (s) of all processes of this machine, of Linux alone."""
    user, nice, system = map(int, Path("/proc/stat").read_text().split()[1:4])
    return (user + nice + system) / os.sysconf("SC_CLK_TCK")


def side_by_side(processes: int) -> float:
    """Return the time (s) of blocks in so many processes without dask: the limit of the machine."""
    context = multiprocessing.get_context("spawn")
    with context.Pool(processes, wait_for_all, (context.Barrier(processes),)) as pool:
        return min(max(pool.map(alone, range(processes), 1)) for _ in range(REPEATS))


def wait_for_all(barrier: Any) -> None:
    global ready  # noqa: PLW0603
    ready = barrier.wait


def alone(_: int) -> float:
    from rb_dynamics.study.campaign.block_of_runs import simulate_block
    from rb_dynamics.study.campaign.engine import SIDE_BY_SIDE
    from rb_dynamics.study.campaign.read import read_campaign

    found = read_campaign(DETUMBLE)
    simulate_block(found, 0, 20, 1)
    ready()
    begin = time.perf_counter()
    for first in range(0, 2 * SIDE_BY_SIDE, SIDE_BY_SIDE):
        simulate_block(found, first, first + SIDE_BY_SIDE, 1)
    return time.perf_counter() - begin


def limits(blocks: int) -> None:
    """Measure the client's work per block and row, with workers that return made-up rows at once."""
    from rb_dynamics.report.campaign_page import campaign_report
    from rb_dynamics.study.campaign import engine
    from rb_dynamics.study.campaign.read import read_campaign
    from rb_dynamics.study.campaign.store import Store, read_rows
    from rb_dynamics.study.campaign.summary import summarise

    size, simulate_block, simulate_on_worker = engine.SIDE_BY_SIDE, engine.simulate_block, engine.simulate_on_worker
    runs = blocks * size
    found = read_campaign(DETUMBLE, {"runs": runs, "sampling": "random"})
    sample = simulate_block(found, 0, 20, 1)
    flying = seconds(lambda: simulate_block(found, 0, size, 1)) / size
    names = [name for name in sample if name not in ("run", "seed", "passed", "error")]

    def made_up(_: Any, __: str, first: int, last: int) -> dict[str, Any]:
        import numpy as np

        random, count = np.random.default_rng(first), last - first
        whole = {"run": np.arange(first, last), "seed": np.ones(count, dtype=np.int64)}
        columns = {name: random.random(count) for name in names}
        return {**whole, **columns, "passed": np.ones(count, dtype=np.bool_), "error": [""] * count}

    with tempfile.TemporaryDirectory() as folder:
        out, seen = Path(folder, "rows.parquet"), []
        engine.simulate_on_worker = made_up
        try:
            engine.run_campaign(
                found,
                Store(out, found),
                workers=2,
                block=size,
                progress=lambda *_: seen.append((time.perf_counter(), time.process_time())),
            )
        finally:
            engine.simulate_on_worker = simulate_on_worker
        joining = (time.process_time() - seen[-1][1]) / runs
        clock, block = ((last - first) / (len(seen) - 1) for first, last in zip(seen[0], seen[-1], strict=True))
        store, rows = Store(Path(folder, "again.parquet"), found), made_up(None, "", 0, size)
        writing = seconds(lambda: store.write(rows), 20)
        disk = out.stat().st_size / runs
        table = read_rows(out)

        def tell(count: int) -> None:
            some = {name: column[:count] for name, column in table.items()}
            summarise(found, some)
            campaign_report(found, some)

        few, before = seconds(lambda: tell(size)), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        telling = (seconds(lambda: tell(runs), 1) - few) / (runs - size)
        memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 / runs
    print(f"flying                     {flying * 1e3:8.3f} ms a run")
    print(
        f"commanding                 {block * 1e3:8.3f} ms a block of {size}, of which writing {writing * 1e3:.3f} ms"
    )
    print(f"  by the clock             {clock * 1e3:8.3f} ms a block")
    print(f"making one file            {joining * 1e6:8.3f} us a row, {disk:.0f} bytes a row")
    print(f"summary and page           {telling * 1e6:8.3f} us a row, {memory:.0f} bytes a row of memory")
    print(f"one commanding process feeds {size * flying / block:.0f} cores")


def beside(runs: int, python: str) -> None:
    from rb_dynamics.study.campaign.block_of_runs import simulate_block

    with tempfile.TemporaryDirectory() as folder:
        found = campaign(folder, END, 2000)
        simulate_block(found, 0, 2000, 1)
        ours = seconds(lambda: simulate_block(found, 0, 2000, 1)) / 2000
        print(f"rb_dynamics  {ours * 1e3:9.3f} ms a run, {1.0 / ours:8.0f} runs a second on one core")
        one = seconds(lambda: simulate_block(found, 0, 1, 1))
        print(f"   one run   {one * 1e3:9.3f} ms")
        rows = simulate_block(found, 0, runs, 1)
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


def satellite(runs: int, python: str) -> None:
    from rb_dynamics.study.campaign.block_of_runs import simulate_block
    from rb_dynamics.study.campaign.engine import SIDE_BY_SIDE
    from rb_dynamics.study.campaign.read import read_campaign

    def found(method: str, end: float = END) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "scene.yaml").write_text(SATELLITE.replace("METHOD", method))
            text = SATELLITES.format(end=end, runs=SIDE_BY_SIDE, stiffness=STIFFNESS, damping=DAMPING)
            Path(folder, "campaign.yaml").write_text(text)
            return read_campaign(Path(folder, "campaign.yaml"))

    def ours(campaign: Any) -> float:
        return seconds(lambda: simulate_block(campaign, 0, SIDE_BY_SIDE, 1), 1) / SIDE_BY_SIDE

    campaigns = {method: found(method) for method in ("dverk", "auto")}
    rows = {method: simulate_block(campaign, 0, runs, 1) for method, campaign in campaigns.items()}
    first = rows["auto"]
    tasks = {"spins": [first[f"initial.angular_velocity_body[{i}]"].tolist() for i in range(3)]}
    tasks["inertias"] = _inertias(campaigns["auto"], runs)

    def simulated(step: float, noise: float = 1.0, end: float = END) -> Any:
        asked = json.dumps({**tasks, "step": step, "noise": noise, "end": end})
        command = [python, __file__, "basilisk_satellite"]
        answer = subprocess.run(command, input=asked, capture_output=True, text=True, check=True)
        return json.loads(answer.stdout.splitlines()[-1])

    ratios: dict[str, list[tuple[float, float]]] = {method: [] for method in campaigns}
    for _ in range(REPEATS):
        peer = simulated(PEER_STEP)
        theirs = min(peer["times"])
        print(f"Basilisk             {theirs * 1e3:9.3f} ms a run ({peer['version']})", flush=True)
        for method, campaign in campaigns.items():
            taken = ours(campaign)
            ratios[method].append((theirs / taken, taken))
            print(f"rb_dynamics, {method:<6}  {taken * 1e3:9.3f} ms a run, ratio {theirs / taken:6.1f}", flush=True)
    for method, each in ratios.items():
        ratio, taken = sorted(each)[len(each) // 2]
        print(f"median, {method:<6}       {taken * 1e3:9.3f} ms a run, ratio {ratio:6.1f}")
    fine = simulated(0.005, 0.0, 30.0)["final_rates"]
    for step in (PEER_STEP, SAMPLE):
        rates = simulated(step, 0.0, 30.0)["final_rates"]
        off, taken = max(abs(a - b) for a, b in zip(rates, fine, strict=True)), min(simulated(step)["times"])
        error = f"rates after 30 s off by at most {off:.1e} rad/s"
        print(f"Basilisk, steps of {step:g} s {taken * 1e3:9.3f} ms a run; {error}")
    where_it_goes(lambda: ours(campaigns["dverk"]), ours(found("dverk", 0.5)))
    for method, row in rows.items():
        print(f"{method:<12} median of the final rates {sorted(row['final_rate'].tolist())[runs // 2]:.2e} rad/s")
    print(f"Basilisk     median of the final rates {sorted(peer['final_rates'])[runs // 2]:.2e} rad/s (other noise)")


def where_it_goes(whole: Callable[[], float], start: float) -> None:
    """Print the shares of scene and start, of compiled kernels by the number of their arguments, and of the rest."""
    from rb_dynamics.numerics.object_code import Native

    spent, call = dict[int, float](), Native.__call__
    names = {14: "motion", 6: "sensors", 4: "what sensors sense"}

    def timed(kernel: Any, *arguments: Any) -> Any:
        begin = time.process_time()
        found = call(kernel, *arguments)
        spent[1 + len(arguments)] = spent.get(1 + len(arguments), 0.0) + time.process_time() - begin
        return found

    Native.__call__ = timed  # type: ignore[method-assign]
    try:
        taken = whole()
    finally:
        Native.__call__ = call  # type: ignore[method-assign]
    from rb_dynamics.study.campaign.engine import SIDE_BY_SIDE

    shares = {f"kernel of {names.get(n, n)}": used / SIDE_BY_SIDE for n, used in spent.items()}
    shares["scene and start"] = start
    shares["law and loop"] = taken - sum(shares.values())
    for name, share in shares.items():
        print(f"  {name:<30} {share * 1e6:7.0f} us a run, {share / taken:4.0%}")


def under_effects(runs: int) -> None:
    from rb_dynamics.study.campaign.block_of_runs import simulate_block
    from rb_dynamics.study.campaign.read import read_campaign

    with tempfile.TemporaryDirectory() as folder:
        found = campaign(folder, END, 2000)
        simulate_block(found, 0, runs, 1)
        without = seconds(lambda: simulate_block(found, 0, runs, 1)) / runs
        print(f"no effect        {without * 1e3:9.3f} ms a run", flush=True)
        for effect in ("uniform_gravity, acceleration_world: [0, 0, -9.81]", "linear_drag, rotation: 1.0e-4"):
            Path(folder, "scene.yaml").write_text(f"{SCENE}\neffects:\n  - {{type: {effect}}}\n")
            found = read_campaign(Path(folder, "campaign.yaml"))
            simulate_block(found, 0, runs, 1)
            under = seconds(lambda found=found: simulate_block(found, 0, runs, 1)) / runs
            kind = effect.partition(",")[0]
            print(f"{kind:<16} {under * 1e3:9.3f} ms a run, {under / without:.1f} times as long", flush=True)


def by_accuracy(path: Path, runs: int) -> None:
    from rb_dynamics.study.campaign.block_of_runs import simulate_alone, simulate_block
    from rb_dynamics.study.campaign.read import read_campaign

    found, few, ratios = read_campaign(path, {"runs": runs}), min(runs, 20), []
    for _ in range(2):
        simulate_block(found, 0, runs, 1)
    for _ in range(5):
        block = seconds(lambda: simulate_block(found, 0, runs, 1), 1) / runs
        alone = seconds(lambda: [simulate_alone(found, run) for run in range(few)], 1) / few
        ratios.append((alone / block, block, alone, making(found, runs)))
    ratio, block, alone, made = sorted(ratios)[2]
    print(f"in a block  {block * 1e3:9.3f} ms a run, {1.0 / block:8.0f} runs a second on one core")
    print(f"  of which  {made * 1e3:9.3f} ms to make and check its scene")
    print(f"alone       {alone * 1e3:9.3f} ms a run, {ratio:.1f} times as long")


def devices(runs: int) -> None:
    wheels = SATELLITE[SATELLITE.index("  - {type: reaction_wheel") : SATELLITE.index("sensors:")]
    bare = SATELLITE.replace(wheels, "ACTUATORS").replace("initial:", _FRAMES + "initial:", 1)
    begin, end = bare.index("sensors:"), bare.index("solver:")
    bare = bare[:begin] + _SENSES + bare[end:]
    bare = bare.replace(
        f"body: {{mass: 10.0, inertia: {{diagonal: {list(SATELLITE_MOMENTS)}}}}}",
        f"body:\n  mass: 10.0\n  inertia: {{diagonal: {list(SATELLITE_MOMENTS)}}}",
    )
    for row, law, actuators in (
        ("three wheels", "with_wheels", wheels),
        ("three wheels by a law that reads the accelerometer", "with_forces", wheels),
        ("three wheels and six thrusters", "with_both", wheels + _THRUSTERS),
        ("six thrusters", "with_thrusters", _THRUSTERS),
    ):
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "devices_law.py").write_text(DEVICES_LAW)
            Path(folder, "scene.yaml").write_text(bare.replace("ACTUATORS", actuators).replace("METHOD", "dop853"))
            path = Path(folder, "campaign.yaml")
            path.write_text(DEVICES.replace("LAW", law).replace("METHOD", "dop853"))
            print(row)
            by_accuracy(path, runs)


def _inertias(found: Any, runs: int) -> list[Any]:
    from rb_dynamics.study.campaign.sampling import inputs
    from rb_dynamics.study.campaign.scenes import Scenes

    scenes, names = Scenes(found), [each.name for each in found.inputs]
    return [scenes.scene(dict(zip(names, row, strict=True))).body.inertia for row in inputs(found, 0, runs).tolist()]


def basilisk(tasks: Any) -> Any:
    """Simulate the runs with Basilisk: navigation, guidance, a D law and an external torque, all compiled."""
    import Basilisk
    from Basilisk.architecture import bskLogging, messaging
    from Basilisk.fswAlgorithms import attTrackingError, inertial3D, mrpPD
    from Basilisk.simulation import extForceTorque, simpleNav, spacecraft
    from Basilisk.utilities import SimulationBaseClass, macros

    bskLogging.setDefaultLogLevel(bskLogging.BSK_ERROR)

    def fly(spin: list[float], inertia: list[list[float]]) -> float:
        simulation = SimulationBaseClass.SimBaseClass()
        process = simulation.CreateNewProcess("process")
        # The flight software runs first, so that a sample takes effect at once.
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


def basilisk_satellite(tasks: Any) -> Any:
    """Simulate the satellites with Basilisk, all modules compiled: navigation with noise, a PD law, wheels."""
    import Basilisk
    import numpy as np
    from Basilisk.architecture import bskLogging, messaging
    from Basilisk.fswAlgorithms import attTrackingError, inertial3D, mrpPD, rwMotorTorque
    from Basilisk.simulation import (
        GravityGradientEffector,
        reactionWheelStateEffector,
        simpleNav,
        spacecraft,
        svIntegrators,
    )
    from Basilisk.utilities import SimulationBaseClass, macros, simIncludeGravBody, simIncludeRW

    bskLogging.setDefaultLogLevel(bskLogging.BSK_ERROR)

    def fly(spin: list[float], inertia: list[list[float]], seed: int) -> float:
        simulation = SimulationBaseClass.SimBaseClass()
        process = simulation.CreateNewProcess("process")
        process.addTask(simulation.CreateNewTask("control", macros.sec2nano(SAMPLE)), 10)
        process.addTask(simulation.CreateNewTask("motion", macros.sec2nano(tasks["step"])), 1)
        craft = spacecraft.Spacecraft()
        craft.hub.mHub, craft.hub.IHubPntBc_B = 10.0, inertia
        craft.hub.omega_BN_BInit = [[c] for c in spin]
        craft.hub.r_CN_NInit, craft.hub.v_CN_NInit = [[ORBIT[0]], [0.0], [0.0]], [[0.0], [0.0], [ORBIT[1]]]
        craft.setIntegrator(svIntegrators.svIntegratorRK4(craft))
        bodies = simIncludeGravBody.gravBodyFactory()
        earth = bodies.createEarth()
        earth.isCentralBody = True
        bodies.addBodiesTo(craft)
        gradient = GravityGradientEffector.GravityGradientEffector()
        gradient.addPlanetName(earth.planetName)
        craft.addDynamicEffector(gradient)
        wheels, effector = simIncludeRW.rwFactory(), reactionWheelStateEffector.ReactionWheelStateEffector()
        wear = {"useRWfriction": True, "fCoulomb": COULOMB, "fStatic": COULOMB, "cViscous": VISCOUS, "betaStatic": 1e-3}
        for k in range(3):
            axis = [float(k == i) for i in range(3)]
            wheels.create("custom", axis, Js=WHEEL, Omega_max=FASTEST * 30.0 / math.pi, u_max=MOST_TORQUE, **wear)
        wheels.addToSpacecraft("wheels", effector, craft)
        sense, guide = simpleNav.SimpleNav(), inertial3D.inertial3D()
        deviations = np.zeros(18)
        # Its errors walk within bounds. Attitude in MRP, a quarter of an angle.
        deviations[6:9], deviations[9:12] = TRACKER_NOISE / 4.0, GYRO_NOISE * math.sqrt(2.0)
        deviations *= tasks["noise"]
        sense.PMatrix, sense.walkBounds = np.diag(deviations).tolist(), (2.0 * deviations)[:, None].tolist()
        sense.RNGSeed = seed
        sense.crossAtt = sense.crossTrans = False
        error, law, share = attTrackingError.attTrackingError(), mrpPD.mrpPD(), rwMotorTorque.rwMotorTorque()
        law.K, law.P = 4.0 * STIFFNESS, DAMPING
        share.controlAxes_B = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
        configuration = messaging.VehicleConfigMsgPayload(ISCPntB_B=[x for row in inertia for x in row])
        vehicle, parameters = messaging.VehicleConfigMsg().write(configuration), wheels.getConfigMessage()
        sense.scStateInMsg.subscribeTo(craft.scStateOutMsg)
        error.attNavInMsg.subscribeTo(sense.attOutMsg)
        error.attRefInMsg.subscribeTo(guide.attRefOutMsg)
        law.guidInMsg.subscribeTo(error.attGuidOutMsg)
        law.vehConfigInMsg.subscribeTo(vehicle)
        share.vehControlInMsg.subscribeTo(law.cmdTorqueOutMsg)
        share.rwParamsInMsg.subscribeTo(parameters)
        effector.rwMotorCmdInMsg.subscribeTo(share.rwMotorTorqueOutMsg)
        for module in (sense, guide, error, law, share):
            simulation.AddModelToTask("control", module)
        # The wheels hear their commands before the step that they act in.
        for module in (effector, gradient, craft):
            simulation.AddModelToTask("motion", module)
        simulation.InitializeSimulation()
        simulation.ConfigureStopTime(macros.sec2nano(tasks["end"]))
        simulation.ExecuteSimulation()
        return math.hypot(*(c[0] for c in craft.dynManager.getStateObject("hubOmega").getState()))

    spins = list(zip(*tasks["spins"], strict=True))
    times, rates = [], []
    fly(list(spins[0]), tasks["inertias"][0], 1)
    for _ in range(REPEATS):
        begin = time.process_time()
        rates = [
            fly(list(spin), inertia, 1 + k)
            for k, (spin, inertia) in enumerate(zip(spins, tasks["inertias"], strict=True))
        ]
        times.append((time.process_time() - begin) / len(spins))
    return {"times": times, "final_rates": rates, "version": f"Basilisk {Basilisk.__version__}"}


PEERS = {"basilisk": basilisk, "basilisk_satellite": basilisk_satellite}
"""What runs in the interpreter of Basilisk."""


def memory() -> None:
    from rb_dynamics.study.campaign.block_of_runs import simulate_block
    from rb_dynamics.study.campaign.read import read_campaign

    found = read_campaign(DETUMBLE)
    simulate_block(found, 0, 20, 1)
    for runs in (250, 1000, 2000, 4000):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        simulate_block(found, 0, runs, 1)
        after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        print(
            f"{runs:6d} runs in a block: peak {after / 1024:7.1f} MiB, {(after - before) / 1024:6.1f} more than before"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "what",
        choices=(
            "runs",
            "workers",
            "limits",
            "peer",
            "effects",
            "accuracy",
            "memory",
            "satellite",
            "spacecraft",
            "devices",
            *PEERS,
        ),
    )
    parser.add_argument("count", nargs="?", type=int)
    parser.add_argument("--basilisk", default=sys.executable, metavar="PYTHON")
    args = parser.parse_args()
    if args.what == "runs":
        by_runs(args.count or 100_000)
    elif args.what == "workers":
        by_workers(args.count or 10_000)
    elif args.what == "limits":
        limits(args.count or 200)
    elif args.what == "peer":
        beside(args.count or 20, args.basilisk)
    elif args.what == "effects":
        under_effects(args.count or 500)
    elif args.what == "accuracy":
        by_accuracy(CAPTURE, args.count or 200)
    elif args.what == "spacecraft":
        by_accuracy(SPACECRAFT, args.count or 400)
    elif args.what == "devices":
        devices(args.count or 400)
    elif args.what == "satellite":
        satellite(args.count or 100, args.basilisk)
    elif args.what == "memory":
        memory()
    else:
        print(json.dumps(PEERS[args.what](json.load(sys.stdin))))


if __name__ == "__main__":
    main()
