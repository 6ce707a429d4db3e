"""Command `tissue_sim bench BENCHMARK`: one module for each benchmark.

They import what only the extra `bench` brings (joblib, matplotlib, mujoco) inside their functions.
"""

from __future__ import annotations

import argparse
import importlib
from types import ModuleType

from tissue_sim.bench import rows
from tissue_sim.bench.arguments import check_shared
from tissue_sim.bench.printing import finish
from tissue_sim.errors import UserError
from tissue_sim.interrupts import leaving
from tissue_sim.unexpected_errors import INTERRUPTED

BENCHMARKS = {
    "tick": (
        "tissue_sim.bench.tick_times",
        "time of a tick compared with a C loop, MuJoCo flex and a precomputed compliance",
    ),
    "table1": ("tissue_sim.bench.table1", "the paper's Table 1 and Figure 6"),
    "region": ("tissue_sim.bench.region", "error of the local regions against the whole model"),
    "tradeoff": (
        "tissue_sim.bench.tradeoff",
        "run time against error, compared with finite elements, MuJoCo, XPBD, ChainMail",
    ),
    "start": ("tissue_sim.bench.start", "stages of a start up to the first tick and the node's first answer"),
    "idle": (
        "tissue_sim.bench.idle",
        "processor load of an idle node with a viewer, compared with a node that only publishes",
    ),
    "markers": (
        "tissue_sim.bench.markers",
        "processor load of markers, plain and coloured, compared with a node that only publishes them",
    ),
    "camera": (
        "tissue_sim.bench.camera",
        "late ticks of a node beside a camera, images per second, time of a picture",
    ),
    "page": ("tissue_sim.bench.page", "pictures per second that the page sends of a scene whose organs all move"),
    "latency": (
        "tissue_sim.bench.latency",
        "latency from a pose to the first wrench computed with it, compared with an echo; late ticks",
    ),
    "soak": (
        "tissue_sim.bench.soak",
        "half an hour of use: drift of the rest shape, memory, late ticks, a complete bag",
    ),
    "contact": ("tissue_sim.bench.contact", "time of a contact set with two tools in touch"),
    "pinch": ("tissue_sim.bench.pinch", "two tools compress the organ: time of a tick, inverted cells, force"),
    "grasp": ("tissue_sim.bench.grasp", "jaws at organs' poles: force at which they slip, against Coulomb's; creep"),
    "cut": (
        "tissue_sim.bench.cutting.command",
        "cuts: their time and that of the ticks around them; with --accuracy, error against finite elements",
    ),
    "blade": ("tissue_sim.bench.cutting.blade", "a blade that cuts by force: its load, energy balance and ticks"),
    "presses": ("tissue_sim.bench.presses", "tools enter fast, late or in jumps: failed presses, error of the force"),
    "haptics": (
        "tissue_sim.bench.haptics",
        "a haptic device in the loop: largest stable coupling stiffness, by pose rate and delay",
    ),
    "palpation": (
        "tissue_sim.bench.palpation.command",
        "palpation of a tumour, against nonlinear finite elements",
    ),
    "identify": (
        "tissue_sim.bench.identify.command",
        "identified stiffness: presses by finite elements of a known modulus, and measured presses",
    ),
    "breathing": ("tissue_sim.bench.breathing", "an organ whose clamp breathes, against implicit finite elements"),
    "fall": ("tissue_sim.bench.fall", "suddenly applied loads against slowly raised ones: remaining deformation"),
    "scene": (
        "tissue_sim.bench.scene_times",
        "several organs: asleep, poked, and their effect on the time of a tick",
    ),
    "measured": (
        "tissue_sim.bench.measured.command",
        "silicone bodies that others have measured, against finite elements and the real-time model",
    ),
    "batch": ("tissue_sim.bench.batch", "many copies at once: environment steps a second, beside MuJoCo's flex"),
    "stability": ("tissue_sim.bench.stability", "where each integrator and local region is stable"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command and of every benchmark."""
    benchmarks = parser.add_subparsers(dest="benchmark", metavar="BENCHMARK", required=True, parser_class=type(parser))
    for name, (module, summary) in BENCHMARKS.items():
        benchmark = benchmarks.add_parser(
            name,
            help=summary,
            description=summary[0].upper() + summary[1:] + ".",
            formatter_class=parser.formatter_class,
        )
        _load(module).add_arguments(benchmark)


def run(args: argparse.Namespace) -> int:
    """Run a benchmark; return 0, 1 when a bound that is checked was missed, 130 when it was stopped."""
    rows.begin()
    try:
        check_shared(args)
        with leaving("there is no result"):
            code = finish(_load(BENCHMARKS[args.benchmark][0]).run(args), args)
        return INTERRUPTED if rows.stopped() else code
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("tissue_sim"):
            raise
        raise UserError(f"this benchmark needs {error.name}: pip install 'tissue_sim[bench]'") from None


def _load(module: str) -> ModuleType:
    return importlib.import_module(module)
