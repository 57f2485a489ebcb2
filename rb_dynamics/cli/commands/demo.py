"""Simulate recorded wrench commands with the real node and compare with the recorded motion.

A second process publishes the 1200 recorded commands over DDS to the node in lockstep, and receives pose and twist.
They are compared with the recording at all of its stamps, and bit for bit with the same run offline. Writes demo.mcap,
demo.rrd, demo.html, and flip.rrd with a free body that flips.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from rb_dynamics.cli.parser import require_ros

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from rb_dynamics.analysis.recording_differences import Difference
    from rb_dynamics.loads.wrench import Wrench
    from rb_dynamics.report.html import Section
    from rb_dynamics.ros.command_player import WrenchPlayer
    from rb_dynamics.scene.model import Scene

HELP = "simulate recorded wrench commands with the real node and compare"

TOLERANCE = 1e-10


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `demo`."""
    parser.add_argument("--out", default="out", metavar="DIR", help="folder for the files (default: out)")


def run(args: argparse.Namespace) -> int:
    """Run, compare, report; exit code 0 if the motion agrees with the recording, 1 if not."""
    import os
    import shutil
    import sys
    from pathlib import Path

    from rb_dynamics.cli import output
    from rb_dynamics.formats.output_file import make_folder
    from rb_dynamics.logs.wrench_bags import read_wrenches
    from rb_dynamics.report.run_page import write_run_report
    from rb_dynamics.run.simulate import simulate
    from rb_dynamics.scene import read_scene
    from rb_dynamics.scene.shipped import shipped
    from rb_dynamics.sinks.rerun_sink import RerunSink

    require_ros("the demo")
    scene_file, bag_file = shipped("config/slew.yaml"), shipped("examples/slew.mcap")
    scene = read_scene(scene_file)
    commands = read_wrenches(bag_file, [channel.topic for channel in scene.channels])
    out = Path(args.out)
    mcap, rrd = out / "demo.mcap", out / "demo.rrd"
    make_folder(mcap)
    for earlier in (mcap, rrd):
        earlier.unlink(missing_ok=True)
    print(
        f"simulating {bag_file.name} ({len(commands)} wrench commands) with the node in lockstep, over DDS", flush=True
    )
    with output.progress("demo") as progress:
        player = _fly(scene, scene_file, commands, mcap, rrd, progress)
    found = _differences(bag_file, player)
    stamps, within = len(found["attitude"].size), all(each.max <= TOLERANCE for each in found.values())
    print("\n".join(_table(found)))
    print(f"{stamps} stamps compared with the recording: {'' if within else 'NOT '}all within {TOLERANCE:g}")
    same = _same_bits_offline(scene, commands, mcap)
    print(f"the same commands offline, without ROS: {'the same bits' if same else 'DIFFERENT bits'}")
    write_run_report(mcap, out / "demo.html", extra=[_section(found)])
    flip = out / "flip.rrd"
    simulate(read_scene(shipped("config/dzhanibekov.yaml")), sinks=[RerunSink(flip)])
    viewer = "rerun" if shutil.which("rerun") else os.path.relpath(Path(sys.executable).with_name("rerun"))
    for name, what in (
        ("demo.mcap", "the log: ros2 bag play, Foxglove, PlotJuggler, rb-dynamics inspect"),
        ("demo.rrd", f"the scene: {viewer} {rrd}"),
        ("demo.html", "the comparison: open in a browser"),
        ("flip.rrd", f"a free body that flips, and why: {viewer} {flip}"),
    ):
        print(f"{out / name!s:20} {what}")
    return 0 if same and within else 1


def _fly(
    scene: Scene,
    scene_file: Path,
    commands: list[tuple[str, Wrench]],
    mcap: Path,
    rrd: Path,
    progress: Callable[[float], None] | None,
) -> WrenchPlayer:
    """Run the node in a process of its own and send the commands to it."""
    import os
    import random
    import subprocess
    import sys

    from rb_dynamics.errors import RigidBodyError

    # This machine and a separate domain only: the demo must not interact with other nodes.
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", str(random.randrange(1, 100)))
    from rb_dynamics.ros.command_player import wrench_player
    from rb_dynamics.ros.start_arguments import parameter

    parameters = ("lockstep:=true", parameter("mcap", str(mcap)), parameter("rerun", str(rrd)))
    node = subprocess.Popen(
        [sys.executable, "-m", "rb_dynamics", "node", str(scene_file), "--ros-args"]
        + [part for value in parameters for part in ("-p", value)]
    )
    try:
        with wrench_player([channel.topic for channel in scene.channels]) as player:
            player.play(commands, scene.end_ns or 0, progress)
            if code := node.wait(timeout=60):
                raise RigidBodyError(f"the node ended with exit code {code}; see its message above")
            return player
    finally:
        if node.poll() is None:
            node.terminate()
            node.wait(timeout=10)


def _differences(bag_file: Path, player: WrenchPlayer) -> dict[str, Difference]:
    """Return the differences of what was received from the recording, at all of its stamps but the common start.

    Raises:
        LogError: nothing was received at one of them.
    """
    import numpy as np

    from rb_dynamics.analysis.interpolated_signal import MotionSignals, Signal
    from rb_dynamics.analysis.read_track import read_track
    from rb_dynamics.analysis.recording_differences import differences_of_motion
    from rb_dynamics.errors import LogError
    from rb_dynamics.logs.bag_reader import read_bag

    recorded = MotionSignals.of(read_track(read_bag(bag_file)))
    (position, attitude), (velocity, rate) = (
        [
            Signal.of(np.array(sorted(told), dtype=np.int64), np.array([told[at][part] for at in sorted(told)]))
            for part in (0, 1)
        ]
        for told in (player.poses, player.twists)
    )
    received = MotionSignals(attitude, position, rate, velocity_body=velocity)
    begin_ns, end_ns = recorded.span_ns
    compared = recorded.within(begin_ns + 1, end_ns)
    found = differences_of_motion(compared, received)
    stamps = 0 if compared.attitude is None else len(compared.attitude.time_ns)
    if not found or any(each.interpolated or len(each.size) != stamps for each in found.values()):
        raise LogError(
            f"found {len(player.poses)} poses and {len(player.twists)} twists, expected one at each stamp of "
            f"{bag_file.name}; set an output_rate that meets its stamps"
        )
    return found


def _table(found: dict[str, Difference]) -> list[str]:
    """Return the largest differences, by parts of the time and of all."""
    from rb_dynamics.report.comparison_text import growth_lines

    times = found["attitude"].time_ns
    worst = f"{'largest':>14}" + "".join(f"{each.max:26.3g}" for each in found.values())
    return [*growth_lines(found, (int(times[0]), int(times[-1])), 0), worst]


def _section(found: dict[str, Difference]) -> Section:
    """Return the comparison as a section of the report."""
    from rb_dynamics.analysis.recording_differences import UNITS
    from rb_dynamics.report.run_page import comparison_section

    times = found["attitude"].time_ns
    return comparison_section(
        times / 1e9,
        {f"{name.replace('_', ' ')} ({UNITS[name]})": each.size for name, each in found.items()},
        "Comparison with the recording",
        f"Pose and twist received over DDS, compared with the recording at {len(times)} stamps.",
    )


def _same_bits_offline(scene: Scene, commands: list[tuple[str, Wrench]], mcap: Path) -> bool:
    """Return whether `simulate` with the same commands gives the states that the node logged, to the bit."""
    from rb_dynamics.logs.bag_reader import read_bag
    from rb_dynamics.run.simulate import simulate
    from rb_dynamics.sinks.state_hash import HashSink

    states = HashSink()
    simulate(scene, commands, [states])
    return read_bag(mcap).metadata["rb_dynamics.result"]["states_sha256"] == states.hexdigest()
