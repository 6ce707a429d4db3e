"""What the arguments of `tissue_sim camera` choose, checked."""

from __future__ import annotations

from dataclasses import dataclass

from tissue_sim.rendering.offscreen import Light
from tissue_sim.rendering.pinhole import Pinhole
from tissue_sim.ros.camera.topic_names import EYES


@dataclass(frozen=True)
class CameraSettings:
    """A camera, or a stereo pair.

    Attributes
    ----------
    name : str
        Its name, below which its topics are.
    frame_id : str
        Its optical frame; of a pair that of the left camera.
    lens : Pinhole
        Size and intrinsics of its pictures.
    light : Light
        The light beside it.
    rate : float, Hz
        Pictures a second.
    baseline : float, m
        From the left camera of a pair to the right one; 0 for a single camera.
    quality : int
        Quality of JPEG images, 1 to 100.
    samples : int
        Samples of a pixel that smooth edges: 1, 2 or 4.
    """

    name: str
    frame_id: str
    lens: Pinhole
    light: Light = Light()
    rate: float = 30.0
    baseline: float = 0.0
    quality: int = 90
    samples: int = 1

    @property
    def eyes(self) -> tuple[str, ...]:
        """Names of its cameras; one without a name where it is single."""
        return EYES if self.baseline > 0.0 else ("",)
