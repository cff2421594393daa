"""What the verdict is decided by is documented, and is passed."""

import dataclasses
import re

import pytest

from jaxisp.gap.criteria import CRITERIA, Criteria
from jaxisp.gap.search.verdict import searched
from tests.gap import toy


def test_every_threshold_says_what_it_is():
    told = set(re.findall(r"(\w+)(?=(?:, \w+)*: )", Criteria.__doc__))
    assert {field.name for field in dataclasses.fields(Criteria)} <= told


@pytest.mark.parametrize(("change", "causes"), [
    ({}, 2), ({"most_causes": 1}, 1), ({"null_drop": 20.0}, 0), ({"begins": 0.9, "null_excess": 20.0}, 0),
    ({"named": 1.0}, 0), ({"smallest": 0.3}, 1), ({"least_of_rest": 0.97}, 0),
])  # fmt: skip
@pytest.mark.parametrize("kind", CRITERIA)
def test_a_search_is_decided_by_the_criteria_of_its_case(kind, change, causes):
    """Effects that close seven and three tenths of ten floors."""
    evidence, start = toy.apart({"chroma_denoising": 0.71, "vignetting": 0.29})
    case = toy.case(evidence, start, kind)
    criteria = {"least_unit": 0.0, "named": 0.0} | change
    case = dataclasses.replace(case, criteria=dataclasses.replace(case.criteria, **criteria))
    assert len(searched(case, case.gap(), lambda *tick: None).causes) == causes
