"""Hostile files of every kind: each is used, or refused with one line."""

import pytest
from hypothesis import event, given
from hypothesis import strategies as st

from helpers.fuzz.bags import bags
from helpers.fuzz.examples import examples
from helpers.fuzz.images import images
from helpers.fuzz.meshes import meshes
from helpers.fuzz.organs import organs
from helpers.fuzz.segmentations import segmentations

KINDS = {"organ": organs(), "image": images(), "segmentation": segmentations(), "mesh": meshes(), "bag": bags()}
SECONDS = {"bag": 300.0}  # for one input; a bag may list a part thrice


@pytest.mark.extended
@pytest.mark.timeout(0)  # there may be any number of examples, each of which has a time limit
@pytest.mark.parametrize("kind", KINDS)
@examples(6)
@given(data=st.data())
def test_files_are_used_or_refused(child, kind, data):
    event(child.read(data.draw(KINDS[kind]), SECONDS.get(kind, 60.0)))
