"""The pins: renewed from an index, checked by an advisory service. Both are local here, pip and pip-audit are real."""

import json
import os
import re
import runpy
import shutil
import socket
import subprocess
import sys
import threading
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

pytestmark = pytest.mark.extended

ROOT = Path(__file__).resolve().parents[1]
PINS = runpy.run_path(str(ROOT / ".ci/pins"))
AUDIT = runpy.run_path(str(ROOT / ".ci/audit"))
TEXT = (ROOT / "constraints.txt").read_text()
REMEDY = "run it where that can be reached"


def run(script: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Call a script of .ci, without what the user's shell says of proxies and indexes."""
    left_out = re.compile(r"PIP_\w+|OSV_URL|\w+_proxy", re.IGNORECASE)
    kept = {name: value for name, value in os.environ.items() if not left_out.fullmatch(name)}
    command = [sys.executable, str(script), *arguments]
    return subprocess.run(command, env={**kept, **environment}, capture_output=True, text=True, check=False)


# what constraints.txt says


def test_constraints_are_read_by_canonical_name():
    text = "# a comment==1\nPyYAML==6.0.3\nruamel.yaml==0.19.1\nsphinx_basic_ng==1.0.0b2\n"
    assert PINS["read"](text) == {"pyyaml": "6.0.3", "ruamel-yaml": "0.19.1", "sphinx-basic-ng": "1.0.0b2"}


def test_constraints_are_written_as_they_are():
    pins = PINS["read"](TEXT)
    assert len(pins) + TEXT.count("#") == len(TEXT.splitlines())
    assert PINS["written"](TEXT, dict(reversed(pins.items()))) == TEXT


def test_moves_tell_what_changed_came_and_went():
    old = {"numpy": "2.5.4", "scipy": "1.18.1", "six": "1.17.0"}
    new = {"numpy": "2.5.5", "scipy": "1.18.1", "tqdm": "4.70.1"}
    assert PINS["moves"](old, new) == ["numpy 2.5.4 -> 2.5.5", "six 1.17.0 -> (gone)", "tqdm (new) -> 4.70.1"]
    assert PINS["moves"](old, old) == []


# renewed


def add_wheel(folder: Path, name: str, version: str, *needs: str) -> None:
    """A wheel with nothing in it but what pip resolves by."""
    info = f"{name}-{version}.dist-info"
    metadata = [
        "Metadata-Version: 2.1",
        f"Name: {name}",
        f"Version: {version}",
        *(f"Requires-Dist: {n}" for n in needs),
    ]
    with zipfile.ZipFile(folder / f"{name}-{version}-py3-none-any.whl", "w") as wheel:
        wheel.writestr(f"{info}/METADATA", "\n".join(metadata) + "\n")
        wheel.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        wheel.writestr(f"{info}/RECORD", "")


@pytest.fixture
def checkout(tmp_path):
    """A checkout whose setup.py needs little, and a folder that stands for the index."""
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci/pins", tmp_path / ".ci")
    index = tmp_path / "index"
    index.mkdir()
    for name, *versions in (("pip", "26.3"), ("setuptools", "79.0.1"), ("organ", "1.0", "1.9", "2.0"), ("tool", "3.1")):
        for version in versions:
            add_wheel(index, name, version)
    add_wheel(index, "bridge", "0.3", "organ>=1", "tool")
    return tmp_path


def renew(checkout: Path, organ: str, pins: str) -> subprocess.CompletedProcess[str]:
    """Renew the pins of a checkout that asks for an organ, and with an extra for a bridge."""
    call = f"setup(install_requires=['{organ}'], extras_require={{'ros': ['bridge']}})"
    (checkout / "setup.py").write_text(f"from setuptools import setup\n{call}\n")
    (checkout / "constraints.txt").write_text(pins)
    return run(checkout / ".ci/pins", PIP_NO_INDEX="1", PIP_FIND_LINKS=str(checkout / "index"))


def test_renewed_pins_are_the_newest_that_setup_allows(checkout):
    done = renew(checkout, "organ<2", "# Why.\nbridge==0.3\norgan==1.0\npip==26.3\nsetuptools==79.0.1\nsix==1.17.0\n")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "organ 1.0 -> 1.9",
        "six 1.17.0 -> (gone)",
        "tool (new) -> 3.1",
        "3 of 6 pins moved",
    ]
    renewed = "# Why.\nbridge==0.3\norgan==1.9\npip==26.3\nsetuptools==79.0.1\ntool==3.1\n"
    assert (checkout / "constraints.txt").read_text() == renewed
    again = renew(checkout, "organ<2", renewed)
    assert again.stdout == "0 of 5 pins moved\n"
    assert (checkout / "constraints.txt").read_text() == renewed


def test_pins_stay_where_none_fit(checkout):
    done = renew(checkout, "organ>=7", "organ==1.0\n")
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("pins: pip found no compatible versions, constraints.txt is unchanged: ")
    assert "organ>=7" in done.stderr
    assert (checkout / "constraints.txt").read_text() == "organ==1.0\n"


# audited


class Advisories(BaseHTTPRequestHandler):
    """OSV's answers to /v1/query: all that is known of a version, as far as the tests need it."""

    FIXED = "10.3.0"

    def do_POST(self):
        query = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        answers = {
            "/v1/query": (200, json.dumps({"vulns": [self.hole()]} if self.concerns(query) else {})),
            "/busy": (503, "busy"),
            "/page": (200, "<html>log in first</html>"),
        }
        status, body = answers[self.path]
        self.send_response(status)
        self.end_headers()
        self.wfile.write(body.encode())

    def concerns(self, query):
        return query["package"] == {"name": "pillow", "ecosystem": "PyPI"} and query["version"] == "10.2.0"

    def hole(self):
        events = [{"introduced": "0"}, {"fixed": self.FIXED}]
        affected = {
            "package": {"name": "pillow", "ecosystem": "PyPI"},
            "ranges": [{"type": "ECOSYSTEM", "events": events}],
        }
        return {
            "schema_version": "1.6.0",
            "id": "GHSA-44wm-f244-xhp3",
            "aliases": ["CVE-2024-28219"],
            "summary": "A buffer overflows.",
            "published": "2024-04-03T03:30:30Z",
            "affected": [affected],
        }

    def log_message(self, *_):
        """Says nothing."""


@pytest.fixture(scope="module")
def service():
    pytest.importorskip("pip_audit")
    with ThreadingHTTPServer(("127.0.0.1", 0), Advisories) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.fixture
def audit(tmp_path):
    """Audits pins, as `make audit` does."""

    def audited(pins: str, url: str) -> subprocess.CompletedProcess[str]:
        (tmp_path / "constraints.txt").write_text(pins)
        return run(ROOT / ".ci/audit", "osv", str(tmp_path / "constraints.txt"), OSV_URL=url)

    return audited


def test_a_known_hole_takes_one_line(service, audit):
    done = audit("# Why.\nnumpy==2.5.5\npillow==10.2.0\n", f"{service}/v1/query")
    assert (done.returncode, done.stderr) == (1, "")
    assert done.stdout == "pillow 10.2.0: CVE-2024-28219, fixed in 10.3.0\n"


def test_pins_without_a_known_hole_pass(service, audit):
    done = audit("numpy==2.5.5\npillow==10.3.0\n", f"{service}/v1/query")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"no known vulnerability in 2 pins, according to {service}/v1/query\n"


@pytest.mark.parametrize(("path", "why"), [("/busy", "503"), ("/page", "Expecting value")])
def test_a_service_that_gives_no_answer_is_named_in_one_line(service, audit, path, why):
    told_in_one_line(audit("pillow==10.3.0\n", service + path), f"{service}{path} gave no answer", why)


def test_a_service_that_is_not_there_is_named_in_one_line(audit):
    pytest.importorskip("pip_audit")
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{silent.getsockname()[1]}/v1/query"
        told_in_one_line(audit("pillow==10.3.0\n", url), f"{url} gave no answer", "Connection refused")


def told_in_one_line(done: subprocess.CompletedProcess[str], what: str, why: str) -> None:
    """Check that an audit failed with a line that names what gave no answer, why, and the remedy."""
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith(f"audit: {what} (")
    assert why in done.stderr
    assert REMEDY in done.stderr


def test_a_service_that_takes_too_long_is_named():
    stderr = (
        "ERROR:pip_audit._cli:Could not connect to OSV's vulnerability feed\n"
        "ERROR:pip_audit._cli:Tip: your network may be blocking this service. Try another service with `-s SERVICE`\n"
    )
    assert "gave no answer (Could not connect to OSV's vulnerability feed): " in AUDIT["reason"]("osv", stderr)


def test_a_line_that_is_no_pin_is_named(service, audit):
    done = audit("pillow>=10\n", f"{service}/v1/query")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("audit: requirement pillow is not pinned to an exact version")
    assert done.stderr.count("\n") == 1


def test_what_the_service_does_not_know_does_not_pass():
    """As pip-audit reports it behind a mirror that has PyPI's files alone; its own exit code is 0 then."""
    pins = [{"name": "numpy", "version": "2.5.5", "vulns": []}]
    assert AUDIT["unknown"]("pypi", pins) == ""
    pins += [{"name": name, "skip_reason": "Dependency not found on PyPI"} for name in ("pip", "rich", "tqdm", "zict")]
    line = AUDIT["unknown"]("pypi", pins)
    assert line.startswith("https://pypi.org/pypi tells nothing of 4 of 5 pins (pip, rich, tqdm, ...): ")
    assert REMEDY in line
    assert AUDIT["holes"](pins) == []


def test_a_hole_that_nothing_closes_yet_is_reported():
    pins = [{"name": "six", "version": "1.17.0", "vulns": [{"id": "CVE-2099-1", "fix_versions": []}]}]
    assert AUDIT["holes"](pins) == ["six 1.17.0: CVE-2099-1, fixed in none yet"]


def test_a_service_of_another_name_is_wrong_use():
    done = run(ROOT / ".ci/audit", "nvd")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "audit: no service 'nvd': SERVICE is one of osv, pypi\n"
