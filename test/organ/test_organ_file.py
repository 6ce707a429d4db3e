"""The organ file: what comes back, and what is refused."""

import json
import shutil
import zipfile
from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh

from helpers.scenes import RADIUS, ball, kidney
from tissue_sim.errors import UserError
from tissue_sim.organ.inclusions import Inclusion, with_inclusions
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.organ_file import SCHEMA_VERSION, content_digest
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.organ.surface_checks import check_surface, signed_volume
from tissue_sim.organ.topology import assemble_like, assemble_organ

ARRAYS = [item.name for item in fields(Organ) if "dtype" in item.metadata]


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "ball.npz"
    ball().save(file)
    return file


def rewrite(path, **changes):
    """Write the file's arrays again with some replaced (or dropped: None), its checksum as it was."""
    with np.load(path) as stored:
        content = {key: stored[key] for key in stored.files}
    content |= changes
    np.savez_compressed(path, **{key: value for key, value in content.items() if value is not None})


@pytest.fixture
def full(tmp_path):
    """A file that holds every array."""
    made = trimesh.creation.icosphere(1, 0.2 * RADIUS)
    organ = with_inclusions(ball(), [Inclusion(np.asarray(made.vertices), made.faces.astype(np.int32), 5.0)])
    arrays = {name: np.append(getattr(organ, name), 1e-6) for name in ("mass", "damping", "return_stiffness")}
    organ = replace(organ, virtual_of=[3], **arrays)
    file = tmp_path / "full.npz"
    organ.save(file)
    return file


def test_organ_comes_back_as_it_was(path):
    organ, back = ball(), Organ.load(path)
    for name in ARRAYS:
        array = getattr(back, name)
        np.testing.assert_array_equal(array, getattr(organ, name))
        assert array.dtype == getattr(organ, name).dtype
    for name in ("name", "youngs_modulus", "poisson_ratio", "density", "provenance"):
        assert getattr(back, name) == getattr(organ, name)
    assert back.digest() == organ.digest()


def test_a_law_comes_back_and_only_then_the_file_needs_the_newest_schema(path):
    organ = replace(ball(), stiffening=8.0, cell_stiffening=1.7, relaxation_fraction=0.3, relaxation_time=1.5)
    assert ball().schema_version < organ.schema_version == SCHEMA_VERSION
    assert (
        len({replace(organ, **change).digest() for change in ({}, {"stiffening": 9.0}, {"relaxation_time": 2.0})}) == 3
    )
    assert organ.digest() != ball().digest() == Organ.load(path).digest()
    organ.save(path)
    back = Organ.load(path)
    law = ("stiffening", "cell_stiffening", "relaxation_fraction", "relaxation_time")
    assert [getattr(back, name) for name in law] == [8.0, 1.7, 0.3, 1.5]
    assert back.digest() == organ.digest()
    like = assemble_like(back, name="like")
    assert (like.stiffening, like.relaxation_fraction, like.relaxation_time) == (8.0, 0.3, 1.5)


@pytest.mark.parametrize("value", [float("inf"), "8,0", None, 1e3])
def test_a_damaged_law_is_refused(path, value):
    replace(ball(), stiffening=8.0).save(path)
    with np.load(path) as stored:
        content = {key: stored[key] for key in stored.files}
    text = json.dumps(json.loads(str(content.pop("header"))) | {"stiffening": value}, sort_keys=True)
    del content["sha256"]
    np.savez_compressed(path, header=np.array(text), sha256=np.array(content_digest(text, content)), **content)
    with pytest.raises(UserError, match=r"damaged header; build it again|stiffening 1000 is outside 0..100"):
        Organ.load(path)


@pytest.mark.parametrize(("hardening", "read"), [(0.0, True), (1.6, False)])
def test_a_file_of_version_3_is_read_unless_its_springs_harden(path, hardening, read):
    with np.load(path) as stored:
        content = {key: stored[key] for key in stored.files if key != "sha256" and not key.startswith("cell_")}
    header = json.loads(str(content.pop("header"))) | {"schema_version": 3, "hardening": hardening}
    text = json.dumps(header, sort_keys=True)
    np.savez_compressed(path, header=np.array(text), sha256=np.array(content_digest(text, content)), **content)
    if read:
        assert Organ.load(path).digest() == ball().digest()
        return
    with pytest.raises(UserError, match="calibrated with hardening springs"):
        Organ.load(path)


def test_a_file_of_version_2_has_springs_of_equation_1(path):
    with np.load(path) as stored:
        content = {key: stored[key] for key in stored.files if key != "sha256" and not key.startswith("cell_")}
    header = json.loads(str(content.pop("header"))) | {"schema_version": 2}
    text = json.dumps(header, sort_keys=True)
    np.savez_compressed(path, header=np.array(text), sha256=np.array(content_digest(text, content)), **content)
    assert Organ.load(path).digest() == ball().digest()


def test_same_organ_gives_the_same_bytes(path, tmp_path):
    Organ.load(path).save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == path.read_bytes()


def test_digest_tells_organs_apart():
    heavier = replace(ball(), mass=np.nextafter(ball().mass, 1.0))
    assert heavier.digest() != ball().digest()


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_are_read_only(path, name):
    for organ in (ball(), Organ.load(path)):
        array = getattr(organ, name)
        assert not array.flags.writeable
        if array.size:
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0


def test_organ_keeps_no_hold_on_what_it_was_made_from():
    mine = np.array(ball().mass)
    organ = replace(ball(), mass=mine)
    mine[0] = 7.0
    assert organ.mass[0] == ball().mass[0]
    with pytest.raises(AttributeError):
        organ.mass = mine


# refused files ---------------------------------------------------------------------------------
def refused(path, match):
    with pytest.raises(UserError, match=match) as caught:
        Organ.load(path)
    assert path.name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file_is_refused(tmp_path):
    refused(tmp_path / "none.npz", "does not exist.*tissue_sim build")


def test_folder_is_refused(tmp_path):
    folder = tmp_path / "folder.npz"
    folder.mkdir()
    refused(folder, "folder")


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_truncated_file_is_refused(path, share):
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    refused(path, "damaged" if share else "is empty")


@pytest.mark.parametrize("name", ARRAYS)
def test_altered_array_is_refused(full, name):
    """A byte flipped inside an array, in a zip whose own checksums are right again."""
    with np.load(full) as stored:
        array = stored[name]
    if array.size:
        array.view(np.uint8).flat[array.nbytes // 2] ^= 1
    else:
        array = array.astype(array.dtype.newbyteorder())
    rewrite(full, **{name: array})
    refused(full, "altered.*checksum")


def test_altered_header_is_refused(path):
    with np.load(path) as stored:
        header = json.loads(str(stored["header"]))
    header["youngs_modulus"] *= 2.0
    rewrite(path, header=np.array(json.dumps(header, sort_keys=True)))
    refused(path, "altered.*checksum")


@pytest.mark.parametrize("header", ["", "{", "[]", "{}", '{"schema_version": "new"}', '{"schema_version": null}'])
def test_damaged_header_is_refused(path, header):
    rewrite(path, header=np.array(header))
    refused(path, "header")


def test_future_schema_is_refused_with_the_remedy(path):
    with np.load(path) as stored:
        header = json.loads(str(stored["header"]))
    header["schema_version"] = SCHEMA_VERSION + 1
    rewrite(path, header=np.array(json.dumps(header)))
    refused(path, f"schema version {SCHEMA_VERSION + 1}.*update tissue_sim")


def test_a_file_of_version_1_is_read_and_its_checksum_held(path):
    """Before interior atoms: no interior_spoke."""
    with np.load(path) as stored:
        content = {key: stored[key] for key in stored.files if key not in ("interior_spoke", "sha256")}
    content = {key: array for key, array in content.items() if not key.startswith("cell_")}
    header = json.loads(str(content.pop("header"))) | {"schema_version": 1}
    text = json.dumps(header, sort_keys=True)
    np.savez_compressed(path, header=np.array(text), sha256=np.array(content_digest(text, content)), **content)
    organ = Organ.load(path)
    assert organ.n_interior == 0
    assert organ.digest() == ball().digest()
    content["mass"] = content["mass"] * 1.1
    np.savez_compressed(path, header=np.array(text), sha256=np.array("0" * 64), **content)
    refused(path, "altered.*checksum")


def test_pickle_inside_is_refused_and_not_run(path, tmp_path):
    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "sprung"), "w"))

    rewrite(path, mass=np.array([Trap()], dtype=object))
    refused(path, "damaged")
    assert not (tmp_path / "sprung").exists()


def test_missing_and_unknown_arrays_are_named(path):
    rewrite(path, mass=None, colour=np.zeros(3))
    refused(path, "colour, mass")


def test_other_npz_is_refused(path):
    np.savez(path, positions=np.zeros((3, 3)))
    refused(path, "not an organ file")


def write_text(path):
    path.write_text("an organ\n")


def write_array(path):
    with path.open("wb") as stream:
        np.save(stream, np.zeros(3))


def write_zip(path):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "no array")


@pytest.mark.parametrize("write", [write_text, write_array, write_zip])
def test_what_is_no_npz_is_refused(path, write):
    write(path)
    refused(path, "organ file")


@pytest.mark.parametrize(("in_directory", "before"), [(80, 40), pytest.param(300, 200, marks=pytest.mark.extended)])
def test_no_single_damaged_byte_gives_a_traceback_or_another_organ(path, tmp_path, in_directory, before):
    whole, digest = path.read_bytes(), ball().digest()
    random, damaged = np.random.default_rng(0), tmp_path / "damaged.npz"
    # Everywhere in the directory at the end, where lengths, flags and methods stand, and here and there before.
    directory = whole.index(b"PK\x01\x02")
    places = [*random.integers(directory, len(whole), in_directory), *random.integers(0, directory, before)]
    surprises = set()
    for place in places:
        altered = bytearray(whole)
        altered[place] ^= 1 << random.integers(8)
        damaged.write_bytes(altered)
        try:
            assert Organ.load(damaged).digest() == digest
        except UserError as error:
            if "damaged.npz" not in str(error):
                surprises.add(f"unnamed: {error}")
        except Exception as error:
            surprises.add(f"{type(error).__name__}: {error}")
    assert not surprises


def test_organ_that_cannot_be_written_is_reported(tmp_path):
    with pytest.raises(UserError, match=r"cannot write organ file .*ball\.npz"):
        ball().save(tmp_path / "missing" / "ball.npz")


# refused organs --------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass": ball().mass[:-1]}, "mass|damping"),
        ({"mass": 0.0 * ball().mass}, "mass must be greater than 0"),
        ({"mass": ball().mass * np.nan}, "mass contains values that are not finite"),
        ({"damping": -ball().damping}, "damping must not be negative"),
        ({"return_stiffness": -ball().return_stiffness}, "return_stiffness must not be negative"),
        ({"spring_stiffness": -ball().spring_stiffness}, "spring_stiffness must not be negative"),
        ({"angular_stiffness": -ball().angular_stiffness}, "angular_stiffness must not be negative"),
        ({"spring_rest_length": 0.0 * ball().spring_rest_length}, "spring_rest_length must be greater than 0"),
        ({"atom_radius": -ball().atom_radius}, "atom_radius must be greater than 0"),
        ({"spring_nodes": ball().spring_nodes + 1}, "spring_nodes names a node outside 0..46"),
        ({"spring_nodes": ball().spring_nodes - 1}, "spring_nodes names a node outside"),
        ({"angular_nodes": ball().angular_nodes + 20}, "angular_nodes names a node outside"),
        ({"fixed": [42]}, "fixed names a node outside 0..41"),
        ({"surface_triangles": ball().surface_triangles + 1}, "surface_triangles names a node outside"),
        ({"atom_parent": [-1, 2, 1, 2, 3]}, "atom_parent"),
        ({"atom_parent": [-2, 0, 1, 2, 3]}, "atom_parent"),
        ({"surface_positions": ball().surface_positions.ravel()}, "surface_positions must have 2 dimensions"),
        ({"surface_positions": ball().surface_positions[:, :2]}, "surface_positions has shape"),
        ({"spring_kind": ball().spring_kind[:3]}, "spring_kind has shape"),
    ],
)
def test_arrays_that_do_not_fit_are_named(changes, message):
    with pytest.raises(UserError, match=message):
        replace(ball(), **changes)


def test_open_surface_is_refused():
    with pytest.raises(UserError, match=r"open \(3 open edges\)"):
        replace(ball(), surface_triangles=ball().surface_triangles[1:])


def test_inverted_surface_is_refused():
    with pytest.raises(UserError, match="inverted"):
        replace(ball(), surface_triangles=ball().surface_triangles[:, ::-1])


def test_triangle_wound_the_wrong_way_is_refused():
    triangles = ball().surface_triangles.copy()
    triangles[5] = triangles[5, ::-1]
    with pytest.raises(UserError, match="wound inconsistently"):
        replace(ball(), surface_triangles=triangles)


def test_edge_of_four_triangles_is_refused():
    """Two tetrahedra that share an edge."""
    one = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    both = np.concatenate([one, np.array([0, 1, 4, 5])[one]])
    # The second one lies across the shared edge, mirrored in both directions beside it.
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, -1]], dtype=float)
    assert signed_volume(points, one) > 0.0
    assert signed_volume(points, both) > signed_volume(points, one)
    with pytest.raises(UserError, match="test"):
        check_surface(points, both, "test")


def test_triangle_that_occurs_twice_is_refused():
    triangles = np.concatenate([ball().surface_triangles, ball().surface_triangles])
    with pytest.raises(UserError, match="ball"):
        replace(ball(), surface_triangles=triangles)


def test_point_of_no_triangle_is_refused():
    with pytest.raises(UserError, match="1 surface points belong to no triangle"):
        check_surface(np.vstack([ball().surface_positions, [[0.0, 0.0, 0.0]]]), ball().surface_triangles, "test")


def test_surface_without_triangles_is_refused():
    with pytest.raises(UserError, match="no triangles"):
        check_surface(ball().surface_positions, np.zeros((0, 3), dtype=np.int32), "test")


def test_two_surfaces_are_refused():
    mesh = trimesh.creation.icosphere(1, RADIUS)
    apart = mesh.copy()
    apart.apply_translation([3.0 * RADIUS, 0.0, 0.0])
    two = trimesh.util.concatenate([mesh, apart])
    with pytest.raises(UserError, match="two"):
        assemble_organ(
            name="two",
            surface_positions=two.vertices,
            surface_triangles=two.faces,
            atom_positions=[[0.0, 0.0, 0.0]],
            atom_radius=[RADIUS],
            atom_parent=[-1],
        )


# sizes -----------------------------------------------------------------------------------------
def test_volume_is_the_enclosed_one():
    box = trimesh.creation.box((0.02, 0.03, 0.05))
    assert signed_volume(np.asarray(box.vertices) + 7.0, box.faces) == pytest.approx(0.02 * 0.03 * 0.05, rel=1e-6)
    assert ball(3).volume == pytest.approx(4.0 / 3.0 * np.pi * RADIUS**3, rel=0.02)


def test_nodes_are_surface_then_atoms_then_interior():
    interior = np.array([[0.001, 0.002, 0.003]])
    organ = ball()
    with_interior = replace(
        organ,
        interior_positions=interior,
        interior_spoke=[[2, 7]],
        mass=np.append(organ.mass, 1e-3),
        damping=np.append(organ.damping, 0.1),
        return_stiffness=np.append(organ.return_stiffness, 0.0),
    )
    assert with_interior.n_nodes == 48
    expected = np.concatenate([organ.surface_positions, organ.atom_positions, interior])
    np.testing.assert_array_equal(with_interior.rest_positions, expected)


# shipped ---------------------------------------------------------------------------------------
def test_shipped_kidney_loads():
    assert kidney().name == "kidney"
    assert kidney().volume == pytest.approx(1.33e-4, rel=0.1)


def test_organ_that_does_not_ship_is_refused():
    with pytest.raises(UserError, match=r"organ 'spleen' is not part .*tissue_sim build"):
        shipped_organ("spleen")


def test_shipped_organ_is_found_in_a_ros_prefix(tmp_path, monkeypatch):
    share = tmp_path / "share" / "tissue_sim" / "config" / "organs"
    share.mkdir(parents=True)
    shutil.copy(shipped_organ(), share / "liver.npz")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    assert shipped_organ("liver") == share / "liver.npz"
    assert shipped_organ().parent != share
