"""Claims that hold can fail: each does when a wrong law or parameter is planted.

Every plant's recorded values are judged; those that fly in no time are flown, too. For the others
see `plant.py`.
"""

import pytest

from reproduction.plant import NEVER, flown, planted, read_plants
from testbed.reproduction.claim import CORRECTED, FAILS, HOLDS
from testbed.reproduction.paper import keys, read_papers

FILE = read_plants()
PAPERS = read_papers(keys())
HELD = {
    f"{key}.{claim.id}"
    for key, paper in PAPERS.items()
    for claim in paper.claims
    if claim.expected in (HOLDS, CORRECTED)
}
CASES = [(plant, name) for plant in FILE.plants for name in plant.fails]
FLOWN = [plant for plant in FILE.plants if plant.flown]


def claim_of(key: str, name: str):
    found = [claim for claim in PAPERS[key].claims if claim.id == name]
    assert found, f"plants.toml names {key}.{name}, which is no claim"
    return found[0]


def test_every_claim_that_holds_has_a_plant_or_a_reason():
    can_fail = {f"{plant.paper}.{name}" for plant, name in CASES}
    excused = set(FILE.reasons)
    assert sorted(HELD - can_fail - excused) == []
    assert sorted((can_fail | excused) - HELD) == []  # nothing left over
    assert sorted(can_fail & excused) == []
    assert all(FILE.reasons.values())


@pytest.mark.parametrize(("plant", "name"), CASES, ids=lambda x: getattr(x, "wrong", x))
def test_what_is_planted_fails(plant, name):
    claim = claim_of(plant.paper, name)
    assert claim.run == plant.run
    assert planted(PAPERS[plant.paper], plant, claim).outcome == FAILS


def test_each_plant_says_what_is_wrong():
    assert [plant for plant in FILE.plants if not plant.wrong or not plant.fails] == []
    assert all(plant.set for plant in FLOWN)


@pytest.mark.parametrize("plant", FLOWN, ids=lambda p: f"{p.paper} {p.run}: {p.wrong}")
def test_what_is_flown_wrongly_measures_what_is_recorded(plant):
    measured = {claim.id: value for claim, value in flown(PAPERS[plant.paper], plant)}
    for name, record in plant.fails.items():
        if claim_of(plant.paper, name).over is None:
            expected = None if record == NEVER else pytest.approx(record, rel=0.05)
            assert measured[name] == expected, name
