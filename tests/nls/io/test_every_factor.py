"""Text formats are as wide as their readers: every record goes round; every factor is written, or refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import BearingRange, Factor, Isotropic, Position, Range
from factors.keys import Keys
from models import SE2, SE3, LieGroup, Manifold, R
from models.advice import Advice
from models.errors import GraphError
from nls import FactorGraph, Values, kinds
from nls.io.dialects import G2O
from nls.io.pyfg import PLANE as PYFG_PLANE
from nls.io.pyfg import SPACE as PYFG_SPACE
from tests.factors.samples import Sample, full_noise
from tests.factors.test_conformity import SAMPLES, situation
from tests.nls.io.io_files import SENSORS_2, SENSORS_3
from tests.nls.io.test_pyfg import PLANE, SPACE

x, l = kinds("x", "l")
WRITTEN = {
    "g2o": {"Between", "BetweenSensors", "Bearing", "Landmark", "Position", "Prior"},
    "pyfg": {"Between", "Landmark", "Prior", "Range"},
}


def tags(*texts: str) -> set[str]:
    return {line.split()[0] for text in texts for line in text.splitlines() if line and line[0] != "#"}


def test_the_files_that_go_round_have_every_record() -> None:
    """Bit for bit they do: in test_round_trip, and in test_pyfg."""
    own = {r.tag.decode() for r in G2O.records if not (r.foreign or r.switched)}
    assert tags(SENSORS_2, SENSORS_3) == own | {"FIX"}
    for text, records in ((PLANE, PYFG_PLANE), (SPACE, PYFG_SPACE)):
        assert tags(text) == {tag.decode() for tag in records}


def in_kinds_of_files(sample: Sample, count: int = 3) -> tuple[Factor, Values]:
    """A factor of a sample and its variables, under the names and numbers that files know."""
    X, z = situation(sample, "truth", count, 0)
    names: list[str] = []
    for k, manifold in enumerate(sample.manifolds):
        pose, point = manifold in (SE2, SE3), manifold in (R(2), R(3))
        names.append("o" if pose and k == 2 else "x" if pose else "l" if point else "abcd"[k])
    keys = tuple(Keys(name, 10 * k + np.arange(count)) for k, name in enumerate(names))
    stacks: dict[str, tuple[Manifold, object, object]] = {}
    for name, manifold, elements, k in zip(names, sample.manifolds, X, keys, strict=True):
        if name in stacks:
            elements, numbers = np.concatenate([stacks[name][1], elements]), [*stacks[name][2], *k.numbers]  # type: ignore
        else:
            numbers = k.numbers.tolist()
        stacks[name] = (manifold, elements, numbers)
    return sample.build(keys, z, full_noise(count, sample.dim, 0)), Values(stacks)  # type: ignore[arg-type]


def refused(path: Path, graph: FactorGraph, values: Values) -> GraphError | None:
    """The refusal of a file; None where it was written."""
    try:
        nls.save(path, graph, values)
    except GraphError as error:
        return error
    return None


@pytest.mark.parametrize("form", WRITTEN)
def test_every_factor_is_written_or_refused_by_name_with_a_file_that_holds_it(form: str, tmp_path: Path) -> None:
    written = set()
    for sample in SAMPLES:
        factor, values = in_kinds_of_files(sample)
        graph = FactorGraph([factor])
        refusal = refused(tmp_path / f"a.{form}", graph, values)
        if refusal is not None:
            assert repr(factor) in str(refusal) or "variables " in str(refusal), sample
            assert {Advice("native"), Advice("register")} & set(refusal.advice), (sample, str(refusal))
            assert "function" not in sample.name or refused(tmp_path / "a.npz", graph, values)  # others: test_native
            continue
        read, its, _ = nls.load(tmp_path / f"a.{form}", factor.convention)
        assert read.chi2(its) == pytest.approx(graph.chi2(values), rel=1e-9, abs=1e-12), sample
        assert [type(other) for other in read.factors] == [type(factor)], sample
        written.add(factor.name)
    assert written == WRITTEN[form]


@pytest.mark.parametrize(("group", "suffix"), [(SE2, "g2o"), (SE3, "g2o"), (SE2, "pyfg"), (SE3, "pyfg")])
def test_a_lever_arm_has_no_line_and_one_of_nothing_needs_none(group: LieGroup, suffix: str, tmp_path: Path) -> None:
    d, path = group.point_dim, tmp_path / f"a.{suffix}"
    values = Values({x: (group, group.identity(1))})

    def place(arm: float) -> FactorGraph:
        return FactorGraph([Position(x[0], np.arange(1.0, d + 1), Isotropic(0.5), offset=np.full(d, arm))])

    with pytest.raises(GraphError, match=r"Position\(x0\) cannot be written"):
        nls.save(path, place(0.1), values)
    if suffix == "g2o":
        nls.save(path, place(0.0), values)
        read, its, _ = nls.load(path, "log")
        assert read.chi2(its) == pytest.approx(place(0.0).chi2(values), rel=1e-12)


def test_ranges_and_bearings_with_ranges() -> None:
    values = Values({x: (SE2, SE2.identity(1)), l: (R(2), [[1.0, 1.0]], [7])})
    distance = FactorGraph([Range(x[0], l[7], [1.4], Isotropic(0.1))])
    both = FactorGraph([BearingRange(x[0], l[7], [[0.7, 1.4]], Isotropic(0.1))])
    with pytest.raises(GraphError, match=r"Range\(x0, l7\) cannot be written to a g2o file") as caught:
        nls.io.rendered("a.g2o", distance, values)
    assert [advice.action for advice in caught.value.advice] == ["pyfg", "native"]
    assert nls.io.rendered("a.pyfg", distance, values)[0].endswith(b"EDGE_RANGE 0.0 x0 l7 1.4 0.010000000000000002\n")
    for form in ("g2o", "pyfg"):
        with pytest.raises(GraphError, match="and two lines would be two independent measurements") as caught:
            nls.io.rendered(f"a.{form}", both, values)
        assert [advice.action for advice in caught.value.advice] == ["native"]


def test_poses_come_first_in_files_of_names() -> None:
    """The reader of the format's authors takes the dimension from the first line."""
    values = Values({l: (R(2), [[1.0, 1.0]], [7]), x: (SE2, SE2.identity(1))})
    assert nls.io.rendered("a.pyfg", FactorGraph(), values)[0].split()[0] == b"VERTEX_SE2"
