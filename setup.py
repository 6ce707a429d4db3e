"""Installation of tissue_sim as a ROS 2 (ament_python) package and as a plain Python package."""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = "tissue_sim"
HERE = Path(__file__).resolve().parent


def version() -> str:
    """Version named in tissue_sim/version.py, read without importing the package."""
    text = (HERE / NAME / "version.py").read_text(encoding="utf-8")
    return re.search(r'^__version__ = "(.+)"$', text, re.MULTILINE).group(1)


def share_files(*folders: str) -> list[tuple[str, list[str]]]:
    """Return every file under the folders, as data_files that keep their place below share/tissue_sim."""
    installed: dict[str, list[str]] = {}
    for folder in folders:
        for path in sorted((HERE / folder).rglob("*")):
            local = path.relative_to(HERE)
            if path.is_file() and not any(part == "__pycache__" or part.startswith(".") for part in local.parts):
                installed.setdefault(f"share/{NAME}/{local.parent.as_posix()}", []).append(local.as_posix())
    return list(installed.items())


setup(
    name=NAME,
    version=version(),
    description="A real-time deformable organ for haptics, served over ROS 2",
    long_description="A ROS 2 node that simulates a deformable organ, made from a CT, for haptic devices.",
    long_description_content_type="text/plain",
    maintainer="tissue_sim maintainers",
    maintainer_email="tissue_sim@users.noreply.github.com",
    license="Apache-2.0",
    python_requires=">=3.12",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    # So that an editable installation adds this folder to the path: its finder would lose to any folder of the name
    # tissue_sim, such as that of a checkout beside a user's script.
    package_dir={"": "."},
    # py.typed: type checkers read the annotations (PEP 561).
    package_data={NAME: ["py.typed", "organ/reporting/*.jinja", "identification/*.jinja"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *share_files("launch", "config"),
    ],
    # False: Numba writes its cache beside the kernels, and the organs are opened as files.
    zip_safe=False,
    # No ROS package here: with an apt installation they come from rosdep, with PyPI alone from the extra "ros".
    # Least versions: package.xml has the same. lz4 comes with rosbags, and so has no entry there.
    install_requires=[
        *("numpy>=1.26.4", "scipy>=1.11.4", "numba>=0.59.1"),
        *("trimesh", "python-fcl", "rosbags", "lz4", "ruamel.yaml", "tqdm"),
    ],
    extras_require={
        "ros": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
        "image": ["SimpleITK", "scikit-image", "matplotlib", "jinja2", "nibabel", "highdicom", "pydicom", "meshio"],
        "viewer": ["viser", "websockets", "msgspec", "zstandard"],  # all but the first come with it
        "camera": ["moderngl", "pillow"],
        "instruments": ["fast-simplification"],
        "calibration": ["scikit-fem", "netgen-mesher", "matplotlib", "joblib", "threadpoolctl"],
        "bench": ["matplotlib", "joblib", "mujoco", "pypbd"],
        "cluster": ["distributed"],
        "learn": ["gymnasium>=1.1", "cma", "matplotlib"],
        # `colcon test` runs pytest because this extra names it.
        "test": ["hypothesis", "mcap", "pytest", "pytest-timeout", "pytest-xdist", "ruff", "mypy", "pip-audit"],
        "docs": ["sphinx", "myst-parser", "furo", "sphinx-autoapi"],
        "colcon": ["colcon-common-extensions"],
    },
    entry_points={
        "console_scripts": [
            "tissue_node = tissue_sim.ros.node.program:run",
            "tissue_sim = tissue_sim.cli:main",
        ],
    },
)
