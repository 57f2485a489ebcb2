"""`Registry`: own and installed entries; a broken package does no harm until it is named."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

from rb_dynamics.errors import PluginError
from rb_dynamics.loads.effect_types import EFFECTS
from rb_dynamics.motion import METHODS
from rb_dynamics.plugins import Registry

OWN = {"rk": "ours", "euler": "ours too"}


def install(folder: Path, package: str, source: str, **points: str) -> None:
    """Install `source` as a package of one module as pip would; `points` are its entry points by group."""
    module = package.replace("-", "_")
    info = folder / f"{module}-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.2\n")
    groups = [f"[rb_dynamics.{group}]\n{lines}\n" for group, lines in points.items()]
    (info / "entry_points.txt").write_text("\n".join(groups))
    (folder / f"{module}.py").write_text(source)


def things(fault: str = "") -> Registry[object]:
    return Registry("thing", OWN, lambda _name, _found: fault)


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_ours_come_first_and_stay_ours(site: Path) -> None:
    install(site, "pirate", "x = 'theirs'", things="rk = pirate:x\nafter = pirate:x\nacme = pirate:x")
    found = things()

    assert list(found) == ["rk", "euler", "acme", "after"]
    assert len(found) == 4
    assert found["rk"] == "ours"
    assert found["after"] == "theirs"
    assert found.origin("after") == "pirate 1.2"
    assert found.origin("rk") == found.origin("acme") == ""
    with pytest.raises(KeyError):
        found["none"]


def test_what_is_ours_is_found_without_a_look_at_what_is_installed() -> None:
    code = (
        "import sys; from rb_dynamics.motion import METHODS; METHODS['rk4']; assert 'rk4' in METHODS; "
        "assert 'importlib.metadata' not in sys.modules; assert 'no' not in METHODS; "
        "assert 'importlib.metadata' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_broken_one_is_an_error_by_name_and_left_out_otherwise(site: Path, caplog: pytest.LogCaptureFixture) -> None:
    install(site, "broken-one", "import no_such_library", things="bad = broken_one:x")
    install(site, "sound-one", "x = 'sound'", things="good = sound_one:x")
    found = things()

    message = (
        r"thing bad: cannot be loaded from broken_one:x of the package broken-one 1\.2: ModuleNotFoundError: No module "
        r"named 'no_such_library'; mend, update or uninstall that package"
    )
    with pytest.raises(PluginError, match=message):
        found["bad"]
    assert "bad" in found
    with caplog.at_level(logging.WARNING):
        assert list(found.usable()) == ["ours", "ours too", "sound"]
    assert "thing bad: cannot be loaded" in caplog.text


def test_one_that_is_not_what_it_should_be(site: Path) -> None:
    install(site, "other-kind", "x = 1", things="odd = other_kind:x")
    with pytest.raises(PluginError, match=r"thing odd: other_kind:x of the package other-kind 1\.2 is 1, not a thing;"):
        things("1, not a thing")["odd"]


def test_two_packages_of_one_name(site: Path) -> None:
    for package in ("first", "second"):
        install(site, package, "x = 1", things=f"same = {package}:x")
    with pytest.raises(PluginError, match=r"(?=.*first 1\.2)(?=.*second 1\.2).*expected one plug-in of that name"):
        things()["same"]


FAULTS = """
from dataclasses import dataclass, replace
from rb_dynamics import METHODS, Effect
number, renamed, fast = 1, METHODS["rk4"], replace(METHODS["rk4"], name="fast")
class Other(Effect):
    kind = "other"
"""


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("solver.method=number", "1, expected a rb_dynamics.motion.Method"),
        ("solver.method=renamed", "a method named 'rk4', expected 'renamed'"),
        ("solver.method=fast", "a method that compiles, expected compiles=False"),
        ("effects=[{type: number}]", "1, expected a subclass of rb_dynamics.Effect"),
        ("effects=[{type: renamed}]", "of kind 'other', expected 'renamed'"),
    ],
)
def test_a_scene_that_names_a_faulty_one_says_where(change: str, message: str, root: Path, tmp_path: Path) -> None:
    methods = "\n".join(f"{name} = faulty:{name}" for name in ("number", "renamed", "fast"))
    install(tmp_path, "faulty", FAULTS, methods=methods, effects="number = faulty:number\nrenamed = faulty:Other")
    command = [sys.executable, "-m", "rb_dynamics", "simulate", "config/dzhanibekov.yaml", "--set", change]
    paths = os.pathsep.join((str(tmp_path), str(root), os.environ.get("PYTHONPATH", "")))
    done = subprocess.run(
        command, cwd=root, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True, check=False
    )

    assert done.returncode == 2
    assert "config/dzhanibekov.yaml:override: " in done.stderr
    assert "that can be loaded; " in done.stderr
    assert message in done.stderr


def test_registries_of_the_package_have_ours_under_their_names() -> None:
    assert all(name == method.name for name, method in METHODS.own.items())
    assert all(name == effect.kind and effect.keys for name, effect in EFFECTS.own.items())


@pytest.mark.slow
def test_a_method_that_fails_harms_no_trade_of_others(tmp_path: Path) -> None:
    source = """
from rb_dynamics.motion.method import LoadDependence, Method
def step(*_):
    return 1 / 0
bad = Method("bad", 2, frozenset(), step, takes=LoadDependence.ANY)
"""
    install(tmp_path, "faulty", source, methods="bad = faulty:bad")
    # By what the process has worked: what else the machine does is not to change what is found.
    code = (
        "import time; from rb_dynamics import parse_scene; from rb_dynamics.cli.commands.trade import as_text; "
        "from rb_dynamics.study.trade import trade; "
        "scene = parse_scene('body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\\n"
        "initial: {angular_velocity_body: [0.1, 2, 0.1]}\\neffects: [{type: linear_drag, rotation: 0.1}]\\n"
        "wrenches: []\\nduration: 2'); "
        "print(as_text(trade(scene, target=1e-3, time_s=4.0, clock=time.process_time)))"
    )
    path = os.pathsep.join([str(tmp_path), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": path, "RB_DYNAMICS_COMPILE": "never"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "left out    bad: " in done.stdout
    assert "faulty 1.2" in done.stdout
