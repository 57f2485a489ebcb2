"""Draw the figures of docs/campaigns.md and docs/tutorials/spacecraft.md; studies run if out/ has no rows of them.

    python tools/make_campaigns.py [NAME...]  # a few minutes; needs the extras scale and plot

The page itself, written by hand, says what the studies show.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.figure import Figure

from rb_dynamics.study.campaign.block_of_runs import simulate_alone
from rb_dynamics.study.campaign.engine import run_campaign
from rb_dynamics.study.campaign.metrics import quantity
from rb_dynamics.study.campaign.read import read_campaign
from rb_dynamics.study.campaign.store import Store, read_rows

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
GOOD, BAD, GREY = "#3b86d1", "#d9591b", "#8a949e"

# Runs and microseconds of one core for each, by `python benchmarks/campaign.py runs 1000000`.
COST: tuple[tuple[int, float], ...] = (
    (1, 11461.7), (10, 5241.7), (100, 253.0), (1_000, 194.9), (10_000, 203.5), (100_000, 212.3), (1_000_000, 199.9),
)  # fmt: skip


def rows(name: str) -> dict[str, Any]:
    """Return the rows of a shipped campaign, after making the missing runs."""
    campaign = read_campaign(ROOT / "config" / "campaigns" / f"{name}.yaml")
    out = ROOT / "out" / f"{name}.parquet"
    run_campaign(campaign, Store(out, campaign), progress=lambda done, total: print(f"\r{name} {done}/{total}", end=""))
    print()
    return read_rows(out)


def dots(axes: Any, x: np.ndarray, y: np.ndarray, passed: np.ndarray) -> None:
    for chosen, color, label in ((passed, GOOD, "passed"), (~passed, BAD, "failed")):
        axes.scatter(x[chosen], y[chosen], s=5.0, color=color, alpha=0.6, linewidths=0, label=label)


def detumble(figure: Figure) -> None:
    found = rows("detumble")
    gain, passed = found["control.parameters.gain"], found["passed"]
    bias = np.sqrt(sum(found[f"control.bias[{i}]"] ** 2 for i in range(3)))
    left, right = figure.subplots(1, 2)
    dots(left, gain, found["time_to_rest"], passed)
    left.set(xlabel="gain [N m s]", ylabel="time to rest [s]", yscale="log")
    left.legend(frameon=False)
    dots(right, bias / gain, found["final_rate"], passed)
    right.plot([0.0, 0.012], [0.0, 0.012], color=GREY, linestyle="--", linewidth=1.0)
    right.set(xlabel="|bias| / gain [rad/s]", ylabel="final rate [rad/s]")


def capture(figure: Figure) -> None:
    found = rows("capture")
    turns = np.sqrt(sum(found[f"initial.orientation.turn[{i}]"] ** 2 for i in range(2)))
    mean = np.array([0.0, -0.0011313666536110225, 0.0])
    spin = np.stack([found[f"initial.angular_velocity_body[{i}]"] for i in range(3)], axis=-1) - mean
    off = np.hypot(spin[:, 0], spin[:, 1]) / 0.0011313666536110225
    left, right = figure.subplots(1, 2)
    dots(left, off, turns, found["passed"])
    left.set(xlabel="excess rate across the long axis / orbital rate", ylabel="initial tilt [rad]")
    left.legend(frameon=False)
    dots(right, off, found["worst_off_nadir"], found["passed"])
    right.set(xlabel="excess rate across the long axis / orbital rate", ylabel="worst angle from the vertical [rad]")


def rotor(figure: Figure) -> None:
    found = rows("rotor")
    axes = figure.subplots()
    dots(axes, 0.02 * found["effects[0].spin_rate"], found["tilt"], found["passed"])
    axes.axvline(0.5, color=GREY, linestyle="--", linewidth=1.0)
    axes.annotate("h = (I3 - I2) W", (0.51, 2.6), color=GREY)
    axes.set(xlabel="momentum of the rotor h [N m s]", ylabel="largest tilt of the spin axis [rad]")
    axes.legend(frameon=False)


def spacecraft(figure: Figure) -> None:
    """The six runs of the tutorial, over time."""
    campaign = read_campaign(ROOT / "config" / "campaigns" / "spacecraft.yaml", {"runs": 6})
    quantities = [quantity(campaign, each) for each in campaign.metrics if each.name in ("pointing", "wheel_speed")]
    panels = figure.subplots(1, 2)
    for run in range(campaign.runs):
        seen: list[tuple[float, ...]] = []
        found = simulate_alone(
            campaign,
            run,
            watch=lambda samples, seen=seen: seen.append(
                (samples.time_ns / 1e9, *(float(each(samples)[0]) for each in quantities))
            ),
        )
        color, label = (GOOD, "passed") if found["pointing"] < 0.02 else (BAD, "failed")
        times, *columns = zip(*seen, strict=True)
        for axes, column in zip(panels, columns, strict=True):
            told = label not in axes.get_legend_handles_labels()[1]
            axes.plot(times, column, color=color, linewidth=1.2, label=label if told else None)
    panels[0].axhline(0.02, color=GREY, linestyle="--", linewidth=1.0, label="required at the end")
    panels[0].set(xlabel="time [s]", ylabel="angle from the target [rad]", yscale="log")
    panels[1].axhline(600.0, color=GREY, linestyle="--", linewidth=1.0, label="max_speed")
    panels[1].set(xlabel="time [s]", ylabel="fastest wheel [rad/s]", ylim=(-20.0, 800.0))
    for axes, place in zip(panels, ("lower left", "upper right"), strict=True):
        axes.legend(loc=place, fontsize=8.0, ncols=1 if place == "lower left" else 3)


def cost(figure: Figure) -> None:
    axes = figure.subplots()
    runs, each = zip(*COST, strict=True)
    axes.loglog(runs, each, "o-", color=GOOD, linewidth=1.4)
    axes.set(xlabel="runs", ylabel="one core [us a run]")


FIGURES: dict[str, tuple[Callable[[Figure], None], tuple[float, float]]] = {
    "detumble": (detumble, (9.0, 3.6)),
    "capture": (capture, (9.0, 3.6)),
    "rotor": (rotor, (6.5, 3.6)),
    "cost": (cost, (6.5, 3.2)),
    "spacecraft": (spacecraft, (9.0, 3.4)),
}


def main(names: Sequence[str]) -> None:
    for name, (draw, size) in FIGURES.items():
        if names and name not in names:
            continue
        settings = {"font.size": 9.0, "svg.hashsalt": name, "svg.fonttype": "path"}
        with style.context(["default", settings]):
            figure = Figure(figsize=size, layout="constrained")
            draw(figure)
            for axes in figure.axes:
                axes.spines[["top", "right"]].set_visible(False)
                axes.grid(color=GREY, alpha=0.25, linewidth=0.6)
            # Thousands of dots are smaller, and quicker to show, as a picture.
            figure.savefig(IMAGES / f"campaign-{name}.png", dpi=110, facecolor="white", metadata={"Software": None})


if __name__ == "__main__":
    main(sys.argv[1:])
