"""Security: the policy matches what the node does, and a node to be secured does not start without it."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from command_line import called
from ros_harness import ROOT

from rb_dynamics.ros.node import RigidBodyNode
from rb_dynamics.ros.permissions import main

pytestmark = pytest.mark.ros


def generated(*arguments: str) -> str:
    # As the message says: on a busy machine DDS may not tell all in time.
    for _ in range(3):
        done = called(main, *arguments)
        if "try it again" not in done.stderr:
            break
    assert done.returncode == 0, done.stderr
    return done.stdout


def names(policy: str, tag: str, right: str) -> list[str | None]:
    root = ElementTree.fromstring(policy)
    assert [enclave.get("path") for enclave in root.iter("enclave")]
    return [each.text for group in root.iter(f"{tag}s") if group.get(right) == "ALLOW" for each in group]


def test_the_shipped_policy_is_that_of_the_node() -> None:
    found = generated(str(ROOT / "config" / "free_flyer.yaml"))
    shipped = (ROOT / "config" / "security" / "free_flyer.policy.xml").read_text(encoding="utf-8")
    # Where simulation_interfaces is installed, the node answers more.
    if importlib.util.find_spec("simulation_interfaces") is None:
        assert found == shipped
    assert names(shipped, "topic", "subscribe") == ["/rigid_body/set_state", "/wrench"]
    assert "/odom" in names(shipped, "topic", "publish")
    assert "/rigid_body/reset" in names(shipped, "service", "reply")
    assert not names(shipped, "service", "request")


def test_the_policy_waits_until_the_graph_knows_the_node(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine it learns late of the last services."""
    look, late = RigidBodyNode.get_service_names_and_types_by_node, iter(range(3))
    monkeypatch.setattr(
        RigidBodyNode,
        "get_service_names_and_types_by_node",
        lambda *node: look(*node)[:1] if next(late, None) is not None else look(*node),
    )
    found = generated(str(ROOT / "config" / "free_flyer.yaml"))
    assert "/rigid_body/reset" in names(found, "service", "reply")


def test_a_policy_follows_namespace_remapping_and_scene(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}\nwrenches: [{topic: a}, {topic: b}]\n")
    arguments = (
        "--enclave",
        "/fleet/one",
        "--ros-args",
        "-r",
        "__ns:=/one",
        "-r",
        "a:=/push",
        "-p",
        "publish_clock:=true",
    )
    found = generated(str(scene), *arguments)
    assert names(found, "topic", "subscribe") == ["/one/b", "/one/rigid_body/set_state", "/push"]
    assert "/clock" in names(found, "topic", "publish")
    assert 'ns="/one"' in found
    assert 'path="/fleet/one"' in found


# What `ros2 security` does to make keys, an enclave and its signed permissions.
SECURE = """
import sys
from pathlib import Path
from sros2 import keystore

keys, enclave, policy = Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
keystore.create_keystore(keys)
keystore.create_enclave(keys, enclave)
keystore.create_permission(keys, enclave, policy)
"""


@pytest.mark.skipif(importlib.util.find_spec("sros2") is None, reason="sros2 is not installed: it is not on PyPI")
def test_sros2_makes_permissions_of_the_policy_that_deny_all_else(tmp_path: Path) -> None:
    shipped = ROOT / "config" / "security" / "free_flyer.policy.xml"
    subprocess.run([sys.executable, "-c", SECURE, str(tmp_path), "/rigid_body", str(shipped)], check=True)
    enclave = tmp_path / "enclaves" / "rigid_body"
    assert (enclave / "permissions.p7s").stat().st_size > 0
    (grant,) = ElementTree.parse(enclave / "permissions.xml").getroot().iter("grant")
    assert grant.findtext("default") == "DENY"
    allowed = {
        right: {each.text for part in grant.iter(right) for each in part.iter("topic")} - {"ros_discovery_info"}
        for right in ("publish", "subscribe")
    }
    policy = shipped.read_text(encoding="utf-8")
    services = names(policy, "service", "reply")
    assert allowed["publish"] == {f"rt{topic}" for topic in names(policy, "topic", "publish")} | {
        f"rr{service}Reply" for service in services
    }
    assert allowed["subscribe"] == {f"rt{topic}" for topic in names(policy, "topic", "subscribe")} | {
        f"rq{service}Request" for service in services
    }


def test_a_scene_that_is_none_has_no_policy(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("body: 3\n")
    result = called(main, scene)
    assert result.returncode == 2
    assert result.stdout == ""


@pytest.mark.parametrize("has_keys", [False, True])
def test_a_node_that_is_to_be_secured_and_cannot_be_does_not_start(tmp_path: Path, has_keys: bool) -> None:
    """Without keys or with invalid ones; with any keys if the middleware has no security."""
    if has_keys:
        enclave = tmp_path / "enclaves" / "rigid_body"
        enclave.mkdir(parents=True)
        for part in ("identity_ca.cert", "cert", "key", "permissions_ca.cert"):
            (enclave / f"{part}.pem").write_text("no key")
        for part in ("governance", "permissions"):
            (enclave / f"{part}.p7s").write_text("not signed")
    secured = {
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_KEYSTORE": str(tmp_path),
    }
    result = subprocess.run(
        [
            sys.executable,
            "-m",
            "rb_dynamics",
            "node",
            "config/free_flyer.yaml",
            "--ros-args",
            "--enclave",
            "/rigid_body",
        ],
        cwd=ROOT,
        env={**os.environ, **secured},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert result.returncode == 2
    assert "ROS 2 could not start the node" in result.stderr
    assert "Traceback" not in result.stderr


def test_the_policy_is_made_without_a_log(scene: Path, tmp_path: Path) -> None:
    logs = ("-p", f"mcap:={tmp_path}/run.mcap", "-p", f"sink:=[rerun={tmp_path}/run.rrd]")
    assert "/pose" in names(generated(str(scene), "--ros-args", *logs), "topic", "publish")
    assert list(tmp_path.glob("run.*")) == []


@pytest.mark.parametrize("wrong", [("-r", "a b:=c"), ("-p", "solver.method:=rk9")])
def test_a_wrong_argument_ends_it_with_one_message(scene: Path, wrong: tuple[str, str]) -> None:
    result = called(main, scene, "--ros-args", *wrong)
    assert result.returncode == 2
    assert result.stderr.splitlines()[-1].startswith("permissions: ")
