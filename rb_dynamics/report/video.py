"""Video of the motion, without a display: the body with its vectors, and its ellipsoid rolling on the plane.

GIF needs matplotlib; MP4 also needs ffmpeg, from the system or from the package imageio-ffmpeg. A run shorter than 5 s
is slowed down to that, one longer than 20 s is sped up, and the picture shows the speed. Attitudes between samples are
interpolated.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.track import Array, Motion, Track, motion_of
from rb_dynamics.body.inertia_quantities import equivalent_box
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import LogError, needing
from rb_dynamics.formats.output_file import make_folder, renamed
from rb_dynamics.numerics.rotation import matrix
from rb_dynamics.numerics.rotation_arrays import rotate_all
from rb_dynamics.report.plots import continuous
from rb_dynamics.report.poinsot_figure import outline
from rb_dynamics.sinks.picture_style import BLUE, CYAN, EYE, GREEN, ORANGE, RED, YELLOW, Eye, eye_above
from rb_dynamics.theory.poinsot_contact import DISC, Contact, contact, half_axes, separatrices

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

RATE = 25
# Length of the head of an arrow.
_HEAD = 0.14
SHORTEST_S, LONGEST_S = 5.0, 20.0
FORMATS = (".mp4", ".gif")

# A smaller relative change of the angular momentum from sample to sample is rounding.
_CONSTANT = 1e-9
# A curve is drawn with no more points; and arrows whose directions differ by less (rad) side by side, so far apart.
_CURVE_POINTS, _PARALLEL, _BESIDE = 1500, 0.12, 0.07
_FREE = "Poinsot: the ellipsoid of inertia rolls on the invariable plane"
_DRIVEN = "A torque acts: no plane is invariable"
_NOT_TOLD = "The ellipsoid of inertia on the plane perpendicular to L"

_SIZE = (960, 540)
_PAGE, _TEXT, _GREY = "#12161c", "#e4e8ee", "#8a94a3"
# The colours of the Rerun viewer, so that one description fits both.
_ARMS = tuple("#{:02x}{:02x}{:02x}".format(*color) for color in (RED, GREEN, BLUE))
_L, _W, _POLHODE, _HERPOLHODE = ("#{:02x}{:02x}{:02x}".format(*color) for color in (ORANGE, CYAN, GREEN, YELLOW))


def require_format(path: str | os.PathLike[str]) -> None:
    """Raise a LogError for a path whose ending names no format of a video."""
    if Path(path).suffix.lower() not in FORMATS:
        expected = f"a file name that ends in {' or '.join(FORMATS)}"
        raise LogError(f"found {os.fspath(path)!r}, expected {expected}; give another")


def write_video(
    path: str | os.PathLike[str], track: Track, rate: int = RATE, progress: Callable[[float], None] | None = None
) -> int:
    """Write the motion as .mp4 or .gif and return the number of frames; missing folders are created.

    Args:
        path: the output file; its ending selects the format.
        track: the motion.
        rate: pictures per second.
        progress: called with the fraction done.

    Raises:
        LogError: the motion or the mass properties are unknown, or the file cannot be written.
        MissingExtraError: matplotlib or ffmpeg is not installed.
    """
    target = Path(path)
    require_format(target)
    motion = _seen(track)
    make_folder(target)
    write = _write_gif if target.suffix.lower() == ".gif" else _write_mp4
    try:
        with renamed(target) as part:
            part.open("wb").close()  # a path that cannot be written fails before the work
            count = write(part, _frames(motion, rate, progress), rate)
    except OSError as error:
        raise LogError(f"cannot write {target}: {error.strerror or error}; give a file that can be written") from error
    return count


@dataclass(frozen=True)
class _Seen:
    """Attitude and rate of a body over time, with the points of contact of Poinsot's construction.

    Attributes:
        since: for each sample, the first one from which on no torque acted; the one after it while a torque acts.
        told: whether the recording shows that no torque acts.
    """

    body: RigidBody
    time_s: Array
    attitude: Array
    rates: Array
    touch: Contact
    since: NDArray[np.intp]
    told: bool

    def at(self, time_s: float) -> tuple[int, Array, Array]:
        """Return the sample before `time_s`, and attitude and angular velocity (body axes) there."""
        row = min(max(int(np.searchsorted(self.time_s, time_s, side="right")) - 1, 0), len(self.time_s) - 2)
        part = (time_s - self.time_s[row]) / (self.time_s[row + 1] - self.time_s[row])
        attitude = (1.0 - part) * self.attitude[row] + part * self.attitude[row + 1]
        rate = (1.0 - part) * self.rates[row] + part * self.rates[row + 1]
        return row, attitude / np.linalg.norm(attitude), rate


def _seen(track: Track) -> _Seen:
    pose, twist, body = track.pose, track.twist, track.body
    if pose is None or twist is None or body is None or body.is_particle:
        raise LogError(
            f"{track.bag.path}: a video shows how a body turns, which needs pose, twist and mass properties with an "
            "inertia; give a scene with --scene SCENE where the recording has none"
        )
    motion = motion_of(pose, twist, track.twist_in_world)
    if len(motion.time_ns) < 2:
        raise LogError(f"{track.bag.path}: pose and twist share {len(motion.time_ns)} stamps, expected at least 2")
    attitude, rates = continuous(motion.orientation_xyzw), motion.angular_velocity_body
    rows = np.arange(len(attitude))
    turned = _torque(track, motion, body)
    since = np.maximum.accumulate(np.where(turned, rows + 1, 0))
    touch = contact(body, attitude, rates)
    return _Seen(body, track.seconds(motion.time_ns), attitude, rates, touch, since, track.own or track.acted)


def _torque(track: Track, motion: Motion, body: RigidBody) -> NDArray[np.bool_]:
    """Return for each sample whether a torque acts from there on: as recorded, else as the angular momentum shows."""
    if track.own and not track.acted:
        momentum = rotate_all(motion.orientation_xyzw, motion.angular_velocity_body @ np.array(body.inertia))
        change = np.linalg.norm(np.diff(momentum, axis=0, append=momentum[-1:]), axis=1)
        shown: NDArray[np.bool_] = change > _CONSTANT * np.linalg.norm(momentum, axis=1).max(initial=0.0)
        return shown
    acts = np.zeros(len(motion.time_ns), dtype=np.bool_)
    for steps in track.acting:
        if len(steps.time_ns):
            row = np.searchsorted(steps.time_ns, motion.time_ns, side="right") - 1
            acts |= (row >= 0) & (steps.torque.any(axis=1) | ~steps.known)[row]
    return acts


def _frames(motion: _Seen, rate: int, progress: Callable[[float], None] | None) -> Iterator[bytes]:
    """Yield the RGBA pictures."""
    with needing("matplotlib", "video", "a video"):
        from matplotlib import style
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    start, end = float(motion.time_s[0]), float(motion.time_s[-1])
    seconds = min(max(end - start, SHORTEST_S), LONGEST_S)
    with style.context("default"):
        figure = Figure(figsize=(_SIZE[0] / 100.0, _SIZE[1] / 100.0), dpi=100, facecolor=_PAGE)
        scenes = (_Body(figure, motion), _Rolling(figure, motion))
        clock = figure.text(0.02, 0.03, "", color=_TEXT, fontsize=11, animated=True)
        canvas = FigureCanvasAgg(figure)
        moving = [part for axes in figure.axes for part in _parts(axes)]
        # Text takes most of the time: what does not move is drawn once for each title.
        still: dict[str, Any] = {}
        for time_s in np.linspace(start, end, round(seconds * rate)).tolist():
            for scene in scenes:
                scene.show(time_s)
            clock.set_text(f"t = {time_s:.3f} s    speed ×{(end - start) / seconds:.3g}")
            title = figure.axes[-1].get_title()
            if title not in still:
                canvas.draw()  # type: ignore[no-untyped-call, unused-ignore]
                still[title] = canvas.copy_from_bbox(figure.bbox)  # type: ignore[no-untyped-call, unused-ignore]
            canvas.restore_region(still[title])  # type: ignore[no-untyped-call, unused-ignore]
            for part in (*moving, clock):
                figure.draw_artist(part)
            yield bytes(canvas.buffer_rgba())  # type: ignore[no-untyped-call, unused-ignore]
            if progress is not None:
                progress((time_s - start) / (end - start))


def _parts(axes: Axes) -> list[Artist]:
    """Return what moves in a picture, from the back to the front, marked as such."""
    found: list[Artist] = [*axes.collections, *axes.patches, *axes.lines, *axes.texts]
    for part in found:
        part.set_animated(True)
    return sorted(found, key=lambda part: part.get_zorder())


def _axes(figure: Figure, place: int, reach: float, title: str) -> Axes:
    axes = figure.add_axes((0.5 * place, 0.08, 0.5, 0.82))
    axes.set_axis_off()
    axes.set_aspect("equal")
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    axes.set_title(title, color=_TEXT, fontsize=11)
    return axes


def _screen(view: Eye) -> Array:
    """Return (3, 2): right and up direction of a picture."""
    toward = np.array(view.position) / np.linalg.norm(view.position)
    right = np.cross(view.up, toward)
    right /= np.linalg.norm(right)
    axes: Array = np.column_stack([right, np.cross(toward, right)])
    return axes


def _line(axes: Axes, color: str, width: float = 1.5) -> Line2D:
    (line,) = axes.plot([], [], color=color, linewidth=width, solid_capstyle="round")
    return line


class _Arrow:
    """An arrow from the middle with a head and a letter."""

    def __init__(self, axes: Axes, color: str, letter: str) -> None:
        from matplotlib.patches import Polygon

        self._shaft = _line(axes, color, 2.5)
        self._head = Polygon(np.zeros((3, 2)), facecolor=color, edgecolor=color, zorder=3)
        axes.add_patch(self._head)
        self._letter = axes.text(0.0, 0.0, letter, color=color, fontsize=12, ha="center", va="center", zorder=4)

    def show(self, tip: Array, beside: float = 0.0) -> None:
        """Point to `tip`, (2,), moved aside by `beside`; a vector of no length is not shown."""
        length = float(np.linalg.norm(tip))
        along = tip / length if length > 0.0 else np.zeros(2)
        across = np.array([-along[1], along[0]])
        aside = beside * across
        neck = max(length - _HEAD, 0.0) * along
        self._shaft.set_data(*np.stack([aside, aside + neck]).T)
        wide = min(_HEAD, length) * 0.4 * across
        self._head.set_xy(np.stack([aside + tip, aside + neck + wide, aside + neck - wide]))
        x, y = (aside + tip + 0.13 * along).tolist()
        self._letter.set_position((x, y))
        self._letter.set_visible(length > 0.0)


def _beside(momentum: Array, rate: Array) -> float:
    """Return how far aside the angular velocity is to be drawn so that a parallel momentum does not cover it."""
    sizes = float(np.linalg.norm(momentum) * np.linalg.norm(rate))
    if sizes == 0.0:
        return 0.0
    cross, dot = momentum[0] * rate[1] - momentum[1] * rate[0], momentum @ rate
    angle = float(np.arctan2(cross, dot))
    return float(np.copysign(_BESIDE, angle)) if abs(angle) < _PARALLEL else 0.0


class _Body:
    """A box with the inertia of the body, its axes, and the directions of L and of the angular velocity."""

    def __init__(self, figure: Figure, motion: _Seen) -> None:
        from matplotlib.collections import PolyCollection

        axes = _axes(figure, 0, 1.9, "The body, with L and ω")
        self._motion, self._screen = motion, _screen(EYE)
        self._toward = np.array(EYE.position) / np.linalg.norm(EYE.position)
        half, size = equivalent_box(motion.body)
        principal = np.array(matrix(motion.body.principal_orientation_xyzw))
        # Faces as (6, 4, 3) corners and (6, 3) normals, body axes.
        self._faces = np.array([_corners(axis, side) for axis in range(3) for side in (-1, 1)]) * half / size
        self._faces = self._faces @ principal.T
        self._normals = np.repeat(np.eye(3), 2, axis=0) * np.tile([[-1.0], [1.0]], (3, 1)) @ principal.T
        self._skin = PolyCollection([], edgecolors=_TEXT, linewidths=0.8)
        axes.add_collection(self._skin)
        self._arms = [_Arrow(axes, color, name) for color, name in zip(_ARMS, "xyz", strict=True)]
        self._momentum, self._rate = _Arrow(axes, _L, "L"), _Arrow(axes, _W, "ω")

    def show(self, time_s: float) -> None:
        _, attitude, rate = self._motion.at(time_s)
        normals = rotate_all(attitude, self._normals)
        # In a convex body, the faces towards the viewer hide all others.
        seen = np.flatnonzero(normals @ self._toward > 0.0)
        self._skin.set_verts(list(rotate_all(attitude, self._faces[seen]) @ self._screen))
        shade = 0.30 + 0.35 * (normals[seen] @ self._toward)
        self._skin.set_facecolor([(0.85 * light, 0.95 * light, 1.1 * light) for light in shade])
        for arm, axis in zip(self._arms, np.eye(3), strict=True):
            arm.show(1.25 * rotate_all(attitude, axis) @ self._screen)
        touch = contact(self._motion.body, attitude[None], rate[None])
        momentum = np.nan_to_num(1.6 * touch.normal[0]) @ self._screen
        largest = float(np.linalg.norm(self._motion.rates, axis=1).max())
        turning = 1.45 / largest * rotate_all(attitude, rate) @ self._screen if largest else np.zeros(2)
        self._momentum.show(momentum)
        self._rate.show(turning, _beside(momentum, turning))


class _Rolling:
    """The ellipsoid of inertia on the invariable plane, with the parts of both curves drawn so far."""

    def __init__(self, figure: Figure, motion: _Seen) -> None:
        from matplotlib.patches import Polygon

        axes = self._axes = _axes(figure, 1, 1.6, _FREE)
        turning = np.flatnonzero(np.isfinite(motion.touch.distance))
        x, y, z = motion.touch.normal[turning[0]].tolist() if len(turning) else (0.0, 0.0, -1.0)
        self._motion, self._screen = motion, _screen(eye_above((x, y, z)))
        self._principal = np.array(matrix(motion.body.principal_orientation_xyzw))
        self._half, self._lines = np.array(half_axes(motion.body)), separatrices(motion.body)
        self._disc = Polygon(np.zeros((3, 2)), facecolor="#333d4a", edgecolor=_GREY)
        self._ball = Polygon(np.zeros((3, 2)), facecolor="#3b6bb0", edgecolor="#8fb6ee", alpha=0.6)
        axes.add_patch(self._disc)
        self._herpolhode = _line(axes, _HERPOLHODE, 1.2)
        axes.add_patch(self._ball)
        self._grey = [_line(axes, _GREY, 0.8) for _ in self._lines]
        self._polhode = _line(axes, _POLHODE, 1.5)
        self._momentum, self._rate = _Arrow(axes, _L, "L"), _Arrow(axes, _W, "ω")

    def show(self, time_s: float) -> None:
        row, attitude, rate = self._motion.at(time_s)
        touch, drawn = contact(self._motion.body, attitude[None], rate[None]), self._motion.touch
        if not np.isfinite(touch.distance[0]):
            return
        since = int(self._motion.since[row])
        driven = since > row
        self._axes.set_title(_DRIVEN if driven else _FREE if self._motion.told else _NOT_TOLD, color=_TEXT, fontsize=11)
        for part in (self._disc, self._herpolhode, self._polhode):
            part.set_visible(not driven)
        angle = np.linspace(0.0, 2.0 * np.pi, 91)
        first = np.cross(touch.normal[0], np.eye(3)[int(np.abs(touch.normal[0]).argmin())])
        first /= np.linalg.norm(first)
        around = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), np.cross(touch.normal[0], first))
        self._disc.set_xy((touch.normal[0] * touch.distance[0] + DISC * around) @ self._screen)
        turn = np.array([rotate_all(attitude, axis) for axis in np.eye(3)])  # rows: body axes in the world
        self._ball.set_xy(outline(self._half, self._principal.T @ turn @ self._screen))
        for line, curve in zip(self._grey, self._lines, strict=True):
            line.set_data(*(curve @ turn @ self._screen).T)
        rows = slice(since, row + 1, 1 + max(0, row - since) // _CURVE_POINTS)
        self._polhode.set_data(*(np.vstack([drawn.body[rows], touch.body]) @ turn @ self._screen).T)
        self._herpolhode.set_data(*(np.vstack([drawn.world[rows], touch.world]) @ self._screen).T)
        momentum, turning = 1.4 * touch.normal[0] @ self._screen, touch.world[0] @ self._screen
        # The tip of the angular velocity is where they touch: the momentum makes room.
        self._momentum.show(momentum, -_beside(momentum, turning))
        self._rate.show(turning)


def _corners(axis: int, side: int) -> Array:
    """Return the corners of one face of the cube from -1 to 1, in cyclic order."""
    face = np.empty((4, 3))
    face[:, axis] = side
    face[:, axis - 1], face[:, axis - 2] = (-1, -1, 1, 1), (-1, 1, 1, -1)
    return face


def _write_gif(target: Path, frames: Iterable[bytes], rate: int) -> int:
    from PIL import Image

    # The octree keeps the colours of thin lines, which the median cut replaces by shades of large faces.
    octree = Image.Quantize.FASTOCTREE
    pictures = [Image.frombytes("RGBA", _SIZE, frame).convert("RGB").quantize(128, octree) for frame in frames]
    pictures[0].save(target, save_all=True, append_images=pictures[1:], duration=1000 // rate, loop=0, optimize=False)
    return len(pictures)


def _write_mp4(target: Path, frames: Iterable[bytes], rate: int) -> int:
    size = f"{_SIZE[0]}x{_SIZE[1]}"
    source = ["-f", "rawvideo", "-pix_fmt", "rgba", "-s", size, "-r", str(rate), "-i", "-"]
    # yuv420p can be shown by every player; with faststart a browser can begin before the download ends.
    coded = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-movflags", "+faststart", str(target)]
    command = [_ffmpeg(), "-y", "-loglevel", "error", *source, *coded]
    count = 0
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as coder:
        assert coder.stdin is not None
        assert coder.stderr is not None
        try:
            for frame in frames:
                coder.stdin.write(frame)
                count += 1
            coder.stdin.close()
        except BrokenPipeError:
            pass
        said = coder.stderr.read().decode(errors="replace").strip()
    if coder.returncode:
        raise LogError(f"cannot write {target}: ffmpeg says {said!r}; a .gif needs no ffmpeg")
    return count


def _ffmpeg() -> str:
    if program := shutil.which("ffmpeg"):
        return program
    with needing("imageio-ffmpeg", "video", "an .mp4 (a .gif needs only matplotlib)"):
        from imageio_ffmpeg import get_ffmpeg_exe
    return str(get_ffmpeg_exe())
