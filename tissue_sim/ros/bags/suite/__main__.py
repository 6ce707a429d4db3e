"""Record the bags of the suite again, all or the named ones, and summarise them; `make bags` runs it."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags.recording import Recording
from tissue_sim.ros.bags.suite.record import record
from tissue_sim.ros.bags.suite.scenes import SCENES
from tissue_sim.ros.bags.suite.small_kidney import make_small_kidney
from tissue_sim.ros.bags.suite.summary import as_text, figures
from tissue_sim.ros.shared.domains import chosen_graph
from tissue_sim.unexpected_errors import catch_all

SUMMARY = "summary.txt"


def main(argv: list[str] | None = None) -> int:
    """Record scenes into a folder; return the exit code."""
    names = [scene.name for scene in SCENES]
    parser = argparse.ArgumentParser(prog="python -m tissue_sim.ros.bags.suite", description=__doc__)
    parser.add_argument(
        "scenes", nargs="*", metavar="SCENE", help=f"scenes to record, of {', '.join(names)} (default: all)"
    )
    parser.add_argument("--folder", type=Path, default=Path("bags"), help="folder of the bags (default: %(default)s)")
    parser.add_argument("--organ", type=Path, help="organ file to record with, instead of a small kidney")
    args = parser.parse_args(argv)
    for name in args.scenes:
        if name not in names:
            parser.error(f"'{name}' is not a scene; choose from {', '.join(names)}")
    try:
        _record_all(args.folder, args.scenes or names, args.organ)
    except (UserError, OSError) as error:
        print(f"suite: error: {error}", file=sys.stderr)
        return 2
    return 0


def _record_all(folder: Path, names: list[str], organ_file: Path | None) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    before = _parts(folder / SUMMARY)
    path = organ_file or folder / "small_kidney.npz"
    try:
        if organ_file is None:
            print("making the small kidney", flush=True)
            make_small_kidney().save(path)
        organ = Organ.load(path)
        with chosen_graph(os.environ):
            for scene in SCENES:
                if scene.name in names:
                    refused = record(scene, organ, path, folder / scene.name)
                    found = figures(Recording.read(folder / scene.name), refused)
                    before[scene.name] = as_text({scene.name: (scene.what, found)})
                    print(before[scene.name], flush=True)
    finally:
        if organ_file is None:
            path.unlink(missing_ok=True)  # each bag holds it
    kept = [before[scene.name] for scene in SCENES if scene.name in before]
    (folder / SUMMARY).write_text("\n".join(kept))


def _parts(path: Path) -> dict[str, str]:
    """Return the existing summary, by scene."""
    parts = path.read_text().split("\n\n") if path.is_file() else []
    return {part.partition(":")[0]: part.rstrip("\n") + "\n" for part in parts if part.strip()}


if __name__ == "__main__":
    catch_all("suite", "scenes that were recorded stay in their folders; the summary is as it was")
    sys.exit(main())
