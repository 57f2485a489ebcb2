"""Measure whole commands, `rb-dynamics simulate SCENE --wrench BAG` with logs, and `replay`: docs/whole-runs.md.

    python benchmarks/whole_runs.py            # `make bench` runs it too; writes the page
    python benchmarks/whole_runs.py --quick    # a hundredth of the commands, once, and nothing is written

The commands are those of the problem "driven" of `compare.py`: force and torque in body axes on one topic, a force in
world axes on another, each 10 000 times in 100 s. Times are processor time of processes, start of Python and imports
included, run in turn (A B C A B C); medians. Beside them is what heyoka and MuJoCo take for the integration alone,
where they are installed. Then come an hour of commands, with its memory, and the rates at which logs are written.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from statistics import median

import numpy as np
from compare import ladder, started
from peers.problem import Problem, problem
from peers.reference import reference
from written import processor, table, wrapped

from rb_dynamics import read_scene, simulate
from rb_dynamics.formats import cdr
from rb_dynamics.formats.channel_metadata import log_channel, qos_profile
from rb_dynamics.formats.mcap_writer import McapWriter
from rb_dynamics.formats.message_types import WRENCH
from rb_dynamics.formats.output_file import OutputFile
from rb_dynamics.logs.messages import SAMPLE_TOPICS
from rb_dynamics.numerics.compilation import available
from rb_dynamics.run.event_arrays import EventArrays
from rb_dynamics.run.sink import Event, RunInfo, Sink
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.sinks.rerun_sink import RerunSink

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "whole-runs.md"
TURNS = 7
HOUR, PART = 3600, 360
SAMPLES = 100_000
ROWS = 19
"""Of one output in Rerun, each an entity at a time."""
PLAIN = "simulate SCENE --wrench BAG"
FLOOR = "`simulate` of a coast, one output: what the start takes"
IMPORTS = "imports alone: numpy, llvmlite, simulation, reading of bags"
LOGGED, SHOWN, REPLAYED = "the same, `--mcap`", "the same, `--mcap` and `--rerun`", "`replay` of the log"
COMMANDS = {
    FLOOR: ["simulate", "coast.yaml"],
    IMPORTS: ["-c", "import numpy, llvmlite.binding, rb_dynamics.run.simulate, rb_dynamics.logs.wrench_bags"],
    PLAIN: ["simulate", "scene.yaml", "--wrench", "bag.mcap"],
    LOGGED: ["simulate", "scene.yaml", "--wrench", "bag.mcap", "--mcap", "run.mcap"],
    SHOWN: [
        *("simulate", "scene.yaml", "--wrench", "bag.mcap", "--mcap", "run.mcap", "--rerun", "run.rrd"),
    ],
    REPLAYED: ["replay", "run.mcap"],
}


LIMITS = (
    "What limits them: the start of Python and imports take most of the time of a command. Of the imports numpy takes "
    "14 %, llvmlite 12 %, PyYAML 5 %, and 160 modules of this package 44 %, of which a third goes to dataclasses: "
    "Python compiles their methods as it defines them. Without imports, in one process, `simulate` takes as long as "
    "heyoka: half of it is the kernel, one step of order 6 with its error estimate between two commands, a fifth "
    "taking commands in and checking them, and a seventh putting commands, knots and outputs in order. An hour of "
    "commands is limited by what a command costs to read, hash and log. Of what an MCAP log takes without the motion, "
    "two fifths are compression (zstd), and a twelfth checksums; of what Rerun takes, about half is spent in its own "
    "library.\n\nTimes on a machine that others share vary: of seven measurements of these rates within 75 minutes, "
    "MCAP had 1.2 to 2.2 million messages/s and Rerun 1.9 to 2.7 million rows/s.\n"
)


def write_inputs(task: Problem, folder: Path, rate: int = 100, topics: tuple[str, ...] = ("thrusters", "wind")) -> None:
    """Write a problem as a scene and a bag; without the topic `wind`, no force in world axes acts."""
    (folder / "scene.yaml").write_text(
        f"body: {{mass: {task.mass}, inertia: {{matrix: {task.inertia.tolist()}}}}}\n"
        f"initial: {{linear_velocity_world: {list(task.linear_velocity_world)}, "
        f"angular_velocity_body: {task.angular_velocities[0].tolist()}}}\n"
        f"wrenches: [{', '.join(f'{{topic: {name}}}' for name in topics)}]\n"
        f"solver: {{method: auto, accuracy: {task.wanted!r}}}\nduration: {task.duration!r}\noutput_rate: {rate}\n"
    )
    (folder / "coast.yaml").write_text("body: {mass: 2.0, inertia: {diagonal: [1, 2, 3]}}\nduration: 1.0\n")
    file = OutputFile(folder / "bag.mcap")
    writer = McapWriter(file, "benchmark")
    writer.begin()
    channels = [log_channel(f"/{name}", WRENCH, qos_profile(10)) for name in topics]
    ids = [writer.add_channel(channel) for channel in channels]
    for k in range(task.holds):
        time_ns = round(k * task.hold * 1e9)
        in_body = cdr.encode(WRENCH, time_ns, "body", (*task.force_body[k], *task.torque_body[k]))
        in_world = cdr.encode(WRENCH, time_ns, "world", (*task.force_world[k], 0.0, 0.0, 0.0))
        writer.add_messages(ids, (in_body, in_world)[: len(ids)], time_ns, time_ns)
    writer.finish()
    file.close()


def spent(arguments: list[str], folder: Path, **environment: str) -> float:
    """Return the processor time (s) of the command line, in a process of its own."""
    return used(arguments, folder, **environment)[0]


def used(arguments: list[str], folder: Path, **environment: str) -> tuple[float, float]:
    """Return processor time (s) and peak memory (MB) of the command line, in a process of its own."""
    command = [sys.executable, *([] if arguments[0] == "-c" else ["-m", "rb_dynamics"]), *arguments]
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    around = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "", **environment}
    with subprocess.Popen(command, cwd=folder, env=around, stdout=subprocess.DEVNULL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1000.0


def measured(folder: Path, turns: int) -> dict[str, list[float]]:
    """Return what each command takes, turn by turn, with compiled kernels; and one run in plain Python."""
    if available():
        spent(["compile"], folder)
    found: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in range(turns):
        for name, arguments in COMMANDS.items():
            found[name].append(spent(arguments, folder))
    found["the same in plain Python"] = [spent(COMMANDS[PLAIN], folder, RB_DYNAMICS_COMPILE="never")]
    # At last: it leaves a process behind that compiles.
    with tempfile.TemporaryDirectory() as fresh:
        found["the same, the first run ever"] = [spent(COMMANDS[PLAIN], folder, XDG_CACHE_HOME=fresh)]
    return found


def long_runs(task: Problem, folder: Path) -> list[tuple[str, str, str, str]]:
    """Return the rows of commands at 100 Hz with a log: simulated time, time taken, ratio to real time, memory."""
    found = []
    for seconds in (PART, HOUR):
        of_times = np.arange(100 * seconds) % task.holds
        wrenches = {name: getattr(task, name)[of_times] for name in ("force_body", "torque_body", "force_world")}
        for rate in (1, 100):
            write_inputs(replace(task, duration=float(seconds), wanted=1e-6, **wrenches), folder, rate, ("thrusters",))
            taken, memory = used(COMMANDS[LOGGED], folder)
            cells = f"{taken:.2f} s", f"{seconds / taken:,.0f}", f"{memory:.0f} MB"
            found.append((f"{seconds} s, {rate} output{'s' * (rate != 1)} a second", *cells))
    return found


class Dropped:
    """A sink that takes blocks and does nothing with them."""

    def open(self, run: RunInfo) -> None:
        """Prepare nothing."""

    def write(self, event: Event) -> None:
        """Drop an event."""

    def write_block(self, block: EventArrays) -> None:
        """Drop a block."""

    def close(self, result: Mapping[str, str]) -> None:
        """Release nothing."""


def log_rates(folder: Path) -> list[tuple[str, str, str]]:
    """Return log, time of an output with it, and messages or rows a second from the blocks of the engine on."""
    arguments = ["simulate", str(ROOT / "config" / "dzhanibekov.yaml"), "--set", f"output_rate={SAMPLES / 100}"]
    logs = {"MCAP": ["--mcap", "run.mcap"], "Rerun": ["--rerun", "run.rrd"]}
    few = [*arguments[:-1], "output_rate=1"]
    scene = read_scene(arguments[1], {"output_rate": SAMPLES / 100})
    sinks: dict[str, Callable[[], Sink]] = {
        "": Dropped,
        "MCAP": lambda: McapSink(folder / "run.mcap"),
        "Rerun": lambda: RerunSink(folder / "run.rrd"),
    }
    taken: dict[str, list[float]] = {name: [] for name in logs}
    inside: dict[str, list[float]] = {name: [] for name in sinks}
    for _ in range(TURNS):
        for name, log in logs.items():
            taken[name].append(spent([*arguments, *log], folder) - spent([*few, *log], folder))
        for name, sink in sinks.items():
            begin = time.process_time()
            simulate(scene, sinks=[sink()])
            inside[name].append(time.process_time() - begin)
    parts = {"MCAP": (len(SAMPLE_TOPICS), "messages"), "Rerun": (ROWS, "rows")}
    each = {name: median(times) / SAMPLES for name, times in taken.items()}
    alone = {name: median(inside[name]) - median(inside[""]) for name in logs}
    return [
        (name, f"{1e6 * each[name]:.1f} us", f"{count * SAMPLES / alone[name]:,.0f} {unit}/s")
        for name, (count, unit) in parts.items()
    ]


def peers(task: Problem) -> dict[str, float]:
    """Return the time (s) of the integration alone, by those that are installed."""
    workers, _ = started(("heyoka", "mujoco"), print)
    expected, found = reference(task) if workers else None, {}
    for worker in workers:
        rows = [ladder(worker, task, way, expected) for way in worker.ways(task)]
        best = min((row for row in rows if row.chosen), key=lambda row: row.chosen.seconds, default=None)
        if best is not None:
            found[best.name] = best.chosen.seconds
        worker.close()
    return found


def rows(found: dict[str, list[float]]) -> list[tuple[str, str, str]]:
    """Return the rows of the table: command, processor time, ratio to the plain command."""
    plain, lines = found[PLAIN], []
    for name, mine in found.items():
        ratio = median(a / b for a, b in zip(mine, plain if len(mine) == len(plain) else [median(plain)], strict=True))
        lines.append((f"`{name}`" if name == PLAIN else name, f"{median(mine):.2f} s", f"{ratio:.1f}"))
    return lines


def goals(
    found: dict[str, list[float]],
    others: dict[str, float],
    long: list[tuple[str, str, str, str]],
    logs: list[tuple[str, str, str]],
) -> list[tuple[str, str, str, str]]:
    """Return the rows of the goals: what is measured, its goal, its value, and whether that is met."""
    plain, logged = median(found[PLAIN]), median(found[LOGGED])
    wanted = [
        ("time with `--mcap` over that without a log", "<= 4", logged / plain),
        ("time with `--mcap` and `--rerun` over that without a log", "<= 8", median(found[SHOWN]) / plain),
        ("time of `replay` over that of the run that made the log", "<= 2", median(found[REPLAYED]) / logged),
    ]
    if "heyoka" in others:
        wanted.insert(0, (f"time of `{PLAIN}` over heyoka's integration alone", "<= 1", plain / others["heyoka"]))
    wanted += [
        (f"times real time, {row[0]}", ">= 3,000", _number(row[2])) for row in long if row[0].startswith(f"{HOUR}")
    ]
    for (name, _, rate), goal in zip(logs, (">= 1,500,000", ">= 5,000,000"), strict=True):
        wanted.append((f"{name}, {rate.split()[1]}", goal, _number(rate.split()[0])))
    return [
        (name, goal, f"{value:,.1f}" if value < 100 else f"{value:,.0f}", "met" if _met(value, goal) else "**missed**")
        for name, goal, value in wanted
    ]


def _met(value: float, goal: str) -> bool:
    sign, limit = goal.split()
    return value <= _number(limit) if sign == "<=" else value >= _number(limit)


def _number(text: str) -> float:
    return float(text.replace(",", ""))


def page(
    found: dict[str, list[float]],
    others: dict[str, float],
    long: list[tuple[str, str, str, str]],
    logs: list[tuple[str, str, str]],
) -> str:
    """Return the page."""
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in ("numpy", "numba") if _is_there(name))
    text = (
        "# What a whole run costs\n\n"
        "Written by `python benchmarks/whole_runs.py` (`make bench`) on "
        f"Python {platform.python_version()}, {processor()}, {versions}.\n\n"
        "A bag has ten thousand pairs of held wrenches in 100 s. They are simulated with 100 outputs a second and an "
        "attitude accurate to 1e-9 rad. Times are processor times of the whole process: start of Python, imports, "
        f"scene, bag, motion and logs; medians of {len(found[PLAIN])} turns, except the last two rows: one run each. "
        "The kernels were compiled beforehand (`rb-dynamics compile`). Only the first run ever has none: it runs in "
        "plain Python while another process compiles.\n\n"
    )
    text += table(["command", "processor time", "ratio"], rows(found))
    if others:
        listed = ", ".join(f"{name} {1e3 * seconds:.0f} ms" for name, seconds in others.items())
        text += f"\nOther programs, for the integration alone, without scene, bag and outputs: {listed}.\n"
    imports = median(found[IMPORTS])
    text += (
        f"\nImports take {imports:.2f} s, {100 * imports / median(found[PLAIN]):.0f} % of the run. In one process, "
        "with commands as arrays, `simulate` takes what [benchmarks](benchmarks.md) show.\n"
    )
    text += (
        "\n## An hour of commands\n\nThe same forces and torques in body axes again and again, 100 a second, to 1e-6 "
        "rad: `simulate SCENE --wrench BAG --mcap LOG`, one run each. Memory is the peak of the process.\n\n"
    )
    text += table(["simulated", "processor time", "times real time", "memory"], long)
    few, many = (1e6 * float(row[1].split()[0]) / (100 * HOUR) for row in long[2:])
    text += (
        f"\nA command takes {few:.1f} us in all: it is read twice (to find out about the bag, and for the run), moved "
        f"by, hashed, logged as received and as it acts. An output takes {many - few:.1f} us more.\n"
    )
    text += (
        f"\n## Logs\n\n`config/dzhanibekov.yaml` with {SAMPLES:,} outputs: processor time of each in the whole "
        "command, motion included, and the rate of the log alone: in one process, beyond a run whose sink takes the "
        "same blocks and drops them.\n\n"
    )
    text += table(["log", "an output", "rate"], logs)
    text += (
        "\n## Goals\n\n"
        + table(["what", "goal", "measured", "result"], goals(found, others, long, logs))
        + "\n"
        + LIMITS
    )
    return wrapped(text)


def _is_there(name: str) -> bool:
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:
        return False
    return True


def main(arguments: list[str]) -> None:
    quick = "--quick" in arguments
    task = problem("driven")
    if quick:
        few = {name: getattr(task, name)[:100] for name in ("force_body", "torque_body", "force_world")}
        task = replace(task, duration=1.0, **few)
    with tempfile.TemporaryDirectory() as name:
        write_inputs(task, Path(name))
        found = measured(Path(name), 1 if quick else TURNS)
        if quick:
            print(table(["command", "processor time", "ratio"], rows(found)))
            return
        text = page(found, peers(task), long_runs(task, Path(name)), log_rates(Path(name)))
    print(text)
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
