"""Measure the start-up time of the command line in units of `python -c "import numpy"`.

Usage: python benchmarks/startup.py [turns]

The commands take turns, each in its own process with cached byte code. Prints the median of each and its ratio. The
project promises less than 3 for `--help` and less than 5 for `simulate config/slew.yaml` (6000 steps of rkmk4).
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
YARDSTICK = 'python -c "import numpy"'
COMMANDS = {
    'python -c ""': ["-c", ""],
    YARDSTICK: ["-c", "import numpy"],
    'python -c "import rb_dynamics"': ["-c", "import rb_dynamics"],
    "rb-dynamics --help": ["-m", "rb_dynamics", "--help"],
    "rb-dynamics simulate config/dzhanibekov.yaml": ["-m", "rb_dynamics", "simulate", "config/dzhanibekov.yaml"],
    "rb-dynamics simulate config/slew.yaml": ["-m", "rb_dynamics", "simulate", "config/slew.yaml"],
}
TURNS = 21


def medians(turns: int = TURNS) -> dict[str, float]:
    """Return the median time (s) of each command."""
    times: dict[str, list[float]] = {name: [] for name in COMMANDS}
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "PYTHONPYCACHEPREFIX": cache, "PYTHONDONTWRITEBYTECODE": ""}
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
        for turn in range(turns + 1):
            for name, arguments in COMMANDS.items():
                begin = time.perf_counter()
                subprocess.run([sys.executable, *arguments], cwd=ROOT, env=environment, capture_output=True, check=True)
                # The first turn fills the cache.
                if turn:
                    times[name].append(time.perf_counter() - begin)
    return {name: statistics.median(found) for name, found in times.items()}


def main() -> None:
    found = medians(int(sys.argv[1]) if len(sys.argv) > 1 else TURNS)
    for name, seconds in found.items():
        print(f"{name:46} {seconds * 1e3:7.1f} ms {seconds / found[YARDSTICK]:6.2f}")


if __name__ == "__main__":
    main()
