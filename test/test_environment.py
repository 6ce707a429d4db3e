"""Variables of the environment that are set for a while."""

import os

import pytest

from tissue_sim.environment import environment


def fails_in_it():
    with environment({"TISSUE_SIM_ONE": "1", "TISSUE_SIM_OTHER": "2"}):
        assert (os.environ["TISSUE_SIM_ONE"], os.environ["TISSUE_SIM_OTHER"]) == ("1", "2")
        raise KeyError


def test_variables_are_what_they_were_even_after_an_error(monkeypatch):
    monkeypatch.setenv("TISSUE_SIM_ONE", "before")
    monkeypatch.delenv("TISSUE_SIM_OTHER", raising=False)
    with pytest.raises(KeyError):
        fails_in_it()
    assert os.environ["TISSUE_SIM_ONE"] == "before"
    assert "TISSUE_SIM_OTHER" not in os.environ
