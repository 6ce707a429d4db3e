"""Parameters of the stages of the segmentation."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from tissue_sim.errors import UserError


def _option[T: float | None](default: T, unit: str, text: str, bounds: tuple[float, float]) -> T:
    """Return a field with its metadata, which type checkers take for its default."""
    return field(default=default, metadata={"unit": unit, "help": text, "range": bounds})


@dataclass(frozen=True)
class SegmentationParameters:
    """Parameters of the stages of the segmentation; None: determined from the image.

    Every field's metadata holds its unit, a line of help and its range.

    Raises
    ------
    UserError
        Where a value is out of range; the message names the field as on the command line.
    """

    smoothing: float | None = _option(
        None, "mm", "standard deviation of the Gaussian filter of the compared intensities; by default 2.5 or 3,"
            " until the tissue at the seed is homogeneous", (0.1, 10.0),
    )  # fmt: skip
    wall_smoothing: float = _option(
        0.6, "mm", "standard deviation of the Gaussian filter before the wall is located", (0.1, 10.0)
    )
    window: float | None = _option(
        None, "SD", "half-width of the intensity window, in deviations of the tissue at the seed; by default that of"
            " several whose region has the clearest wall and shape", (0.5, 50.0),
    )  # fmt: skip
    least_deviation: float = _option(3.0, "HU", "lower bound of the tissue's standard deviation", (0.1, 100.0))
    seed_radius: float = _option(
        7.0, "mm", "radius of the ball whose intensities define the initial window", (1.0, 50.0)
    )
    erosion: float | None = _option(None, "mm", "erosion depth; by default until the organ is separate", (0.01, 100.0))
    neck: float = _option(
        0.6, "fraction", "a neck below this fraction of the smaller lobe's depth separates organs", (0.0, 1.0)
    )
    stop: float = _option(0.5, "fraction", "fraction of the eroded region after which the front stops", (0.01, 1.0))
    dilation: float | None = _option(
        None,
        "mm",
        "largest dilation of the eroded organ; by default the erosion plus three smoothings",
        (0.0, 100.0),
    )
    stiffness: float = _option(
        0.5, "times", "weight of the image relative to a small wall area during dilation", (0.01, 100.0)
    )
    spur: float = _option(3.0, "mm", "vessels and spurs below this radius are removed", (0.0, 50.0))
    closing: float = _option(6.0, "mm", "cavities below this radius are filled, except those of fat", (0.0, 50.0))
    grid: float | None = _option(
        None, "mm", "spacing of the working grid; by default half the image's coarsest, 1 to 1.5", (0.3, 10.0)
    )

    def __post_init__(self) -> None:
        for entry in fields(self):
            value, (low, high) = getattr(self, entry.name), entry.metadata["range"]
            if value is not None and not low <= value <= high:
                name = "--" + entry.name.replace("_", "-")
                raise UserError(f"{name} {value:g} must lie within {low:g}..{high:g} {entry.metadata['unit']}")
