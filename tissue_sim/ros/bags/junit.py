"""Results of bags as JUnit XML, which CI services read: a suite for each, a test case for each quantity."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from tissue_sim.errors import UserError
from tissue_sim.ros.bags.comparison import Deviation
from tissue_sim.ros.bags.outcome import NOTHING, Outcome


def write_junit(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Write all outcomes to a file. Raises UserError when it can't be written."""
    root = ElementTree.Element("testsuites", name="tissue_sim replay")
    tests = failures = 0
    for outcome in outcomes:
        suite = ElementTree.SubElement(root, "testsuite", name=outcome.name, errors="0", skipped="0")
        suite.set("time", f"{outcome.seconds:.3f}")
        cases = outcome.comparison.quantities
        failed = [case for case in cases if outcome.comparison.is_empty_comparison or case.first_beyond >= 0]
        for case in cases:
            _add(suite, outcome, case, case in failed)
        if outcome.notes:
            ElementTree.SubElement(suite, "system-out").text = "\n".join(outcome.notes)
        suite.set("tests", str(len(cases)))
        suite.set("failures", str(len(failed)))
        tests, failures = tests + len(cases), failures + len(failed)
    root.set("tests", str(tests))
    root.set("failures", str(failures))
    ElementTree.indent(root)
    try:
        ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from None


def _add(suite: ElementTree.Element, outcome: Outcome, case: Deviation, failed: bool) -> None:
    shown = ElementTree.SubElement(suite, "testcase", classname=outcome.name, name=case.what, time="0")
    text = f"largest deviation: {case}"
    if outcome.comparison.is_empty_comparison:
        text = NOTHING
    elif failed:
        text = f"deviation above {case.tolerance:g} {case.unit} from tick {case.first_beyond} on; {text}"
    if failed:
        ElementTree.SubElement(shown, "failure", message=text, type="deviation").text = text
    else:
        ElementTree.SubElement(shown, "system-out").text = text
