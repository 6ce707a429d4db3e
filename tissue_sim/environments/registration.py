"""Names under which Gymnasium makes the environments."""

from __future__ import annotations

NAMES = {
    "Press": 200,
    "Palpate": 300,
    "Retract": 300,
    "Hold": 300,
    "Cut": 300,
}  # and their longest episodes, steps of 20 ms
PREFIX = "tissue_sim/"


def register_all() -> None:
    """Register what isn't registered yet."""
    import gymnasium

    for name, steps in NAMES.items():
        identifier = f"{PREFIX}{name}-v0"
        if identifier not in gymnasium.registry:
            gymnasium.register(
                id=identifier,
                entry_point="tissue_sim.environments.single:TissueEnv",
                vector_entry_point="tissue_sim.environments.vector:TissueVectorEnv",
                kwargs={"task": name},
                max_episode_steps=steps,
            )
