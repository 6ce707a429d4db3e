"""A comparison as JUnit XML, which CI services read: one test case for each quantity."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from tissue_sim.errors import UserError
from tissue_sim.ros.bags.comparing import Comparison

NOTHING = "the bag holds nothing to compare"


def write_junit(path: Path, name: str, comparison: Comparison, seconds: float, notes: Sequence[str]) -> None:
    """Write a suite of the bag's name; notes: lines that tell what differed before. Raises UserError for the file."""
    cases = comparison.quantities
    failed = [case for case in cases if case.first_beyond >= 0 or comparison.holds_nothing]
    counts: dict[str, Any] = {
        "tests": str(len(cases)),
        "failures": str(len(failed)),
        "errors": "0",
        "time": f"{seconds:.3f}",
    }
    root = ElementTree.Element("testsuites", name="tissue_sim replay", **counts)
    suite = ElementTree.SubElement(root, "testsuite", name=name, skipped="0", **counts)
    for case in cases:
        shown = ElementTree.SubElement(suite, "testcase", classname=name, name=case.what, time="0")
        text = f"largest deviation: {case}"
        if comparison.holds_nothing:
            text = NOTHING
        elif case.first_beyond >= 0:
            text = f"beyond {case.tolerance:g} {case.unit} from tick {case.first_beyond} on; {text}"
        if case in failed:
            ElementTree.SubElement(shown, "failure", message=text, type="deviation").text = text
        else:
            ElementTree.SubElement(shown, "system-out").text = text
    if notes:
        ElementTree.SubElement(suite, "system-out").text = "\n".join(notes)
    ElementTree.indent(root)
    try:
        ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from None
