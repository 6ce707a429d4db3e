"""Hostile tools, loads and settings, tick by tick: afterwards the organs are as before, and asleep."""

import json

import pytest
from hypothesis import given

from helpers.fuzz import scenes
from helpers.fuzz.examples import examples
from helpers.fuzz.plays import ALONE, JOINED, Hand, Load, Play, plays
from helpers.paths import ROOT

SECONDS = 240.0  # for one play
FOUND = json.loads((ROOT / "test" / "fuzz" / "found_plays.json").read_text())

# There may be any number of examples, each of which has a time limit.
pytestmark = [pytest.mark.extended, pytest.mark.timeout(0)]


@examples(4)
@given(play=plays(ALONE))
def test_an_organ_is_as_before(child, play):
    child.use(scenes.prepare, play, seconds=SECONDS)


@examples(4)
@given(play=plays(JOINED))
def test_two_organs_are_as_before(child, play):
    child.use(scenes.prepare, play, seconds=SECONDS)


@pytest.mark.parametrize("name", FOUND)
def test_what_was_found_once_stays_fixed(child, name):
    play = Play(**FOUND[name])
    hands = tuple(Hand(**hand) for hand in play.hands)
    child.use(scenes.prepare, play._replace(hands=hands, load=Load(**play.load)), seconds=SECONDS)
