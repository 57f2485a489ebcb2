"""Provenance of a run: the metadata in a log with which the run can be repeated and checked."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rb_dynamics.scene.model import Scene

SCENE = "scene.yaml"
"""Name of the attachment of a log that contains its scene."""

RUN = "rb_dynamics"
"""Name of the metadata of a log with the facts of the run: `run_metadata`."""

RESULT = "rb_dynamics.result"
"""Name of the metadata of a log with the result of the run."""

CONTINUES_IN = "continues_in"
"""Key in it, in a file that is not the last of a bag, of the next file; such a result is not the end of a run."""

INTERRUPTED = "rb_dynamics.interrupted"
"""Name of the metadata in a log whose run, disk or power ended before the log was finished."""

CUT_OFF, DAMAGED = "cut off", "damaged"
"""Value of `reason` in it for a recovered file; "cut off and damaged" if it was both."""

MISSING_FILES = "missing_files"
"""Key in it of the missing files of a bag that has later ones."""

TOPICS = "rb_dynamics.topics"
"""Name of the metadata of a log that maps the scene's topic names to those in the log."""

INPUTS_RULE = "inputs_rule"
"""Key in the result of the rule by which `inputs_sha256` was computed; absent in logs of the first rule."""

CHECKPOINT = "rb_dynamics.checkpoint"
"""Name of the metadata written between samples: their number and the hash of all of them so far."""

EPOCH = "rb_dynamics.epoch"
"""Name of the metadata with the ROS time of simulation time 0, where messages are stamped with ROS time."""

_PACKAGES = ("rb_dynamics", "numpy", "scipy", "PyYAML", "zstandard", "rerun-sdk")


def next_file(metadata: Mapping[str, Mapping[str, str]]) -> str:
    """Return the file of a bag that follows the one with this metadata; "" if it is the last or does not say."""
    return metadata.get(RESULT, {}).get(CONTINUES_IN, "")


@functools.cache
def version(package: str = "rb_dynamics") -> str:
    """Return the installed version of `package` when first asked, or "not installed"."""
    from importlib import metadata

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


# Folders of the package whose code determines the numbers of a run.
_COMPUTES = ("body", "loads", "motion", "numerics", "run", "scene", "sensors")


@functools.cache
def code_hash() -> str:
    """Return the SHA-256 of the source code that computes runs, paths included; "" where there are no sources.

    Two installations of one version may differ by an edit. Line ends of Windows count as those of Unix.
    """
    from pathlib import Path

    package = Path(__file__).parents[1]
    files = sorted(path for folder in _COMPUTES for path in (package / folder).rglob("*.py"))
    found = hashlib.sha256()
    for path in files:
        source = path.read_bytes().replace(b"\r\n", b"\n")
        found.update(f"{path.relative_to(package).as_posix()} {len(source)}\n".encode() + source)
    return found.hexdigest() if files else ""


def run_metadata(scene: Scene, method: str, solver: str) -> dict[str, str]:
    """Return the facts at the start of a run: software, platform, method, hash of the scene. Values are text.

    `seed` is empty where nothing in a run draws random numbers.
    """
    import platform
    from pathlib import PurePath

    from rb_dynamics.loads.effect_types import EFFECTS
    from rb_dynamics.motion import METHODS

    origins = [METHODS.origin(scene.solver.method), *(EFFECTS.origin(effect.kind) for effect in scene.effects)]
    plugins = ", ".join(dict.fromkeys(filter(None, origins)))
    return {
        "scene_file": PurePath(scene.source).name,
        "scene_sha256": hashlib.sha256(scene.text.encode()).hexdigest(),
        "method": method,
        "solver": solver,
        "seed": str(scene.seed) if scene.sensors else "",
        "effects": ", ".join(effect.kind for effect in scene.effects),
        "effects_not_logged_as_wrench": ", ".join(scene.combined_effects.varying),
        "platform": platform.platform(),
        "machine": platform.machine(),
        "python": platform.python_version(),
        "code_sha256": code_hash(),
        **{f"version.{package}": version(package) for package in (*_PACKAGES, *_of_effects(scene))},
        **({"plugins": plugins} if plugins else {}),
    }


def _of_effects(scene: Scene) -> list[str]:
    """Return the packages whose numbers are in the effects of a scene."""
    from rb_dynamics.loads.magnetic_field import MagneticField

    fields = [effect for effect in scene.effects if isinstance(effect, MagneticField)]
    return ["ppigrf"] if any(field.model == "igrf" for field in fields) else []
