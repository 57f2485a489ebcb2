"""Logs of this package with damage that no checksum covers."""

from __future__ import annotations

from pathlib import Path

import pytest
from edited_logs import edited

from rb_dynamics import parse_scene, simulate
from rb_dynamics.conversion.convert import log_to_rerun, to_table
from rb_dynamics.errors import LogError
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study.replay import replay

SCENE = "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: push}]\nduration: 0.1\noutput_rate: 50\n"


@pytest.mark.parametrize("topic", ["/pose", "/energy/work", "/push", "/push/applied", "/tf", "/inertia"])
@pytest.mark.parametrize("type_name", ["geometry_msgs/msg/PoseStampeq", "nav_msgs/msg/Odometry"])
def test_a_topic_of_another_type_is_named(tmp_path: Path, topic: str, type_name: str) -> None:
    log = tmp_path / "run.mcap"
    simulate(parse_scene(SCENE), [("push", Wrench((1.0, 0.0, 0.0)))], [McapSink(log)])
    damaged = edited(log, tmp_path / "damaged.mcap", types={topic: type_name})
    says = rf"damaged.mcap is damaged: topic {topic} has the type '{type_name}', expected '"
    with pytest.raises(LogError, match=says):
        to_table([damaged], tmp_path / "run.csv")
    with pytest.raises(LogError, match=says if topic != "/pose" else says + "|holds no pose"):
        replay(damaged)
    with pytest.raises(LogError, match=says):
        read_bag(damaged)
    if topic == "/push":
        pytest.importorskip("rerun")
        with pytest.raises(LogError, match=says):
            log_to_rerun(damaged, tmp_path / "run.rrd")


def test_a_scene_that_is_no_text_is_damage(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    simulate(parse_scene(SCENE), [], [McapSink(tmp_path / "whole.mcap")])
    edited(tmp_path / "whole.mcap", log, scene=b"mass\xff 2")
    for read in (replay, lambda path: to_table([path], tmp_path / "run.csv")):
        with pytest.raises(LogError, match=r"run.mcap is damaged: scene.yaml in it is no UTF-8 text \(byte \d+\)"):
            read(log)
