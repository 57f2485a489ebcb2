"""Launches N bodies of one scene, each in a namespace, with a frame and logs of its own; they do not touch each other.

Every argument of rigid_body.launch.py holds for all of them.
"""

from pathlib import Path

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

ARGUMENTS = (
    ("scene", None, "scene file (YAML)"),
    ("count", "2", "how many bodies"),
    ("prefix", "body_", "the namespaces are prefix1, prefix2, ..."),
    ("spacing", "1.0", "m between the bodies, along y of the world"),
)
# Given by each body in its own way.
LOGS = ("mcap", "rerun")
RIGID_BODY = Path(__file__).with_name("rigid_body.launch.py")


def body_arguments(index: int, prefix: str, spacing: float, given: dict[str, str]) -> dict[str, str]:
    """Return the arguments of rigid_body.launch.py for body `index`, from 1, that are its own."""
    name = f"{prefix}{index}"
    overrides = {"body.frame": name, "initial.position_world": [0.0, spacing * (index - 1), 0.0]}
    overrides |= yaml.safe_load(given.get("overrides") or "{}")
    own = {"namespace": name, "overrides": yaml.safe_dump(overrides, default_flow_style=True, width=10**6).strip()}
    logs = {log: Path(given[log]) for log in LOGS if given.get(log)}
    return own | {log: str(path.with_stem(f"{path.stem}_{name}")) for log, path in logs.items()}


def start(context: LaunchContext) -> list[IncludeLaunchDescription]:
    """Return one inclusion of rigid_body.launch.py for each body."""
    configurations = dict(context.launch_configurations)
    count = int(LaunchConfiguration("count").perform(context))
    prefix, spacing = (LaunchConfiguration(name).perform(context) for name in ("prefix", "spacing"))
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(RIGID_BODY)),
            # What has no default has to be handed on; the rest is inherited.
            launch_arguments=(
                {"scene": configurations["scene"]} | body_arguments(index, prefix, float(spacing), configurations)
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
