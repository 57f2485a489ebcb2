"""Build sdist and wheel, install them into fresh environments, and compare results of the same scenes.

    python tools/try_wheels.py                        # every working python3.10 to 3.14 on PATH
    python tools/try_wheels.py /path/to/python3.13    # only these

The wheel is installed in each with the newest dependencies, and with the oldest that setup.py allows and that have
wheels for it; the sdist in the first.
Exit code 1 if an installation fails or any bit differs. Results stay in dist/. Needs build and twine.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
MINORS = range(10, 15)
SCENES = ("dzhanibekov", "slew", "central_gravity", "rotor")
VERSIONS = """
import platform, numpy, scipy, yaml
print(platform.python_version(), numpy.__version__, scipy.__version__, yaml.__version__)
"""

# By minor version of Python: the oldest versions with wheels for it, none older than setup.py allows.
OLDEST = {
    10: ("numpy==1.26.0", "scipy==1.11.1", "PyYAML==6.0"),
    12: ("numpy==1.26.0", "scipy==1.11.2", "PyYAML==6.0.1"),
    13: ("numpy==2.1.0", "scipy==1.14.1", "PyYAML==6.0.2"),
    14: ("numpy==2.3.2", "scipy==1.16.1", "PyYAML==6.0.3"),
}


def interpreters() -> Iterator[str]:
    """Yield one python of each supported version on PATH; broken shims are skipped."""
    for minor in MINORS:
        found = (Path(folder) / f"python3.{minor}" for folder in os.get_exec_path())
        works = (str(path) for path in found if path.is_file() and _minor(str(path)) == minor)
        yield from (path for path in [next(works, None)] if path)


def _minor(python: str) -> int:
    code = "import sys; print(sys.version_info.minor)"
    done = subprocess.run([python, "-c", code], capture_output=True, text=True, check=False)
    return int(done.stdout) if done.returncode == 0 else -1


def bits(python: str, package: Path, dependencies: tuple[str, ...]) -> str:
    """Return versions and a hash of the results of the scenes in a fresh environment with `package`.

    Raises:
        subprocess.CalledProcessError: it cannot be installed, or a scene does not run.
    """
    with tempfile.TemporaryDirectory() as folder:
        _run(python, "-m", "venv", folder)
        inside = str(Path(folder) / "bin" / "python")
        pip = ("-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--only-binary", "numpy,scipy,PyYAML")
        _run(inside, *pip, str(package), *dependencies)
        command = (inside, "-I", "-m", "rb_dynamics", "simulate", "--json")
        runs = [json.loads(_run(*command, str(ROOT / "config" / f"{scene}.yaml"))) for scene in SCENES]
        states = [run | {"wall_time_s": None} for run in runs]
        return f"{_run(inside, '-c', VERSIONS).strip()} {hashlib.sha256(repr(states).encode()).hexdigest()[:16]}"


def _run(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def main(pythons: list[str]) -> int:
    """Build, test, and print a row for each environment; return 1 if one failed or differs from the first."""
    shutil.rmtree(DIST, ignore_errors=True)
    _run(sys.executable, "-m", "build", "--outdir", str(DIST), str(ROOT))
    (wheel,), (sdist,) = DIST.glob("*.whl"), DIST.glob("*.tar.gz")
    _run(sys.executable, "-m", "twine", "check", "--strict", str(wheel), str(sdist))
    tried = [("sdist", pythons[0], ())]
    for python in pythons:
        oldest = OLDEST[max(minor for minor in OLDEST if minor <= _minor(python))]
        tried += [("wheel", python, ()), ("wheel", python, oldest)]
    hashes, failed = set[str](), False
    print("package  python  numpy   scipy   PyYAML  states")
    for kind, python, dependencies in tried:
        try:
            words = bits(python, sdist if kind == "sdist" else wheel, dependencies).split()
        except subprocess.CalledProcessError as error:
            failed = True
            print(f"{kind}    {python}: {' '.join(map(str, error.cmd))}\n{error.stderr}")
            continue
        hashes.add(words[-1])
        print(f"{kind}    " + "  ".join(f"{word:6}" for word in words), flush=True)
    return int(failed or len(hashes) != 1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or list(interpreters())))
