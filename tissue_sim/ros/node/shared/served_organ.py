"""What the node serves: one organ, or those of a scene and what joins them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tissue_sim.contact.scene_file import SceneFile
from tissue_sim.errors import UserError
from tissue_sim.model.data.shapes import Shapes
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.shared.organ_topics import path_of
from tissue_sim.ros.shared.parameters import Parameters
from tissue_sim.ros.shared.physics import Physics


@dataclass(frozen=True)
class ServedOrgan:
    """An organ of the node; name: empty for a single one that no scene names."""

    name: str
    physics: Physics

    @property
    def organ(self) -> Organ:
        """The organ as it is now: with the virtual nodes of its cuts."""
        return self.physics.simulation.organ

    @property
    def below(self) -> str:
        """Prefix of its topics."""
        return path_of("~", self.name)


@dataclass(frozen=True)
class ServedScene:
    """The organs that `organ_file` or `scene_file` names, k of them.

    title: what all of it is called; names (k,), those of a scene, or one that is empty; stiffness (k,) factors on that
    of their tissue, beside the parameter's; joined: what advances them.
    """

    title: str
    names: tuple[str, ...]
    stiffness: tuple[float, ...]
    joined: Joined

    @property
    def simulations(self) -> list[Simulation]:
        """Return the simulation of each organ."""
        return self.joined.simulations

    @property
    def organs(self) -> list[Organ]:
        """The organs."""
        return [one.organ for one in self.simulations]

    @property
    def is_scene(self) -> bool:
        """Whether organs have names, and topics below these."""
        return self.names != ("",)

    @classmethod
    def of_parameters(cls, values: Parameters, shapes: Shapes) -> ServedScene:
        """Return what a node's parameters name.

        shapes: shapes of the tools. Raises UserError when something can't be used.
        """
        scene_file, organ_file = values["scene_file"], values["organ_file"]
        if scene_file and organ_file:
            raise UserError("organ_file and scene_file are both set; choose one, since a scene names its own organs")
        said = SceneFile.read(Path(scene_file)) if scene_file else None
        if said is not None:
            values.prefer("gravity", list(said.gravity))
        options = {
            "model": values["model"],
            "rate": values["rate"],
            "local_region": values["local_region"],
            "shapes": shapes,
            "integrator": values["integrator"],
            "gravity": values["gravity"],
            "shape_gravity": [0.0, 0.0, 0.0] if values["shape_is_unloaded"] else None,
        }
        if said is None:
            organ = Organ.load(Path(organ_file or shipped_organ()))
            return cls(organ.name, ("",), (1.0,), Joined([Simulation(organ, **options)]))
        simulations = [Simulation(organ, **options) for organ in said.organs]
        return cls(Path(scene_file).stem, said.names, said.stiffness, said.join(simulations))

    def apply(self, values: Parameters) -> None:
        """Write the parameters that are settings, with the scene's own factors; without the substeps."""
        for simulation, stiffness in zip(self.simulations, self.stiffness, strict=True):
            values.apply(simulation.settings)
            simulation.settings.stiffness_scale *= stiffness


def described(names: Sequence[str], organs: Sequence[Organ]) -> str:
    """Return a description of what is served, by the names of the organs."""
    if names == ("",):
        organ = organs[0]
        return f"organ '{organ.name}': {organ.n_surface} surface nodes, {organ.n_atoms} medial atoms"
    return f"organs {', '.join(names)}: {sum(organ.n_surface for organ in organs)} surface nodes"
