"""Launches N independent bodies of one scene, each in a namespace, with its own frame and logs.

Every argument of rigid_body.launch.py holds for all of them; a namespace is put before theirs.
"""

import json
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

from rb_dynamics.ros.start_arguments import apart, value_of, values_of

ARGUMENTS = (
    ("scene", None, "scene file (YAML)"),
    ("count", "2", "how many bodies"),
    ("prefix", "body_", "the namespaces are prefix1, prefix2, ..."),
    ("spacing", "1.0", "m between the bodies, along y of the world"),
)
# Set individually for each body.
LOGS = ("mcap", "bag", "rerun")
RIGID_BODY = Path(__file__).with_name("rigid_body.launch.py")


def body_arguments(index: int, prefix: str, spacing: float, given: dict[str, str]) -> dict[str, str]:
    """Return the individual arguments of rigid_body.launch.py for body `index`, from 1."""
    name = f"{prefix}{index}"
    overrides: dict[str, object] = {"body.frame": name, "initial.position_world": [0.0, spacing * (index - 1), 0.0]}
    overrides |= values_of("overrides", given.get("overrides", ""))
    overrides |= {log: apart(overrides[log], name) for log in (*LOGS, "sink") if overrides.get(log)}
    own = {
        "namespace": f"{given.get('namespace', '')}/{name}",
        # JSON is YAML with all strings quoted, so that types are kept.
        "overrides": json.dumps(overrides, ensure_ascii=False),
    }
    return own | {log: str(apart(given[log], name)) for log in LOGS if given.get(log)}


def start(context: LaunchContext) -> list[IncludeLaunchDescription]:
    """Return one inclusion of rigid_body.launch.py for each body."""
    configurations = dict(context.launch_configurations)
    given = {name: LaunchConfiguration(name).perform(context) for name, *_ in ARGUMENTS}
    count, spacing = value_of("count", given["count"], int), value_of("spacing", given["spacing"], float)
    if count < 1:
        raise ValueError(f"argument count: found {count}, expected a number of bodies, 1 or more")
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(RIGID_BODY)),
            # Arguments without a default must be passed on; the others are inherited.
            launch_arguments=(
                {"scene": given["scene"]} | body_arguments(index, given["prefix"], spacing, configurations)
            ).items(),
        )
        for index in range(1, count + 1)
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
