"""Count how often intervals of `identify` contain the truth where thrusters push: docs/identify.md.

    python tools/calibrate_thrusters.py [flights]    # some minutes; needs the extras log and fast

Each flight has other commands and other noise, of 1e-3 m, rad and rad/s.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "support"))

from fired_thrusters import FITTED, SCENE, contained, recorded, rough
from in_parallel import in_parallel

from rb_dynamics import identify, parse_scene


def within(seed: int) -> list[bool]:
    """Return of each number that is fitted whether its interval contains the truth."""
    scene = parse_scene(SCENE)
    with tempfile.TemporaryDirectory() as folder:
        bag = recorded(Path(folder) / "bag", scene, seed, noise=1e-3)
        return contained(identify(rough(), [str(bag)], FITTED), scene)


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 90
    found = [inside for one in in_parallel(within, range(100, 100 + count), 2) for inside in one]
    print(f"{sum(found)} of {len(found)} intervals contain the truth")


if __name__ == "__main__":
    main()
