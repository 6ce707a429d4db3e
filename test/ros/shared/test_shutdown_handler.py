"""How a node ends when nobody reads any more what it says."""

import os
import sys

import pytest

from tissue_sim.ros.shared import shutdown_handler as ending


class Gone:
    """A standard error whose reader has ended, as when the program that started the node was killed."""

    def write(self, _text):
        raise BrokenPipeError

    flush = write


def test_a_node_that_cannot_close_ends_though_nobody_reads_why(monkeypatch):
    codes = []
    monkeypatch.setattr(sys, "stderr", Gone())
    monkeypatch.setattr(os, "_exit", codes.append)
    ending._leave(1, "could not close in 5 s")
    assert codes == [1]


@pytest.mark.parametrize("stream", [None, Gone()])
def test_what_nobody_reads_is_no_failure(monkeypatch, stream):
    from tissue_sim.unexpected_errors import write_error

    monkeypatch.setattr(sys, "stderr", stream)
    write_error("a line")
