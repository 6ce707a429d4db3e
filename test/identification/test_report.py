"""The report of an identification: complete in itself, with every figure, and escaped."""

import re

import numpy as np
import pytest

from helpers.html_page import Page
from tissue_sim.errors import UserError
from tissue_sim.identification.identify import Settings, identify
from tissue_sim.identification.report import report_page, write_report


@pytest.fixture(scope="module")
def found(organ, presses):
    measurement, curves = presses
    made = [
        one._replace(forces=0.6 * curves.some([row]).at(one.depths[None])[0][0])
        for row, one in enumerate(measurement.presses)
    ]
    return identify(organ, measurement._replace(presses=made, source="<bag>"), Settings(with_map=False))


def test_the_report_is_complete(found, tmp_path):
    write_report(found, tmp_path / "report.html")
    page = Page((tmp_path / "report.html").read_text())
    assert len(page.images) == 4
    for image in page.images:
        assert image["src"].startswith("data:image/png;base64,")
        assert len(image["src"]) > 8000
        assert image["alt"]
    assert "From <bag>, 4 presses" in page.text
    assert "95 % interval" in page.text
    assert f"{found.modulus:.0f}" in page.text
    assert not re.search(r'(?:src|href)="http', report_page(found)), "it is complete in itself"


def test_a_warning_is_shown_as_one(found):
    stiff = found._replace(diagnosis=found.diagnosis._replace(exponent=3.0, holds_to=1e-3))
    page = Page(report_page(stiff))
    assert ("class", "warning") in page.attributes
    assert "the fit holds to a depth of 1.0 mm" in page.text
    assert ("class", "warning") not in Page(report_page(found)).attributes


@pytest.mark.parametrize("known", [True, False])
def test_places_without_registration_are_shown_too(found, known):
    presses = [one if known else one._replace(place=np.full(3, np.nan)) for one in found.measurement.presses]
    elsewhere = found.measurement._replace(is_registered=False, presses=presses)
    assert "Young's modulus of each press" in Page(report_page(found._replace(measurement=elsewhere))).text


def test_a_folder_that_is_missing_is_reported(found, tmp_path):
    with pytest.raises(UserError, match="cannot write report"):
        write_report(found, tmp_path / "none" / "report.html")
