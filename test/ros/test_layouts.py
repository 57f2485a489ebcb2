"""The layouts in config/ use topics of the node."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
TYPES = {
    "Pose": {"/pose": "geometry_msgs/msg/PoseStamped"},
    "Odometry": {"/odom": "nav_msgs/msg/Odometry"},
    "TwistStamped": {"/twist": "geometry_msgs/msg/TwistStamped"},
    "Wrench": {"/wrench": "geometry_msgs/msg/WrenchStamped"},
}


def node_topics() -> dict[str, str]:
    """The topics and types that the log has: those of the node."""
    from rb_dynamics.formats.message_types import DIAGNOSTICS, WRENCH
    from rb_dynamics.logs.messages import SAMPLE_TOPICS

    return {f"/{name}": kind for name, kind in SAMPLE_TOPICS} | {"/wrench": WRENCH, "/diagnostics": DIAGNOSTICS}


def test_rviz_draws_topics_of_the_node_by_their_types_and_qos() -> None:
    layout = yaml.safe_load((ROOT / "config" / "rigid_body.rviz").read_text(encoding="utf-8"))
    manager = layout["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "world"
    drawn = 0
    for display in manager["Displays"]:
        kind = display["Class"].removeprefix("rviz_default_plugins/")
        if "Topic" in display:
            topic = display["Topic"]
            assert TYPES[kind][topic["Value"]] == node_topics()[topic["Value"]]
            assert (topic["Durability Policy"], topic["Reliability Policy"]) == ("Volatile", "Reliable")
            drawn += 1
    assert drawn == len(TYPES)


def test_foxglove_shows_fields_that_the_messages_have() -> None:
    from rosbags.typesys import Stores, get_typestore

    layout = json.loads((ROOT / "config" / "rigid_body.foxglove.json").read_text(encoding="utf-8"))
    fields = get_typestore(Stores.ROS2_JAZZY).fielddefs

    def panels(part: Any) -> list[str]:
        return [part] if isinstance(part, str) else panels(part["first"]) + panels(part["second"])

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    topics = node_topics()
    paths = [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", [])]
    assert len(paths) > 10
    for path in paths:
        match = re.fullmatch(r"(/[a-z_/]+)\.([a-z_.]+)", path)
        assert match, path
        kind = topics[match[1]]
        for name in match[2].split("."):
            _, definitions = fields[kind]
            field = dict(definitions)[name]
            kind = field[1] if isinstance(field[1], str) else field[1][0]
        assert kind == "float64", path
