"""The child that uses hostile input notices whatever may not happen, and the next input finds it as usual."""

import pytest

from helpers.fuzz import misdeeds
from helpers.fuzz.child import Input

pytestmark = pytest.mark.extended


@pytest.mark.parametrize(
    ("misdeed", "reason"),
    [
        ("crash", r"the process died of SIGSEGV \(File "),
        ("end", r"the process ended with 3"),
        ("hang", r"hung: not finished after 0 s \(File .*misdeeds"),
        ("raise_an_error", r"ZeroDivisionError"),
        ("take_memory", r"took \d+ MB"),
        ("ask_for_all_memory", r"MemoryError|more memory"),
        ("warn", r"something else was printed: .*of a rarely seen kind"),
        ("write", r"something else was printed: a library's words"),
        ("open_what_lies_outside", r"opened outside outside of its folder"),
        ("open_what_lies_elsewhere", r"open '/etc/passwd'"),
        ("make_a_file", r"made pickled outside of its folder"),
        ("start_a_program", r"subprocess.Popen"),
        ("refuse_in_two_lines", r"refused with 2 lines"),
    ],
)
def test_a_misdeed_is_noticed(child, misdeed, reason):
    with pytest.raises(AssertionError, match=reason):
        child.use(misdeeds.prepare, misdeed, seconds=0.2 if misdeed == "hang" else 60.0)
    assert child.use(misdeeds.prepare, "behave") == "used"
    assert child.use(misdeeds.prepare, "refuse") == "refused"


def test_files_lie_where_they_are_read_and_are_still_there_afterwards(child):
    given = Input({"bag": None, "bag/a": b"12", "b": b"3"}, "bag", misdeeds.prepare_to_list)
    assert child.read(given) == "used"
    assert (child.folder / "input" / "bag" / "a").read_bytes() == b"12"
    assert child.read(Input({"bag": b""}, "bag", misdeeds.prepare_to_list)) == "refused"
    assert "2 bytes" in repr(given)
