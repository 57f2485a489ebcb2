"""Options for logs: `--sink NAME=TARGET` is equivalent to the option of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rb_dynamics.errors import LogError
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene import parse_scene
from rb_dynamics.sinks.log_options import LogOptions
from rb_dynamics.sinks.mcap_sink import LogSettings

SCENE = parse_scene(
    "body: {mass: 1, inertia: {diagonal: [1, 2, 2.5]}}\nwrenches: [{topic: push}]\nduration: 2.0\noutput_rate: 10\n",
    "s.yaml",
)


@pytest.mark.parametrize("log", ["mcap", "bag"])
def test_by_option_and_by_name_a_log_has_the_same_topics_and_messages(tmp_path: Path, log: str) -> None:
    settings = LogSettings(accel=True)
    bound = 0.5 if log == "bag" else 0.0
    by_option = LogOptions(**{log: str(tmp_path / "option")}, max_bag_duration=bound, settings=settings)
    by_name = LogOptions(max_bag_duration=bound, settings=settings, named=[f"{log}={tmp_path / 'name'}"])
    for logs in (by_option, by_name):
        simulate(SCENE, sinks=logs.sinks("/robot", {"pose": "/elsewhere"}))
    option, name = (list(open_source(tmp_path / each).messages()) for each in ("option", "name"))
    assert [(m.channel.topic, m.log_time, bytes(m.data)) for m in option] == [
        (m.channel.topic, m.log_time, bytes(m.data)) for m in name
    ]
    assert {"/elsewhere", "/robot/odom", "/robot/accel"} <= {m.channel.topic for m in name}
    if log == "bag":
        assert len(list((tmp_path / "name").glob("*.mcap"))) > 2
    else:
        assert read_bag(tmp_path / "name").complete


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        ({"mcap": "a", "bag": "b"}, "expected one"),
        ({"mcap": "a", "max_bag_size": 10}, "without bag"),
        ({"named": ["mcap=a"], "max_bag_duration": 1.0}, "without bag"),
        ({"mcap": "a", "named": ["mcap=a"]}, "found a more than once"),
        ({"named": ["mcap=a", "bag=a"]}, "found a more than once"),
    ],
)
def test_logs_that_do_not_go_together_are_refused(asked: dict[str, Any], expected: str) -> None:
    with pytest.raises(LogError, match=expected):
        LogOptions(**asked)


@pytest.mark.parametrize(
    ("text", "expected"), [("rows=a", "expected one of mcap, bag, rerun"), ("mcap", "NAME=TARGET")]
)
def test_a_name_that_is_none_is_said_with_those_that_are(text: str, expected: str) -> None:
    with pytest.raises(LogError, match=expected):
        LogOptions(named=[text]).sinks()
