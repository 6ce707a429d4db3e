"""Pictures of a scene without a window: colour, depth and labels from a camera's pose, by OpenGL through EGL.

It needs no graphics processor and no display: Mesa's llvmpipe draws on the processor. One object serves one thread.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import moderngl
import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.array_types import Floats, Pixels, Singles
from tissue_sim.errors import UserError
from tissue_sim.rendering import shaders
from tissue_sim.rendering.bodies import Body, Look, checked, light_of, single
from tissue_sim.rendering.pinhole import Pinhole, inverse_of, matrix_of
from tissue_sim.rendering.tissue_texture import tissue_texture

NEAR, FAR = 0.002, 2.0  # m along the axis between which is drawn
SHADOW_SIZE = 512  # texels of a side
WIDER = 1.25  # tangent of what the light shines on, over that of the corner of the picture
TEXTURE, SHADOW = 0, 1  # units
# Names under which the libraries are installed for programs to run; without the digit they come with compilers.
GL, EGL = "libGL.so.1", "libEGL.so.1"


@dataclass(frozen=True)
class Light:
    """The light beside the lens.

    Attributes
    ----------
    offset : tuple[float, float, float], m
        Where it sits in the optical frame.
    reach : float, m
        Distance at which tissue is exposed well.
    exposure : float
        Factor on the brightness.
    wetness : float
        Factor on the highlights of moist tissue; 0: dry.
    shadows : bool
        Whether bodies cast shadows.
    wall : tuple[float, float, float]
        Colour of what lies behind everything, as light of 0 to 1.
    """

    offset: tuple[float, float, float] = (0.004, -0.007, 0.0)
    reach: float = 0.12
    exposure: float = 2.1
    wetness: float = 1.0
    shadows: bool = True
    wall: tuple[float, float, float] = (0.050, 0.014, 0.010)


class Picture(NamedTuple):
    """What a camera sees; what was not asked for is None.

    Attributes
    ----------
    colour : Pixels | None, shape (height, width, 3)
        Red, green, blue of the screen (sRGB).
    depth : Singles | None, shape (height, width), m
        Distance along the optical axis; infinite where nothing is.
    labels : Pixels | None, shape (height, width)
        Label of what is seen; 0 where nothing is.
    """

    colour: Pixels | None = None
    depth: Singles | None = None
    labels: Pixels | None = None


class Offscreen:
    """Bodies, by name, and the pictures that a camera takes of them.

    Parameters
    ----------
    lens : Pinhole
        The camera's intrinsics.
    light : Light, optional
        The light beside its lens.
    samples : int, optional
        Samples of a pixel that smooth edges in colour: 1, 2 or 4.

    Raises
    ------
    UserError
        Where OpenGL is not available.
    """

    def __init__(self, lens: Pinhole, light: Light | None = None, samples: int = 4) -> None:
        self.lens, self.light = lens, light or Light()
        # Another object may have made its own context current in this thread since: each use begins with this one.
        self._context = context = made_context()
        self._bodies: dict[str, Body] = {}
        self._lit: dict[tuple[str, ...], moderngl.Program] = {}  # by the words of the material
        self._programs = {
            "data": context.program(shaders.VERTEX, shaders.DATA),
            "shadow": context.program(shaders.SHADOW_VERTEX, shaders.SHADOW),
            "wall": context.program(shaders.WALL_VERTEX, shaders.WALL),
        }
        size = lens.width, lens.height
        self._colour = context.framebuffer([context.renderbuffer(size, 4)])
        self._drawn = context.framebuffer(
            [context.renderbuffer(size, 4, samples=_samples(samples))],
            context.depth_renderbuffer(size, samples=_samples(samples)),
        )
        self._data = context.framebuffer(
            [context.renderbuffer(size, 1, dtype="f4"), context.renderbuffer(size, 1, dtype="u1")],
            context.depth_renderbuffer(size),
        )
        self._shadow_map = context.depth_texture((SHADOW_SIZE, SHADOW_SIZE))
        self._shadow_map.compare_func = "<="
        self._shadow_map.repeat_x = self._shadow_map.repeat_y = False
        self._shadow = context.framebuffer([], self._shadow_map)
        texture = tissue_texture()
        self._texture = context.texture(texture.shape[1::-1], 4, texture.tobytes())
        self._texture.build_mipmaps()
        self._texture.filter = moderngl.LINEAR_MIPMAP_NEAREST, moderngl.LINEAR
        corners = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]], dtype=np.float32)
        self._wall = context.vertex_array(self._programs["wall"], [(context.buffer(corners), "2f", "corner")])

    def __enter__(self) -> Offscreen:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def drawn_by(self) -> str:
        """Name of what draws: a graphics processor, or llvmpipe."""
        return str(self._context.info["GL_RENDERER"])

    # bodies --------------------------------------------------------------------------------------
    def add(
        self,
        name: str,
        vertices: ArrayLike,
        triangles: ArrayLike,
        look: Look | None = None,
        fraction: ArrayLike | None = None,
    ) -> None:
        """Add a body, in place of one of the same name.

        Parameters
        ----------
        name : str
            Its name.
        vertices : ArrayLike, shape (n, 3), m
            Its vertices at rest, to which its texture sticks.
        triangles : ArrayLike, shape (t, 3)
            Corner indices, counterclockwise seen from outside.
        look : Look, optional
            How it looks.
        fraction : ArrayLike, shape (n,), optional
            1 for vertices that lie in other tissue, which have the look's inner colour, 0 for others; by default none
            does.

        Raises
        ------
        UserError
            Where they are not a surface.
        """
        shape = checked(vertices, triangles, fraction)
        self.remove(name)
        chosen = look or Look()
        with self._context:
            programs = {"lit": self._lit_by(chosen), "data": self._programs["data"], "shadow": self._programs["shadow"]}
            self._bodies[name] = Body(self._context, programs, shape, chosen)

    def move(self, name: str, vertices: ArrayLike) -> None:
        """Move a body's vertices, as it is deformed.

        Parameters
        ----------
        name : str
            Its name.
        vertices : ArrayLike, shape (n, 3), m
            The vertices.

        Raises
        ------
        UserError
            Where there is no such body, or it has another number of vertices.
        """
        with self._context:
            self._body(name).move(vertices)

    def place(self, name: str, pose: ArrayLike | None) -> None:
        """Place a rigid body, or hide it.

        Parameters
        ----------
        name : str
            Its name.
        pose : ArrayLike | None, shape (7,), m and quaternion xyzw
            Its pose; None hides it.

        Raises
        ------
        UserError
            Where there is no such body, or the pose can't be used.
        """
        body = self._body(name)
        body.is_shown = pose is not None
        if pose is not None:
            body.place = matrix_of(pose)

    def remove(self, name: str) -> None:
        """Remove a body, if there is one of that name.

        Parameters
        ----------
        name : str
            Its name.
        """
        body = self._bodies.pop(name, None)
        if body is not None:
            with self._context:
                body.release()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the bodies."""
        return tuple(self._bodies)

    # pictures ------------------------------------------------------------------------------------
    def take(self, pose: ArrayLike, colour: bool = True, depth: bool = False, labels: bool = False) -> Picture:
        """Return the picture from a pose.

        Parameters
        ----------
        pose : ArrayLike, shape (7,), m and quaternion xyzw
            Pose of the camera's optical frame: x to the right of the picture, y down, z into it.
        colour : bool, optional
            Whether to draw colours.
        depth : bool, optional
            Whether to draw distances.
        labels : bool, optional
            Whether to draw labels.

        Raises
        ------
        UserError
            For a pose that can't be used.
        """
        eye = matrix_of(pose)
        with self._context:
            drawn = self._take_colour(eye) if colour else None
            data = self._take_data(eye, depth, labels) if depth or labels else Picture()
        return data._replace(colour=drawn)

    def close(self) -> None:
        """Free the memory of the graphics processor."""
        for name in self.names:
            self.remove(name)
        self._context.release()

    # inside --------------------------------------------------------------------------------------
    def _body(self, name: str) -> Body:
        if name not in self._bodies:
            raise UserError(f"no body '{name}' was added; there are: {', '.join(self._bodies) or 'none'}")
        return self._bodies[name]

    def _shown(self) -> list[Body]:
        return [body for body in self._bodies.values() if body.is_shown]

    def _take_colour(self, eye: Floats) -> Pixels:
        view, light = inverse_of(eye), self.light
        to_shadow = self._draw_shadow(eye) if light.shadows else np.eye(4)
        for program in self._lit.values():
            self._set_light(program, to_shadow)
        self._texture.use(TEXTURE)
        self._shadow_map.use(SHADOW)
        self._drawn.use()
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._drawn.clear(depth=1.0)
        for body in self._shown():
            look, lit = body.look, self._lit_by(body.look)
            _set(lit, "to_view", single(view @ body.place))
            _set(lit, "albedo", look.light)
            _set(lit, "inner", light_of(look.inner or look.colour))
            _set(lit, "period", look.texture)
            body.draw("lit")
        self._draw_wall(eye)
        self._context.copy_framebuffer(self._colour, self._drawn)
        colours: Pixels = np.empty((self.lens.height, self.lens.width, 3), dtype=np.uint8)
        self._colour.read_into(colours, components=3, alignment=1)
        return colours

    def _lit_by(self, look: Look) -> moderngl.Program:
        """Return the program of a look, compiled when it is first used."""
        words = ["METAL"] if look.is_metal else (["TISSUE"] if look.texture > 0.0 else [])
        words += ["TINTED"] * (look.inner is not None)
        words += ["FLAT"] * look.is_flat + ["SHADOWED"] * self.light.shadows
        if (material := tuple(words)) not in self._lit:
            self._lit[material] = self._context.program(shaders.VERTEX, shaders.lit(*material))
        return self._lit[material]

    def _set_light(self, lit: moderngl.Program, to_shadow: Floats) -> None:
        """Set how the light shines, and how the lens projects, in a program."""
        light = self.light
        _set(lit, "light_at", light.offset)
        _set(lit, "reach", light.reach)
        _set(lit, "exposure", light.exposure)
        _set(lit, "wetness", light.wetness)
        _set(lit, "tissue", TEXTURE)
        _set(lit, "shadow", SHADOW)
        _set(lit, "to_clip", single(self.lens.clip(NEAR, FAR)))
        _set(lit, "to_shadow", single(to_shadow))

    def _draw_wall(self, eye: Floats) -> None:
        """Draw what lies behind everything, where nothing has been drawn."""
        wall, lens = self._programs["wall"], self.lens
        clip = lens.clip(NEAR, FAR)
        _set(wall, "lens", (-clip[0, 2], -clip[1, 2], 1.0 / clip[0, 0], 1.0 / clip[1, 1]))
        _set(wall, "to_world", single(eye[:3, :3]))
        _set(wall, "albedo", self.light.wall)
        self._wall.render(moderngl.TRIANGLE_STRIP)

    def _draw_shadow(self, eye: Floats) -> Floats:
        """Draw how far the light shines; return the matrix (4, 4) from the optical frame to the light's clip space."""
        lens = self.lens
        tangent = WIDER * max(lens.width / lens.fx, lens.height / lens.fy) * 0.5
        focal = 0.5 * SHADOW_SIZE / tangent
        middle = 0.5 * (SHADOW_SIZE - 1)
        shining = Pinhole(SHADOW_SIZE, SHADOW_SIZE, focal, focal, middle, middle)
        from_light = np.eye(4)
        from_light[:3, 3] = np.negative(self.light.offset)
        to_clip = shining.clip(NEAR, FAR) @ from_light
        view = inverse_of(eye)
        self._shadow.use()
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._shadow.clear(depth=1.0)
        shadow = self._programs["shadow"]
        for body in self._shown():
            _set(shadow, "to_clip", single(to_clip @ view @ body.place))
            body.draw("shadow")
        return to_clip

    def _take_data(self, eye: Floats, depth: bool, labels: bool) -> Picture:
        """Return distances and labels, those that are wanted."""
        view, data = inverse_of(eye), self._programs["data"]
        self._data.use()
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._data.clear(depth=1.0)
        _set(data, "to_clip", single(self.lens.clip(NEAR, FAR)))
        for body in self._shown():
            _set(data, "to_view", single(view @ body.place))
            _set(data, "label", body.look.label)
            body.draw("data")
        shape = self.lens.height, self.lens.width
        distances: Singles | None = None
        numbers: Pixels | None = None
        if depth:
            distances = np.empty(shape, dtype=np.float32)
            self._data.read_into(distances, components=1, attachment=0, dtype="f4", alignment=1)
            distances[distances == 0.0] = np.inf  # one value clears both images, and 0 is the label of nothing
        if labels:
            numbers = np.empty(shape, dtype=np.uint8)
            self._data.read_into(numbers, components=1, attachment=1, dtype="u1", alignment=1)
        return Picture(None, distances, numbers)


def made_context() -> moderngl.Context:
    """Return a context without a window.

    Raises
    ------
    UserError
        Where there is none to be had.
    """
    try:
        # moderngl declares settings as dictionaries.
        return moderngl.create_context(standalone=True, backend="egl", libgl=GL, libegl=EGL)  # type: ignore[arg-type]
    except Exception as error:  # of the loader and of the driver: there are many kinds
        raise UserError(
            f"cannot draw off-screen: {error}; install Mesa's EGL (apt install libegl1 libgl1 libgl1-mesa-dri)"
        ) from None


def _samples(wanted: int) -> int:
    """Return OpenGL's number of samples, where 0 is one."""
    if wanted not in (1, 2, 4):
        raise UserError(f"{wanted} samples of a pixel; choose 1, 2 or 4")
    return 0 if wanted == 1 else wanted


def _set(program: moderngl.Program, name: str, value: object) -> None:
    """Set a uniform, a matrix by its bytes, if the compiler has left it in the program."""
    uniform = program.get(name, None)
    if not isinstance(uniform, moderngl.Uniform):
        return
    if isinstance(value, bytes):
        uniform.write(value)
    else:
        uniform.value = value
