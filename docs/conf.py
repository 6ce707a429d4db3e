"""How Sphinx builds the pages: for `make docs`, and for rosdoc2, which runs this file from a copy of the folder."""

import importlib.util
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.ext.autodoc.mock import mock
from sphinx.util.docutils import SphinxDirective

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

import reference  # noqa: E402

import tissue_sim  # noqa: E402

ROOT = Path(importlib.util.find_spec("tissue_sim").origin).parents[1]
PACKAGE = ElementTree.parse(ROOT / "package.xml").getroot()

project = PACKAGE.findtext("name")
author = PACKAGE.findtext("author")
version = release = PACKAGE.findtext("version")
copyright = f"{author}. Licence: {PACKAGE.findtext('license')}"

extensions = ["myst_parser", "autoapi.extension", "sphinx.ext.napoleon"]  # docstrings are numpydoc's
myst_heading_anchors = 3  # links to headings: page.md#heading
html_theme = "furo"
html_title = project
html_static_path = ["_static"]
html_css_files = ["pages.css"]
highlight_language = "none"
rosdoc2_settings = {"allow_other_extensions": True}  # autoapi

# The reference is read from the sources, not imported: of the library, not of the programs and their machinery, but for
# what has a public name.
autoapi_dirs = [str(ROOT / "tissue_sim")]
PROGRAMS = ("ros/", "bench/", "commands/", "cli.py", "parent_exit.py", "jit.py", "result_cache.py", "__main__.py")
PUBLISHED = ("ros/__init__.py", "ros/bags/__init__.py", "ros/bags/reading.py")
autoapi_ignore = [
    str(path)
    for path in (ROOT / "tissue_sim").rglob("*.py")
    if (part := path.relative_to(ROOT / "tissue_sim").as_posix()).startswith(PROGRAMS) and part not in PUBLISHED
]
autoapi_root = "api"
autoapi_add_toctree_entry = False
autoapi_options = ["members", "show-module-summary"]
napoleon_google_docstring = False
napoleon_use_ivar = True  # fields are on the page already
default_role = "code"  # `x` in a docstring
# Constants without a docstring are not on the pages; two modules may have a class of one name.
suppress_warnings = ["autoapi.python_import_resolution", "ref.python"]


class _FromCode(SphinxDirective):
    """Directive of a table from the code; ROS is replaced by a mock where it isn't installed."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        ros = [depend.text for depend in PACKAGE.findall("exec_depend") if depend.text.isidentifier()]
        with mock([name for name in ros if not importlib.util.find_spec(name)]):
            lines = self.lines(*self.arguments[0].split())
        return self.parse_text_to_nodes("\n".join(lines))


class Options(_FromCode):
    """Options of a command: {options} bench."""

    lines = staticmethod(reference.options_table)


class Parameters(_FromCode):
    """Parameters of the node, or of each tool: {parameters} tool."""

    lines = staticmethod(reference.parameters_table)


def _plain(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Escape a docstring, which is plain text except for `code`: |x| is a length there, x* and x_ are names."""
    for i, line in enumerate(lines):
        parts = line.split("`")
        parts[::2] = [re.sub(r"([|*]|(?<=\w)_\b)", r"\\\1", part) for part in parts[::2]]
        lines[i] = "`".join(parts)


def _short_title(app: Sphinx, page: str, source: list[str]) -> None:
    """Head a module's page by its own name: those of its packages stand above it in the list."""
    title, _, rest = source[0].partition("\n")
    if page.startswith("api/"):
        source[0] = f"{title.rpartition('.')[2]}\n{rest}"
    if page == "api/tissue_sim/index":
        source[0] = re.sub(
            r"^(Submodules|Subpackages)$", _public_names() + r"\1", source[0], count=1, flags=re.MULTILINE
        )


def _public_names() -> str:
    """Return a section on what `from tissue_sim import` gives, with links to where each is described."""
    rows = [f"* :py:obj:`{name} <{module}.{name}>`" for name, module in sorted(tissue_sim._MODULES.items())]
    lead = "A script imports these from ``tissue_sim``. What is not among them may change between versions."
    return "\n".join(["Public names", "------------", "", lead, "", *rows, "", ""])


def setup(app: Sphinx) -> None:
    """Register directives and handlers; called by Sphinx."""
    app.add_directive("options", Options)
    app.add_directive("parameters", Parameters)
    app.connect("autodoc-process-docstring", _plain)
    app.connect("source-read", _short_title)
