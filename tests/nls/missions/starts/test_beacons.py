"""The place of a beacon from ranges: whatever the course, with wrong ranges among them, and its depth known or not."""

from __future__ import annotations

import numpy as np
import pytest

from nls.missions.starts.placing import beacon_of_ranges

T = np.linspace(0, 1, 60)
COURSES = {
    "circle": np.column_stack([20 * np.cos(7 * T), 15 * np.sin(7 * T), 3 + 0 * T]),
    "lawn mower": np.column_stack([40 * np.abs((4 * T) % 2 - 1), 30 * T, 3 + np.sin(9 * T)]),
    "nearly a line": np.column_stack([100 * T, 2 * np.sin(9 * T), 3 + 0 * T]),
}


@pytest.mark.parametrize("course", COURSES)
@pytest.mark.parametrize("wrong", [0, 9])
def test_a_beacon_is_where_its_ranges_meet(course: str, wrong: int) -> None:
    p, rng = COURSES[course] + [500.0, -200.0, 0.0], np.random.default_rng(4)
    for beacon in rng.uniform([400, -300, 10], [600, -100, 40], (20, 3)):
        r = np.linalg.norm(p - beacon, axis=1)
        r[rng.choice(len(r), wrong, replace=False)] += rng.uniform(5, 60, wrong)
        assert beacon_of_ranges(p, r, float(beacon[2])) == pytest.approx(beacon, abs=1e-3), beacon
        if not wrong:
            assert beacon_of_ranges(p, r) == pytest.approx(beacon, abs=1e-3), beacon


def test_on_a_level_course_it_is_below() -> None:
    above = np.array([30.0, 10.0, -5.0])
    r = np.linalg.norm(COURSES["circle"] - above, axis=1)
    assert beacon_of_ranges(COURSES["circle"], r) == pytest.approx([30.0, 10.0, 11.0], abs=1e-4)


def test_from_one_place_there_is_still_a_start() -> None:
    beacon = beacon_of_ranges(np.zeros((3, 3)), np.full(3, 5.0))
    assert np.linalg.norm(beacon) == pytest.approx(5.0, abs=1e-6)
