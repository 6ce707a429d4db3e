"""Replays of bags that a node has recorded."""

from pathlib import Path

import pytest

from tissue_sim.cli import main


def repeated(bag: str | Path, capsys: pytest.CaptureFixture[str]) -> str:
    """What `tissue_sim replay` prints of a bag that repeats with no tolerance."""
    code = main(["replay", str(bag), "--force-tolerance", "0", "--position-tolerance", "0"])
    printed = capsys.readouterr()
    assert code == 0, printed.err
    assert "repeats" in printed.out
    return printed.out
