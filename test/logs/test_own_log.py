"""Logs of this package with damage that no checksum covers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from rb_dynamics import parse_scene, simulate
from rb_dynamics.errors import LogError
from rb_dynamics.formats.log_file import LogFile
from rb_dynamics.formats.mcap_records import McapFile
from rb_dynamics.formats.mcap_writer import McapWriter
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.sinks.convert import log_to_rerun, to_table
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study.replay import replay

SCENE = "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: push}]\nduration: 0.1\noutput_rate: 50\n"


def with_type(log: Path, topic: str, type_name: str) -> Path:
    """Return a copy of `log` in which one topic is said to be of another type."""
    old, target = McapFile(log), log.with_name("damaged.mcap")
    messages = list(old.messages())
    file = LogFile(target)
    writer = McapWriter(file, "test")
    writer.begin()
    numbers = {}
    for channel in old.channels.values():
        schema = channel.schema._replace(name=type_name) if channel.topic == topic else channel.schema
        numbers[channel.topic] = writer.add_channel(replace(channel, schema=schema))
    for message in messages:
        number = numbers[message.channel.topic]
        writer.add_messages((number,), (message.data,), message.log_time, message.publish_time)
    for name, data in old.attachments.items():
        writer.add_attachment(name, "", data)
    for name, facts in old.metadata.items():
        writer.add_metadata(name, facts)
    writer.finish()
    file.close()
    return target


@pytest.mark.parametrize("topic", ["/pose", "/energy/work", "/push", "/push/applied", "/tf", "/inertia"])
@pytest.mark.parametrize("type_name", ["geometry_msgs/msg/PoseStampeq", "nav_msgs/msg/Odometry"])
def test_a_topic_of_another_type_is_named(tmp_path: Path, topic: str, type_name: str) -> None:
    log = tmp_path / "run.mcap"
    simulate(parse_scene(SCENE), [("push", Wrench((1.0, 0.0, 0.0)))], [McapSink(log)])
    damaged = with_type(log, topic, type_name)
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
    simulate(parse_scene(SCENE), [], [McapSink(log)])
    log.write_bytes(log.read_bytes().replace(b"mass: ", b"mass\xff ", 1))
    for read in (replay, lambda path: to_table([path], tmp_path / "run.csv")):
        with pytest.raises(LogError, match=r"run.mcap is damaged: scene.yaml in it is no UTF-8 text \(byte \d+\)"):
            read(log)
