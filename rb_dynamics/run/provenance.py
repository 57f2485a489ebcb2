"""Provenance of a run: the metadata in a log with which the run can be repeated and checked."""

from __future__ import annotations

import functools
import hashlib
from typing import TYPE_CHECKING

from rb_dynamics.formats.log_metadata import UNLOGGED, version

if TYPE_CHECKING:
    from rb_dynamics.scene.model import Scene

_PACKAGES = ("rb_dynamics", "numpy", "scipy", "PyYAML", "zstandard", "rerun-sdk")


# Folders of the package whose code determines the numbers of a run.
_COMPUTES = ("body", "formats/yaml", "loads", "motion", "numerics", "run", "scene", "sensors")


@functools.cache
def code_hash() -> str:
    """Return the SHA-256 of the source code that computes runs, paths included; "" if there are no sources.

    Two installations of one version may differ by an edit. Windows line endings count as Unix ones.
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

    `seed` is empty if a run uses no random numbers.
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
        UNLOGGED: ", ".join(scene.combined_effects.varying),
        "platform": platform.platform(),
        "machine": platform.machine(),
        "python": platform.python_version(),
        "code_sha256": code_hash(),
        **{f"version.{package}": version(package) for package in (*_PACKAGES, *_of_effects(scene))},
        **({"plugins": plugins} if plugins else {}),
    }


def _of_effects(scene: Scene) -> list[str]:
    """Return the packages whose data the effects of a scene use."""
    from rb_dynamics.loads.magnetic_field import MagneticField

    fields = [effect for effect in scene.effects if isinstance(effect, MagneticField)]
    return ["ppigrf"] if any(field.model == "igrf" for field in fields) else []
