"""Command `tissue_sim abdomen`: a scene of liver, kidneys and spleen, from synthetic shapes or masks of a CT."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from ruamel.yaml import YAML
from scipy.spatial import cKDTree

from tissue_sim.calibration.stiffness import Settings
from tissue_sim.commands.calibrate_many import calibrate_many
from tissue_sim.contact.scene_file import FORMAT, SceneFile
from tissue_sim.errors import UserError
from tissue_sim.interrupts import leaving
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.build_record import Progress
from tissue_sim.organ.organ import Organ
from tissue_sim.outputs import make_folder
from tissue_sim.progress import steps

if TYPE_CHECKING:
    from tissue_sim.organ.imaging.image import Volume

NAME = "abdomen"
BREATHS, DISPLACEMENT = 15.0, (0.0, 0.0, -0.015)  # per minute; m that the liver moves: z points to the head
LIGAMENT = 0.004  # m beyond the nearest nodes of two organs, up to which a ligament joins them
FALCIFORM = 0.02  # m in front of the liver, where it is attached to the wall
ENDINGS = (".nii.gz", ".nii", ".nrrd", ".mha")


class Part(NamedTuple):
    """Organ of the scene.

    Attributes
    ----------
    name : str
        Name as of the masks of a CT.
    fixed : str
        Where the wall holds it, as for select_fixed.
    youngs_modulus : float
        Young's modulus, Pa.
    breathes : float
        Motion with the breath relative to the liver's.
    """

    name: str
    fixed: str
    youngs_modulus: float
    breathes: float


# Organs are held by the diaphragm above and the wall behind. A kidney moves about two thirds as far as the liver.
PARTS = (
    Part("liver", "z>0.9", 6_000.0, 1.0),
    Part("kidney_left", "y>0.9", 10_000.0, 0.7),
    Part("kidney_right", "y>0.9", 10_000.0, 0.7),
    Part("spleen", "y>0.9", 8_000.0, 0.9),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "--masks",
        metavar="FOLDER",
        help=f"masks of one CT, {', '.join(part.name for part in PARTS)} with {', '.join(ENDINGS)}; default: synthetic",
    )
    parser.add_argument("--out", default=".", metavar="FOLDER", help=f"folder for {NAME}.yaml and its organs")
    parser.add_argument("--points", type=int, default=994, help="points of each organ's surface")
    parser.add_argument("--as-built", action="store_true", help="don't calibrate the organs against finite elements")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="number of organs calibrated at once")


def run(args: argparse.Namespace) -> int:
    """Build the organs, fit them, write the scene, and return 0. Raises UserError."""
    try:
        return _run(args)
    except ModuleNotFoundError as error:
        raise UserError(f"building organs needs {error.name}; pip install 'tissue_sim[image,calibration]'") from None


def _run(args: argparse.Namespace) -> int:
    from tissue_sim.organ.pipeline import organ_from_mask
    from tissue_sim.organ.request import Request
    from tissue_sim.organ.surfaces.balloon import check_points

    check_points(args.points)
    if args.jobs < 1:
        raise UserError(f"--jobs {args.jobs} is less than 1")
    masks = _masks(Path(args.masks) if args.masks else None)
    folder = Path(args.out) / NAME
    make_folder(folder)
    source = "masks of a CT" if args.masks else "synthetic abdomen"
    again = "" if args.as_built else ", and the same command calibrates the others"
    with (
        tempfile.TemporaryDirectory(prefix="tissue_sim-") as spare,
        leaving(f"organs that are ready stay in {folder}{again}"),
    ):
        built = folder if args.as_built else Path(spare)
        files = [built / f"{part.name}.npz" for part in PARTS]
        for part, file in steps(zip(PARTS, files, strict=True), "organs", len(PARTS)):
            request = Request(
                name=part.name,
                points=args.points,
                fixed=part.fixed,
                youngs_modulus=part.youngs_modulus,
                provenance={"source": source},
            )
            print(f"{part.name}:")
            organ_from_mask(masks[part.name], request, Progress(print)).save(file)
        if not args.as_built:
            found = calibrate_many(files, [folder / file.name for file in files], Settings(), args.jobs, None)
            if failed := [f"{name}: {why}" for name, why in found.items() if isinstance(why, str)]:
                raise UserError(failed[0])
    path = Path(args.out) / f"{NAME}.yaml"
    write_scene({part.name: Organ.load(folder / f"{part.name}.npz") for part in PARTS}, path, source)
    SceneFile.read(path)  # a file that can't be read is reported at once
    print(f"{path}: {len(PARTS)} organs; 'tissue_sim info {path}' describes it")
    return 0


def _masks(folder: Path | None) -> Mapping[str, Volume]:
    if folder is None:
        from tissue_sim.organ.imaging.abdomen import make_abdomen

        return make_abdomen()
    from tissue_sim.organ.imaging.masks import read_mask

    return {part.name: read_mask(_mask_file(folder, part.name)) for part in PARTS}


def _mask_file(folder: Path, name: str) -> Path:
    found = next((folder / f"{name}{end}" for end in ENDINGS if (folder / f"{name}{end}").is_file()), None)
    if found is None:
        raise UserError(f"folder {folder} has no mask {name} ({', '.join(ENDINGS)})")
    return found


# the scene ------------------------------------------------------------------------------------------


def write_scene(organs: Mapping[str, Organ], path: Path, source: str) -> None:
    """Write the scene's file: the organs' ligaments to each other and to the wall, and how they breathe.

    Raises UserError when it can't be written.
    """
    liver = organs["liver"].surface_positions
    front = liver[np.argmin(liver[:, 1])] - [0.0, FALCIFORM, 0.0]  # y points to the back
    said = {
        "format": FORMAT,
        "organs": [{"name": part.name, "file": f"{NAME}/{part.name}.npz", "breathes": part.breathes} for part in PARTS],
        "attachments": [
            _ligament("liver", "kidney_right", organs),
            _ligament("spleen", "kidney_left", organs),
            {
                "of": "liver",
                "point": [round(float(value), 4) for value in front],
                "within": round(1.5 * FALCIFORM, 4),
                "stiffness": 20.0,
                "damping": 0.1,
                "moves": 0.0,
            },
        ],
        "breathing": {"rate": BREATHS, "way": list(DISPLACEMENT)},
    }
    yaml = YAML()
    yaml.default_flow_style = None  # lists of numbers in one line
    try:
        with path.open("w", encoding="utf-8") as file:
            file.write(f"# Written by 'tissue_sim abdomen' from {source}: the patient's frame, x to the left, y to the")
            file.write(" back, z to the head.\n")
            yaml.dump(said, file)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from None


def _ligament(one: str, other: str, organs: Mapping[str, Organ]) -> JsonObject:
    apart = cKDTree(organs[other].surface_positions).query(organs[one].surface_positions)[0].min()
    within = round(float(apart) + LIGAMENT, 4)
    return {"between": [one, other], "within": within, "stiffness": 10.0, "damping": 0.05}
