"""Every key that /diagnostics can hold, and every reason for which input is refused, is explained on its page."""

import ast
import re

import pytest

from helpers.diagnostics_page import explained, is_explained, keys
from helpers.paths import ROOT

SOURCES = [
    ast.parse(path.read_text(encoding="utf-8"))
    for folder in ("node", "bags", "shared")
    for path in sorted((ROOT / "tissue_sim" / "ros" / folder).rglob("*.py"))
]
BY_VARIABLE = {"skipped.<>": ["skipped.mesh_unchanged", "skipped.no_subscriber"]}


def text(node: ast.AST) -> list[str]:
    """Texts that an expression may be: <> stands for what is filled in, and isn't known here."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return [node.value]
    if isinstance(node, ast.JoinedStr):
        parts = [str(part.value) if isinstance(part, ast.Constant) else "<>" for part in node.values]
        made = "".join(parts).removeprefix("<>")
        return BY_VARIABLE.get(made, [made])
    return []


def is_report(node: ast.AST) -> bool:
    """Whether it is the values or the problems of a report."""
    return isinstance(node, ast.Attribute) and node.attr in ("values", "problems")


def reported() -> set[str]:
    """Keys that the node's sources put into reports."""
    found: list[str] = []
    for node in (node for source in SOURCES for node in ast.walk(source)):
        if isinstance(node, ast.Assign):
            targets = [one for one in node.targets if isinstance(one, ast.Subscript) and is_report(one.value)]
            found += [key for one in targets for key in text(one.slice)]
        elif isinstance(node, ast.AugAssign) and is_report(node.target):
            if isinstance(node.value, ast.Dict):
                found += [key for one in node.value.keys for key in text(one)]
            elif isinstance(node.value, ast.DictComp):
                found += text(node.value.key)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            if node.func.id in ("UnexpectedErrors", "RepeatedFailure"):
                found += [f"{name.replace(' ', '_')}_failures" for name in text(node.args[0])]
    return set(found)


def reasons() -> set[str]:
    """Names under which the node's sources count what they refuse."""
    found = {"nan_wrench"}
    for node in (node for source in SOURCES for node in ast.walk(source)):
        if isinstance(node, ast.Call):
            name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            place = {"Refused": 0, "_as": 0, "BadQuaternion": 0, "_check_finite": 1, "_read": 3}.get(name)
            if place is not None and len(node.args) > place:
                found |= set(text(node.args[place]))
        elif isinstance(node, ast.FunctionDef) and node.name == "_wrong":  # of a breath
            given = [one.value for one in ast.walk(node) if isinstance(one, ast.Return)]
            found |= {name for one in given if isinstance(one, ast.Tuple) for name in text(one.elts[0])}
    return found


def test_every_key_is_explained_and_every_explained_key_is_there():
    found = reported()
    assert {"overruns", "active_nodes", "skipped.unfelt", "refused.<>", "cuts_refused"} <= found, "the sources are read"
    own = {"refused.<reason>": "refused.<>"}
    wanted = {own.get(key, key) for key in keys()} | {"respiration.refused.<>", "_failures.<>"}
    extra = {key for key in found if re.fullmatch(r"<?>?\.?<>|_failures\.<>", key)}
    assert found - extra == wanted - {"_failures.<>"}


def test_every_reason_is_explained_and_every_explained_reason_is_there():
    assert reasons() == explained("reason")


@pytest.mark.parametrize("key", ["left.refused.nan_pose", "overruns", "outlet_failures.node.py:7", "left.state"])
def test_what_a_node_reports_is_known(key):
    assert is_explained(key, ("left",))


@pytest.mark.parametrize("key", ["left.refused.some_reason", "left.overran", "right.state"])
def test_what_no_node_reports_is_not(key):
    assert not is_explained(key, ("left",))


def test_words_of_the_demonstration_are_terms_of_the_glossary():
    glossary = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    for key in ("overruns", "active_nodes", "contact_count"):
        assert f"`{key}`" in glossary
