"""Benchmark `tissue_sim bench palpation`: a finger over a tumour; force against depth beside finite elements.

A rigid sphere is pressed in over each inclusion, and doesn't slip; so are neo-Hookean finite elements of the same
shape, with the inclusion and without. Then it is pressed in at every node around: a map of the stiffness under a
finger.
"""

from __future__ import annotations

import argparse
from functools import partial

from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.palpation import finger
from tissue_sim.bench.palpation.plot import drawn
from tissue_sim.bench.printing import Result
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

DEFAULT = "kidney_tumour"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_shared(
        parser, organ="the kidney with a tumour of this package", out="folder for a plot of curves and map", check=True
    )
    places = parser.add_argument_group(
        "spheres at nodes, on edges and inside triangles, and sliding, instead of a finger"
    )
    places.add_argument(
        "--places",
        type=int,
        metavar="N",
        help="press spheres at this number of flat points of ORGAN, which needs no inclusion (default: the kidney"
        " of this package)",
    )
    places.add_argument(
        "--radii",
        metavar="R,...",
        help="radii of the spheres, in mean edges of the surface (default: 0.5,0.8,1,1.5,2,3)",
    )
    places.add_argument(
        "--slab",
        action="store_true",
        help="press a slab of 60 x 60 x 25 mm, which is built and calibrated once, in four minutes",
    )


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    if args.places is not None:
        from tissue_sim.bench.palpation import balls

        return balls.run(args)
    if args.radii is not None or args.slab:
        raise UserError("--radii and --slab need --places N")
    organ = Organ.load(args.organ or shipped_organ(DEFAULT))
    pressed = finger.measure(organ)
    maps = finger.measure_maps(organ, pressed)
    found = finger.as_json(pressed, maps)
    names = ["palpation.png"] if len(pressed) == 1 else [f"palpation_{number}.png" for number in range(len(pressed))]
    pairs = zip(names, pressed, maps, strict=True)
    pictures = {} if rows.stopped() else {name: partial(drawn, organ, one, around) for name, one, around in pairs}
    return Result(found, finger.text(organ, found), pictures)
