"""An organ as viser draws it in a browser, its camera and its light; without ROS."""

from __future__ import annotations

from collections import deque

import numpy as np
import viser

from tissue_sim.array_types import Floats, Longs
from tissue_sim.rendering.appearance import shade_of, shades, tissue_colour
from tissue_sim.rendering.coloured_surface import ColouredSurface, light_of

FIELD_OF_VIEW = np.radians(35.0)
VIEW = np.array([0.55, -1.0, 0.3])  # from the organ to the camera: from the front, the side and above
PANEL, NARROW = 350, 600  # pixels, width of the panel; width of a page up to which it lies below
FILLED, FITTED = 0.8, 6  # fraction of the room filled by the surface; rounds of fitting the camera to it
LABEL_GAP = 0.01  # m from an organ to its name
LATER = 2  # turns from when a surface is sent to when it is shown, in which a browser has to read it


def picture_axes() -> tuple[Floats, Floats, Floats]:
    """Return the unit vectors (3,) of the first picture: to the right, up, and from the organ to the camera."""
    away = VIEW / np.linalg.norm(VIEW)
    right = np.cross([0.0, 0.0, 1.0], away)
    right /= np.linalg.norm(right)
    return right, np.cross(away, right), away


def camera_for(vertices: Floats, size: tuple[int, int] = (1400, 900)) -> tuple[Floats, Floats]:
    """Return where the camera stands and what it looks at so that a surface fills the page beside the panel.

    Parameters
    ----------
    vertices : Floats, shape (n, 3), m
        Points of the surface.
    size : tuple[int, int], pixels, optional
        Width and height of the page.

    Returns
    -------
    tuple[Floats, Floats]
        position and looked_at, shape (3,), m each
    """
    width, height = size
    panel = PANEL if width > NARROW else 0  # on a narrow page it lies below
    focal = 0.5 * height / np.tan(0.5 * FIELD_OF_VIEW)  # pixels
    room = FILLED * np.array([width - panel, height])
    right, up, away = picture_axes()
    picture = np.stack([right, up])
    centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    distance = 4.0 * float(np.linalg.norm(vertices - centre, axis=1).max())
    for _ in range(FITTED):
        offset = vertices - centre
        seen = focal * (offset @ picture.T) / (distance - offset @ away)[:, None]  # pixels from the middle
        low, high = seen.min(axis=0), seen.max(axis=0)
        centre = centre + 0.5 * (low + high) * distance / focal @ picture
        distance *= float(((high - low) / room).max())
    # The panel is on the right, so the surface is in the middle of the room at its left.
    looked_at = centre + 0.5 * panel / focal * distance * right
    return looked_at + distance * away, looked_at


def label_place(own: Floats, others: Floats) -> Floats:
    """Return where an organ's name is seen from the first camera, beside the organ and not behind another one.

    Parameters
    ----------
    own : Floats, shape (n, 3), m
        Surface of the organ.
    others : Floats, shape (n, 3), m
        Surfaces of all others.

    Returns
    -------
    Floats, shape (3,), m
        The place above the organ, unless it is hidden there, else below or at its sides.
    """
    right, up, away = picture_axes()
    picture = np.stack([right, up])
    seen, near = others @ picture.T, others @ away
    places = [own[np.argmax(own @ direction)] + LABEL_GAP * direction for direction in (up, -up, -right, right)]

    def is_hidden(place: Floats) -> bool:
        beside = np.linalg.norm(seen - picture @ place, axis=1) < 2.0 * LABEL_GAP
        return bool((near[beside] > place @ away).any())

    return next((place for place in places if not is_hidden(place)), places[0])


def light(server: viser.ViserServer) -> None:
    """Light the picture from the camera's side, so that the colours look like the legend's.

    Parameters
    ----------
    server : viser.ViserServer
        The viser server.
    """
    scene = server.scene
    scene.configure_default_lights(False)
    scene.configure_environment_map("studio", environment_intensity=0.25)
    scene.add_light_hemisphere("/lights/sky", sky_color=(255, 250, 245), ground_color=(190, 170, 165), intensity=1.2)
    for name, direction, strength in (("key", (-0.9, -1.0, 1.2), 2.2), ("fill", (1.0, -0.6, -0.2), 0.7)):
        scene.add_light_directional(f"/lights/{name}", position=direction, intensity=strength, cast_shadow=False)


class OrganView:
    """A deforming surface, coloured by displacement: vertices at rest (n, 3) m, triangles (t, 3); name: in a scene.

    rest, triangles: the surface. A browser doesn't draw a surface while it reads it. Therefore there are several
    copies, of which one is visible: new positions are sent to a hidden one, which is shown LATER turns afterwards. A
    browser that takes up to LATER turns at once has read it by then, and nothing flickers.
    """

    def __init__(self, server: viser.ViserServer, vertices: Floats, triangles: Longs, name: str = "") -> None:
        below = f"/organ/{name}" if name else "/organ"
        self._is_carried = bool(name)
        self.rest, self.triangles = np.asarray(vertices, dtype=np.float64), triangles
        self._shades = light_of(shades(tissue_colour(name)))
        self._opacity = 1.0
        self._surface = ColouredSurface(self.rest, triangles)
        first = self._surface.message(self.rest, np.tile(self._shades[0], (len(self.rest), 1)))
        self._seen, *hidden = (
            server.scene.add_glb(f"{below}/{k}", first, visible=k == 0, cast_shadow=False, receive_shadow=False)
            for k in range(LATER + 1)
        )
        self._hidden, self._turns = hidden, 0
        self._sent: deque[tuple[int, viser.GlbHandle]] = deque()  # the turn at which each is shown, and the surface
        # A name behind another organ must not look like that one's.
        self._label = (
            server.scene.add_label(f"{below}/name", name, position=label_place(self.rest, self.rest), depth_test=True)
            if name
            else None
        )

    def name_beside(self, others: Floats) -> None:
        """Move the organ's name to where other surfaces don't hide it.

        Parameters
        ----------
        others : Floats, shape (n, 3), m
            Points of these surfaces.
        """
        if self._label is not None:
            self._label.position = label_place(self.rest, others)

    def turn(self) -> None:
        """Show what was drawn LATER turns ago."""
        self._turns += 1
        while self._sent and self._sent[0][0] <= self._turns:
            _, new = self._sent.popleft()
            new.visible, self._seen.visible = True, False
            self._hidden.append(self._seen)
            self._seen = new

    def show(self, positions: Floats, eye: Floats | None = None) -> None:
        """Draw the surface, to be seen LATER turns from now on; once a turn.

        Parameters
        ----------
        positions : (n, 3) m
        eye : (3,) m, who looks from there; what shines through a translucent fold is right for that eye
        """
        moved = positions - self.rest
        if self._is_carried:  # by the breath: as most of it is
            moved = moved - np.median(moved, axis=0)
        new = self._hidden.pop(0)
        new.glb_data = self._surface.message(positions, shade_of(moved, self._shades), eye)
        self._sent.append((self._turns + LATER, new))

    def set_opacity(self, opacity: float) -> bool:
        """Let what is within show through; return whether it has to be drawn again for that.

        Parameters
        ----------
        opacity : float
            1 hides it.
        """
        if opacity == self._opacity:
            return False
        self._opacity, self._surface = opacity, ColouredSurface(self.rest, self.triangles, opacity)
        return True

    def remove(self) -> None:
        """Remove it from the picture."""
        for one in (self._seen, *self._hidden, *(surface for _, surface in self._sent)):
            one.remove()
        if self._label is not None:
            self._label.remove()
