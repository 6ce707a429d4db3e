"""The scene that ships: its organs are there, fitted, and hang on each other."""

from pathlib import Path

from tissue_sim.contact.scene_file import SceneFile
from tissue_sim.organ.shipped import shipped_file


def test_the_abdomen_that_ships_is_whole():
    path = shipped_file("config/scenes/abdomen.yaml")
    assert path is not None
    scene = SceneFile.read(Path(path))
    assert list(scene.names) == ["liver", "kidney_left", "kidney_right", "spleen"]
    assert len(scene.attachments) == 3
    for organ in scene.organs:
        assert organ.n_surface == 994
        assert "calibration" in organ.provenance, organ.name
