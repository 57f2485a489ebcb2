"""Launches several independent bodies, each in a namespace, with its own frame and logs: N of a scene, or of a file.

Every argument of rigid_body.launch.py holds for all of them; a namespace is put before theirs. With publish_clock the
first publishes /clock, and the others follow it.
"""

import json
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

from rb_dynamics.ros.start_arguments import (
    apart,
    bodies_in,
    is_bodies,
    side_by_side,
    spacing_of,
    value_of,
    values_of,
)

ARGUMENTS = (
    ("scene", None, "scene file, or file of bodies: {bodies: {NAME: {scene: FILE, ...}, ...}} (YAML)"),
    ("count", "2", "how many bodies of a scene"),
    ("prefix", "body_", "the namespaces are prefix1, prefix2, ..."),
    ("spacing", "1.0", "m from one body to the next, along y of the world or as in [1.0, 0.0, 0.5]"),
)
# Set individually for each body.
LOGS = ("mcap", "bag", "rerun")
RIGID_BODY = Path(__file__).with_name("rigid_body.launch.py")
# Of every body but the first, where that publishes the clock.
FOLLOWING = {"publish_clock": "false", "use_sim_time": "true", "real_time_factor": "1.0"}


def body_arguments(name: str, overrides: dict[str, object], given: dict[str, str]) -> dict[str, str]:
    """Return the individual arguments of rigid_body.launch.py for the body `name`."""
    own = {
        "namespace": f"{given.get('namespace', '')}/{name}",
        "scene": str(overrides.pop("scene", given["scene"])),
        # JSON is YAML with all strings quoted, so that types are kept.
        "overrides": json.dumps({"body.frame": name} | overrides, ensure_ascii=False),
    }
    return own | {log: str(apart(given[log], name)) for log in LOGS if given.get(log)}


def all_overrides(given: dict[str, str]) -> dict[str, dict[str, object]]:
    """Return the overrides of each body by name: its own go before those for all."""
    shared = values_of("overrides", given.get("overrides", ""))
    if is_bodies(given["scene"]):
        bodies = bodies_in(given["scene"])
    else:
        count, spacing = value_of("count", given["count"], int), spacing_of(given["spacing"])
        if count < 1:
            raise ValueError(f"argument count: found {count}, expected a number of bodies, 1 or more")
        bodies = side_by_side(given["scene"], shared, count, given["prefix"], spacing)
    found = {}
    for name, own in bodies.items():
        common = shared | {log: apart(shared[log], name) for log in (*LOGS, "sink") if shared.get(log)}
        found[name] = common | own
    return found


def start(context: LaunchContext) -> list[IncludeLaunchDescription]:
    """Return one inclusion of rigid_body.launch.py for each body."""
    given = dict(context.launch_configurations)
    given |= {name: LaunchConfiguration(name).perform(context) for name, *_ in ARGUMENTS}
    bodies = [body_arguments(name, overrides, given) for name, overrides in all_overrides(given).items()]
    if given.get("publish_clock", "").lower() == "true":
        bodies = [*bodies[:1], *(arguments | FOLLOWING for arguments in bodies[1:])]
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(RIGID_BODY)),
            # Arguments without a default must be passed on; the others are inherited.
            launch_arguments=arguments.items(),
        )
        for arguments in bodies
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the description `ros2 launch rb_dynamics bodies.launch.py scene:=FILE count:=3` runs."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, default, text in ARGUMENTS
            ),
            OpaqueFunction(function=start),
        ]
    )
