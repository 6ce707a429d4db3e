"""Makes a ROS interface package of message and service definitions, by rosidl's own generators and the C compiler.

They come with the ROS wheels; ament_cmake, which usually runs them, does not.
"""

from __future__ import annotations

import contextlib
import functools
import io
import os
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

SUPPORT = "rosidl_typesupport_c"
MIDDLEWARE = "rosidl_typesupport_fastrtps_c"
# What the definitions name, and the services themselves.
NEEDED = ("geometry_msgs", "std_msgs", "builtin_interfaces", "service_msgs")
KINDS = ("rosidl_generator_c", "rosidl_generator_py", MIDDLEWARE, SUPPORT)
RUNTIME = ("rosidl_runtime_c", MIDDLEWARE, "rosidl_typesupport_fastrtps_cpp", SUPPORT, "rcutils", "rmw", "fastcdr")


def make_interfaces(definitions: Path, folder: Path) -> None:
    """Make the package that is called like the folder of its definitions, ready to be imported from `folder`."""
    package = folder / definitions.name
    with _as_in_a_workspace():
        _generate(definitions, folder / "idl", package)
    (package / "__init__.py").touch()
    _build(package)


@contextlib.contextmanager
def _as_in_a_workspace():
    before = os.environ.get("AMENT_PREFIX_PATH")
    os.environ["AMENT_PREFIX_PATH"] = sys.prefix
    try:
        yield
    finally:
        del os.environ["AMENT_PREFIX_PATH"]
        if before is not None:
            os.environ["AMENT_PREFIX_PATH"] = before


def _generate(definitions: Path, idl: Path, package: Path) -> None:
    import rosidl_pycommon
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_adapter.srv import convert_srv_to_idl
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport

    files = []
    for path in sorted(definitions.glob("*/*.*")):
        convert = {".msg": convert_msg_to_idl, ".srv": convert_srv_to_idl}[path.suffix]
        with contextlib.redirect_stdout(io.StringIO()):
            convert(definitions, definitions.name, path.relative_to(definitions), idl / path.parent.name)
        files.append(f"{idl}:{path.parent.name}/{path.stem}.idl")
    parse = rosidl_pycommon.parse_idl_file
    rosidl_pycommon.parse_idl_file = functools.cache(parse)  # which takes most of the time, in each of the generators
    try:
        for generator in (
            GeneratePython("py", typesupport_implementations=[SUPPORT]),
            GenerateC("c"),
            GenerateFastRTPSCTypesupport("fastrtps_c"),
            GenerateCTypesupport("c", typesupport_implementations=[MIDDLEWARE]),
        ):
            generator.generate(definitions.name, files, [str(Path(sys.prefix, "share"))], package)
    finally:
        rosidl_pycommon.parse_idl_file = parse


def _build(package: Path) -> None:
    """One library of all, which Python loads for its types."""
    sources: list[Sequence[Path]] = [[path] for path in sorted(package.rglob("*__description.c"))]
    for pattern in ("*__functions.c", "*__type_support.c", "_*_s.c", "*.ep.*.c", "*__type_support_c.cpp"):
        sources.append(sorted(package.rglob(pattern)))
    sources.append(sorted(package.rglob("*__type_support.cpp")))
    include = Path(sys.prefix, "include")
    folders = [package.parent, include, *(path for path in include.iterdir() if path.is_dir())]
    folders += [Path(sysconfig.get_path("include")), Path(np.get_include())]
    flags = ["-O0", "-fPIC", "-w", *(f"-I{path}" for path in folders)]

    def compiled(numbered: tuple[int, Sequence[Path]]) -> str:
        number, paths = numbered
        unit = package.parent / f"unit_{number}{paths[0].suffix}"  # of many files at once, which takes less time
        unit.write_text("".join(f'#include "{path}"\n' for path in paths))
        made = unit.with_suffix(".o")
        _run("g++" if unit.suffix == ".cpp" else "gcc", *flags, "-c", str(unit), "-o", str(made))
        return str(made)

    with ThreadPoolExecutor(2) as pool:
        objects = list(pool.map(compiled, enumerate(sources)))
    lib = Path(sys.prefix, "lib")
    wanted = [f"{needed}__{kind}" for needed in NEEDED for kind in KINDS]
    libraries = [str(next(lib.glob(f"lib{name}.so*"))) for name in (*wanted, *RUNTIME)]
    made = package / f"{package.name}_s__{SUPPORT}.so"
    _run("g++", "-shared", *objects, "-o", str(made), *libraries, f"-Wl,-rpath,{lib}")


def _run(*command: str) -> None:
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(command[:1])}: {done.stderr[-2000:]}"
