"""What stands for viser in tests: what is in its picture, by name."""

import numpy as np
import trimesh


class Handle:
    """What viser gives for something in the picture."""

    def __init__(self, **given):
        self.__dict__.update(given)
        self.removed = False

    def remove(self):
        self.removed = True


class Server:
    """Keeps what is in the picture, by name."""

    def __init__(self):
        self.drawn, self.scene = {}, self

    def add_glb(self, name, glb_data, **given):
        return self.drawn.setdefault(name, Handle(glb_data=glb_data, **given))

    def add_mesh_simple(self, name, vertices, faces, **given):
        return self.drawn.setdefault(name, Handle(vertices=vertices, faces=faces, **given))

    def add_label(self, name, text, **given):
        return self.drawn.setdefault(name, Handle(text=text, **given))

    def add_line_segments(self, name, points, colors, **given):
        return self.drawn.setdefault(name, Handle(points=points, **given))

    def seen(self):
        """The surface that is seen."""
        (one,) = (handle for name, handle in self.drawn.items() if "/organ" in name and getattr(handle, "visible", 0))
        loaded = trimesh.load(trimesh.util.wrap_as_stream(one.glb_data), file_type="glb", process=False)
        (mesh,) = loaded.geometry.values()
        return np.asarray(mesh.vertices), np.asarray(mesh.visual.vertex_attributes["color"])[:, :3]
