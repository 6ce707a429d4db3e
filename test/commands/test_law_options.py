"""Options of a tissue that stiffens or relaxes."""

import argparse

import pytest

from helpers.scenes import ball
from tissue_sim.commands.law_options import add_law, with_law
from tissue_sim.errors import UserError


def organ_of(*options):
    parser = argparse.ArgumentParser()
    add_law(parser)
    return with_law(ball(1), parser.parse_args(options))


def test_options_set_the_law_and_leave_the_organ_without_them():
    assert organ_of() is ball(1)
    made = organ_of("--stiffening", "8", "--relaxation", "0.3,1.5")
    assert (made.stiffening, made.relaxation_fraction, made.relaxation_time) == (8.0, 0.3, 1.5)
    none = organ_of("--stiffening", "0", "--relaxation", "0")
    assert (none.stiffening, none.relaxation_fraction, none.relaxation_time) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--relaxation", "0.3"), r"--relaxation '0.3' is not a fraction and a time; write them as 0.3,1.5, or 0"),
        (("--relaxation", "half,1"), r"--relaxation 'half,1' is not a fraction and a time"),
        (("--relaxation", "1.2,1"), r"relaxation fraction 1.2 is outside 0..0.9"),
        (("--relaxation", "0.3,600"), r"relaxation time 600 is outside 0.01..60"),
        (("--relaxation", "0.3,0"), r"relaxation needs a fraction and a time, or neither"),
        (("--stiffening", "-1"), r"stiffening -1 is outside 0..100"),
        (("--stiffening", "nan"), r"stiffening nan is outside 0..100"),
    ],
)
def test_what_no_tissue_has_is_refused(options, message):
    with pytest.raises(UserError, match=message):
        organ_of(*options)
