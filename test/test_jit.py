"""Where compiled kernels are kept."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import tissue_sim
from tissue_sim.jit import VERSIONS, CacheFile, cache_folder, folder_of, is_compiled

LOAD = "from tissue_sim.jit import folder_of; print(folder_of('model'))"


def test_kernels_are_kept_outside_the_package(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = cache_folder("model")
    assert folder.is_relative_to(tmp_path)
    assert not folder.is_relative_to(Path(tissue_sim.__file__).parent)
    assert folder == cache_folder("model"), "the same sources, the same folder"


def test_home_that_cannot_be_written_leaves_the_temporary_folder(monkeypatch, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    assert cache_folder("model").is_relative_to(tmp_path)


@pytest.mark.parametrize("given", [True, False])
def test_numba_cache_dir_of_the_user_comes_first(tmp_path, given):
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "home")}
    environment.pop("NUMBA_CACHE_DIR", None)
    if given:
        environment["NUMBA_CACHE_DIR"] = str(tmp_path / "mine")
    words = [sys.executable, "-c", LOAD]
    shown = subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout.strip()
    assert Path(shown).is_relative_to(tmp_path / ("mine" if given else "home"))


def test_second_process_finds_the_first_ones_kernels(tmp_path):
    """Compiled once, loaded after: no new index file appears."""
    load = "from tissue_sim.model.contact.shapes import rotation_matrix as r"
    code = f"{load}; import numpy as np; r(np.ones(4), np.zeros(9))"
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    environment.pop("NUMBA_CACHE_DIR", None)

    def kernels():
        subprocess.run([sys.executable, "-c", code], env=environment, check=True)
        return {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")}

    first = kernels()
    assert first
    assert kernels() == first


@pytest.mark.extended
def test_what_two_processes_need_at_once_is_compiled_by_one(tmp_path):
    """The second waits for the first, and loads what that has compiled."""
    code = (
        "import numba.core.event as events, numpy as np;"
        "seen = events.RecordingListener(); events.register('numba:compile', seen);"
        "from tissue_sim.model.contact.shapes import rotation_matrix as r;"
        "input('ready'); r(np.ones(4), np.zeros(9));"
        "print(sum(each.data['dispatcher'] is r for _, each in seen.buffer if each.is_start))"
    )
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    environment.pop("NUMBA_CACHE_DIR", None)
    both = [
        subprocess.Popen([sys.executable, "-c", code], env=environment, text=True, stdin=-1, stdout=-1)
        for _ in range(2)
    ]
    for child in both:
        assert child.stdout.read(len("ready")) == "ready"
    for child in both:
        child.stdin.write("\n")
        child.stdin.flush()
    assert sorted(int(child.communicate()[0]) for child in both) == [0, 1]


def test_a_version_is_never_loaded_for_other_types(tmp_path):
    """Not even by one who reads while another writes, or beside one who came with an older stamp or an older index."""
    CacheFile(str(tmp_path), "kernel", "older").save("integers", "code for integers")
    seen = []

    class Watched(CacheFile):
        def _save_index(self, overloads):
            super()._save_index(overloads)
            seen.append(CacheFile(str(tmp_path), "kernel", "new").load("floats"))

    Watched(str(tmp_path), "kernel", "new").save("floats", "code for floats")
    assert seen == ["code for floats"]

    class Late(CacheFile):
        def _load_index(self):
            before = super()._load_index()
            CacheFile(str(tmp_path), "kernel", "new").save("bytes", "code for bytes")
            return before

    Late(str(tmp_path), "kernel", "new").save("longs", "code for longs")
    CacheFile(str(tmp_path), "kernels", "new").save("another", "kernel's code")
    last = CacheFile(str(tmp_path), "kernel", "new")
    last.save("more", "code for more")
    there = {path.name for path in tmp_path.glob("kernel.*.nbc")}
    assert there <= set(last._load_index().values()), "nothing is left that no index names"
    assert CacheFile(str(tmp_path), "kernels", "new").load("another") == "kernel's code"
    for key in ("floats", "bytes", "longs"):
        assert last.load(key) in (f"code for {key}", None)


def test_all_that_is_cached_is_compiled_once():
    """Numba's own cache is not safe where several processes share it."""
    package = Path(tissue_sim.__file__).parent
    assert not [path for path in package.rglob("*.py") if "cache=True" in path.read_text()]


def test_versions_used_longest_ago_go_where_a_new_one_comes(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    kept = tmp_path / "tissue_sim"
    for age in range(VERSIONS + 2):
        (kept / f"model-numba-0-{age}" / "kernels").mkdir(parents=True)
        os.utime(kept / f"model-numba-0-{age}", (1e9 - age, 1e9 - age))
    (kept / "organ-numba-0-0").mkdir()
    folder = cache_folder("model")
    left = {path.name for path in kept.iterdir()}
    assert left == {folder.name, "organ-numba-0-0"} | {f"model-numba-0-{age}" for age in range(VERSIONS - 1)}
    os.utime(folder, (1.0, 1.0))
    assert cache_folder("model") == folder
    assert folder.stat().st_mtime > 1e9, "used now"


def test_each_layer_has_a_folder_of_its_own():
    """A change in the organ's pipeline doesn't compile the tick again."""
    assert folder_of("organ") != folder_of("model") or os.environ.get("NUMBA_CACHE_DIR")


def test_kernels_that_call_the_models_are_compiled_again_when_those_change(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("tissue_sim.jit.__file__", str(tmp_path / "jit.py"))
    for own in ("jit.py", "handles.py"):
        (tmp_path / own).write_text("")
    layers = ("organ", "model", "contact", "calibration", "bench")
    for layer in layers:
        (tmp_path / layer).mkdir()
    before = {layer: cache_folder(layer) for layer in layers}
    (tmp_path / "model" / "forces.py").write_text("@kernel")
    changed = {layer for layer in layers if cache_folder(layer) != before[layer]}
    assert changed == set(layers) - {"organ"}


@pytest.mark.parametrize("source", ["class Settings(Record):", "class Integrator(IntEnum):"])
def test_a_change_of_records_and_enumerations_compiles_kernels_again(monkeypatch, tmp_path, source):
    """An enumeration is a constant in the kernels that name it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("tissue_sim.jit.__file__", str(tmp_path / "jit.py"))
    for own in ("jit.py", "handles.py"):
        (tmp_path / own).write_text("")
    (tmp_path / "model").mkdir()
    before = cache_folder("model")
    (tmp_path / "model" / "settings.py").write_text(source)
    assert cache_folder("model") != before


def test_tick_counts_as_compiled_once_its_index_is_there(monkeypatch, tmp_path):
    monkeypatch.setattr("tissue_sim.jit._chosen", {"model": str(tmp_path)})
    assert not is_compiled()
    (tmp_path / "model_1").mkdir()
    (tmp_path / "model_1" / "tick.tick-7.py312.nbi").write_bytes(b"")
    assert is_compiled()
