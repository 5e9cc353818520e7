"""Reading, writing and reading again: the same graph to the bit; every factor is written, or refused by name."""

from __future__ import annotations

import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import nls
from factors import BearingRange, Between, Factor, Huber, Isotropic, Landmark, Position, Prior, Range, Robust
from factors.keys import Keys
from models import SE2, SE3, LieGroup, Manifold, R
from models.advice import Advice
from models.errors import GraphError
from nls import FactorGraph, GraphWarning, OptionError, Values, kinds, load, save
from nls.io.dialects import G2O
from nls.io.pyfg import PLANE as PYFG_PLANE
from nls.io.pyfg import SPACE as PYFG_SPACE
from tests.combinations import for_all
from tests.factors.samples import Sample, full_noise
from tests.factors.test_conformity import SAMPLES, situation
from tests.nls.io.g2o_files import CONVENTIONS, PLANE, again, assert_unwritable, read, same, same_factors, write
from tests.nls.io.io_files import FILES, SENSORS_2, SENSORS_3, TORO_3
from tests.nls.io.test_pyfg import PLANE as NAMED_PLANE
from tests.nls.io.test_pyfg import SPACE as NAMED_SPACE

x, l, o = kinds("x", "l", "o")
WRITTEN_AS = {"ODOMETRY": "EDGE2", "Constraint2": "EDGE2"}
ALIASES = {"EDGE_PRIOR_SE2 ": ("EDGE_SE2_PRIOR ",), "EDGE_SE3_PRIOR ": ("EDGE_PRIOR_SE3 ", "EDGE_SE3_PRIOR:QUAT ")}


def numbers(text: str) -> Counter[tuple[str | float, ...]]:
    """The measurements and vertices of a file: tag and numbers of every line but FIX."""
    words = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("FIX")]
    return Counter((WRITTEN_AS.get(w[0], w[0]), *map(float, w[1:])) for w in words)


@for_all(convention=CONVENTIONS, name=[n for n in FILES if n != "toro, space"])
def test_every_tag_goes_round(name: str, convention: str, tmp_path: Path) -> None:
    dialect, text = FILES[name]
    loaded = read(text, convention, dialect)
    same(loaded, again(loaded, tmp_path, convention, dialect))
    found, expected = numbers((tmp_path / "again.g2o").read_text()), numbers(text)
    if dialect == "g2o" and convention != "log":
        assert {k: n for k, n in found.items() if not str(k[0]).startswith("VERTEX")} == {
            k: n for k, n in expected.items() if not str(k[0]).startswith("VERTEX")
        }
    assert expected - found == Counter()  # vertices may be more: a file without any is written with them


def test_poses_of_toro_in_space_go_round_to_rounding(tmp_path: Path) -> None:
    """Roll, pitch and yaw of vertices become quaternions; measurements are kept as they were."""
    loaded = read(TORO_3)
    back = again(loaded, tmp_path, dialect="toro")
    same_factors(loaded, back)
    assert np.abs(loaded[1][x] - back[1][x]).max() < 1e-15
    edges = {k: n for k, n in numbers((tmp_path / "again.g2o").read_text()).items() if k[0] == "EDGE3"}
    assert edges == {k: n for k, n in numbers(TORO_3).items() if k[0] == "EDGE3"}


PUBLIC = {
    "pose-graphs-2d/FR079_P_toro.graph": "toro",
    "pose-graphs-3d/sphere400.txt": "isam",
    "victoria-park/victoria_park.txt": "isam-covariance",
    "robust-real/newcollege_short.g2o": "g2o",
}


def test_public_files_go_round(data: Path, tmp_path: Path) -> None:
    """Word for word where a dialect has its own file; every other pose graph to the bit, the largest left out."""
    graphs = sorted(f for pattern in ("pose-graphs-?d/*.g2o*", "robust-real/*.g2o*") for f in data.glob(pattern))
    assert len(graphs) >= 15
    small = {str(f.relative_to(data)): "g2o" for f in graphs if f.stat().st_size < 1 << 19}
    for name, dialect in (small | PUBLIC).items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GraphWarning)
            loaded = load(data / name, dialect=dialect)
        same(loaded, again(loaded, tmp_path, dialect=dialect))
        if name in PUBLIC:
            assert numbers((tmp_path / "again.g2o").read_text()) == numbers((data / name).read_text())


@for_all(canonical=ALIASES)
def test_aliases_are_read_and_not_written(canonical: str, tmp_path: Path) -> None:
    text = SENSORS_2 if "SE2" in canonical else SENSORS_3
    for alias in ALIASES[canonical]:
        assert canonical in text
        loaded = read(text.replace(canonical, alias))
        same_factors(loaded, read(text))
        back = again(loaded, tmp_path)
        same_factors(loaded, back)
        written = (tmp_path / "again.g2o").read_text()
        assert alias not in written
        assert canonical in written


def test_numbers_are_turned_again_where_something_changed(tmp_path: Path) -> None:
    """What was remembered of a line is used only for the factor that was read from it."""
    dialect, text = FILES["isam, space"]
    graph, values, report = read(text, "g2o", dialect)
    edge = graph.factors[0]
    moved = np.array(edge.z)
    moved[0, 0] += 0.5
    changed = FactorGraph([Between(*edge.keys, moved, edge.noise, "g2o"), *graph.factors[1:]])
    with pytest.warns(GraphWarning, match="isam files hold measurements only: the values of 4 variables are not in it"):
        save(tmp_path / "out.txt", changed, values, report, dialect)
    first = (tmp_path / "out.txt").read_text().split("\n")[0].split()
    assert float(first[3]) == pytest.approx(1.51)
    again_read = load(tmp_path / "out.txt", dialect=dialect)
    assert again_read[0].chi2(values) == pytest.approx(changed.chi2(values), rel=1e-9)
    assert np.array(first[4:], dtype=float) == pytest.approx(np.array(text.split("\n")[0].split()[4:], dtype=float))


@for_all(dialect=["g2o", "toro", "isam", "isam-covariance", "graph"], convention=CONVENTIONS, group=[SE2, SE3])
def test_graphs_made_in_python_are_written_in_every_dialect(
    dialect: str, convention: str, group: LieGroup, tmp_path: Path
) -> None:
    """The chi2 of the file is that of the graph, in the plane and in space."""
    if group is SE3 and dialect in ("isam-covariance", "graph"):
        return
    rng = np.random.default_rng(3)
    X = group.exp(0.4 * rng.normal(size=(3, group.dim)))
    z = group.retract(group.between(X[[0, 1]], X[[1, 2]]), 0.01 * rng.normal(size=(2, group.dim)))
    graph = FactorGraph([Between(x[[0, 1]], x[[1, 2]], z, Isotropic(0.1), convention)])
    values = Values({x: (group, X)})
    if dialect.startswith("isam"):
        d = group.point_dim
        graph.add(Landmark(x[1], l[7], group.act(X, np.zeros(d))[0], Isotropic(0.2)))
        values = Values({x: (group, X), l: (R(d), np.ones(d), [7])})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GraphWarning)
        save(tmp_path / "out.txt", graph, values, dialect=dialect)
        back, _, report = load(tmp_path / "out.txt", convention, dialect)
    assert report.format == dialect
    if dialect == "isam":
        words = (tmp_path / "out.txt").read_text().split("\n")[0].split()
        upper = np.zeros((group.dim, group.dim))
        upper[np.triu_indices(group.dim)] = np.array(words[3 + group.dim :], dtype=float)
        assert (np.diag(upper) > 0).all()  # a Cholesky factor, as others write it
    assert back.chi2(values) == pytest.approx(graph.chi2(values), rel=1e-9)


def test_parameters_keep_their_ids_and_equal_offsets_share_one(tmp_path: Path) -> None:
    graph, values, report = read(SENSORS_2)
    offset = [0.5, 0.25, 0.1]
    graph.add(Landmark(x[[1, 2]], l[[10, 10]], [[1.0, 2.0], [1.0, 2.0]], Isotropic(1), offset))
    graph.add(Landmark(x[2], l[11], [1.0, 2.0], Isotropic(1), [9.0, 0.0, 0.0]))
    save(tmp_path / "out.g2o", graph, values, report)
    lines = (tmp_path / "out.g2o").read_text().splitlines()
    assert [line for line in lines if line.startswith("PARAMS")] == [
        "PARAMS_SE2OFFSET 3 0.5 0.25 0.1",
        "PARAMS_SE2OFFSET 7 -0.5 0 1.6",
        "PARAMS_SE2OFFSET 8 9 0 0",
    ]
    assert sum(line.startswith("EDGE_SE2_POINTXY_OFFSET 1 10 3 ") for line in lines) == 1
    assert sum(line.startswith("EDGE_SE2_POINTXY_OFFSET 2 11 8 ") for line in lines) == 1


def test_ids_of_offsets_of_two_files_and_of_none(tmp_path: Path) -> None:
    graph, values, _ = read(SENSORS_2)
    other = read(SENSORS_2.replace("PARAMS_SE2OFFSET 3 0.5", "PARAMS_SE2OFFSET 3 0.75"))[0]
    graph.add(next(f for f in other.factors if isinstance(f, Landmark) and isinstance(f.offset, np.ndarray)))
    save(tmp_path / "out.g2o", graph, values)
    back, _, report = load(tmp_path / "out.g2o")
    assert report.tags["PARAMS_SE2OFFSET"] == 3
    assert back.chi2(values) == pytest.approx(graph.chi2(values), rel=1e-12)
    unused = "PARAMS_SE2OFFSET 0 1 2 3"
    loaded = read(f"{unused}\n{SENSORS_2}")
    assert loaded[2].ignored == [unused]
    loaded[0].add(Landmark(x[2], l[11], [1.0, 2.0], Isotropic(1), [9.0, 0.0, 0.0]))
    assert again(loaded, tmp_path)[2].ignored == [unused]


def test_the_largest_id_of_a_parameter_leaves_others_free(tmp_path: Path) -> None:
    """A new offset gets the first id that is left."""
    most = 2**63 - 1
    seen = f"PARAMS_SE3OFFSET {most} 0.5 0 0 0 0 0 1\nEDGE_SE3_TRACKXYZ 0 10 {most} 3 1 0 1 0 0 1 0 1\n"
    graph, values, report = read(seen)
    new = Landmark(x[0], l[10], [3.1, 0.9, 0.4], Isotropic(1), offset=SE3.exp([1.0, 0, 0, 0, 0, 0]))
    save(tmp_path / "out.g2o", FactorGraph([*graph.factors, new], graph.fixed), values, report)
    ids = [line.split()[1] for line in (tmp_path / "out.g2o").read_text().splitlines() if line.startswith("PARAMS")]
    assert ids == [str(most), "0"]


# ---- what a dialect cannot say


def test_what_a_dialect_has_no_line_for(tmp_path: Path) -> None:
    def refused(graph: FactorGraph, values: Values, dialect: str, message: str) -> None:
        assert_unwritable(tmp_path / "out.g2o", message, graph, values, dialect)

    poses = (SE2, SE2.identity(2))
    refused(FactorGraph(), Values({x: poses, l: (R(2), [[1, 1]], [1])}), "g2o", "x1 and l1 have one number")
    refused(FactorGraph(), Values({x: poses, l: (R(3), [[1, 1, 1]], [9])}), "g2o", "x in SE2 .* here x in SE3")
    refused(FactorGraph(), Values({x: poses, o: (SE2, SE2.identity(1), [9])}), "g2o", "o9 is no offset")
    graph, values, _ = read(SENSORS_2)
    for dialect in ("toro", "isam", "graph", "isam-covariance"):
        refused(graph, values, dialect, f"x0 is fixed, and .* {dialect} file")
    graph.fixed = []
    refused(graph, values, "toro", r"Landmark.* cannot be written to a toro file")
    singular, values, _ = read("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 0 0 1\n")
    refused(singular, values, "graph", "has no covariance")
    steep = FactorGraph([Between(x[0], x[1], SE3.exp([0, 0, 0, 0, np.pi / 2, 0]), Isotropic(1))])
    refused(steep, Values({x: (SE3, SE3.identity(2))}), "toro", r"Between\(x0, x1\): Euler angles: .* gimbal lock")


def test_what_no_graph_file_can_hold(tmp_path: Path) -> None:
    graph, values, _ = read(PLANE)
    z, missing = [1.0, 0.0, 0.0], "no variable of kind 'l' has a value"
    mixed = FactorGraph([Between(x[0], x[1], z, Isotropic(1), convention) for convention in ("log", "g2o", "g2o")])
    at = [0.0, 0.0, 0.0]
    refused = [
        (FactorGraph([Prior(x[0], at, Isotropic(1), ("x", "y"))]), r"out\.g2o: Prior\(x0\) cannot be written"),
        (FactorGraph([Prior(x[0], at, Isotropic(1), offset=z)]), r"out\.g2o: Prior\(x0\) cannot be written"),
        (FactorGraph([Prior(x[0], at, Robust(Isotropic(1), Huber(1.0)))]), r"out\.g2o: Prior\(x0\) .*robust kernel"),
        *((FactorGraph([Between(i, l[1], z, Isotropic(1))]), missing) for i in (l[0], x[0])),
        (FactorGraph([Between(x[0], x[7], z, Isotropic(1))]), "x7 has no value"),
        (FactorGraph(graph.factors, [l[0]]), missing),
        (FactorGraph(graph.factors, [x[7]]), "x7 has no value"),
        (mixed, "g2o, log"),
    ]
    for other, message in refused:
        assert_unwritable(tmp_path / "out.g2o", message, other, values)
    mixed.remove(mixed.factors[0])
    save(tmp_path / "out.g2o", mixed, values)


def test_unused_lines_come_back_byte_for_byte(tmp_path: Path) -> None:
    lines = [b"  WHAT \xff\xfe 1\t2  ", b"WHAT caf\xc3\xa9 \xc2\x85x\r", b"\xe9T\xe9 3"]
    with pytest.warns(GraphWarning) as caught:
        loaded = load(write(tmp_path, PLANE.encode() + b"\n".join(lines) + b"\n"))
    assert all(str(c.message).encode() for c in caught)  # no lone surrogates in messages
    assert str(loaded[2]).encode()
    assert r"\xe9T\xe9" in str(caught[0].message)
    same(loaded, again(loaded, tmp_path))
    assert (tmp_path / "again.g2o").read_bytes().split(b"\n")[-4:-1] == lines


def test_suffixes(tmp_path: Path) -> None:
    graph, values, _ = read("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    with pytest.raises(OptionError, match=r"or dialect=FORMAT; \*\.graph may be toro or graph"):
        save(tmp_path / "out.graph", graph, values)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(OptionError, match="dialect: 'auto' is not possible; expected one of g2o, toro"):
        save(tmp_path / "out", graph, values, dialect="auto")
    save(tmp_path / "out.toro.gz", graph, values)
    assert load(tmp_path / "out.toro.gz")[2].format == "toro"
    save(tmp_path / "out.graph", graph, values, dialect="toro")
    assert load(tmp_path / "out.graph")[2].format == "toro"


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
    for text, records in ((NAMED_PLANE, PYFG_PLANE), (NAMED_SPACE, PYFG_SPACE)):
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
    assert [advice.action for advice in caught.value.advice] == ["range line", "native"]
    assert nls.io.rendered("a.pyfg", distance, values)[0].endswith(b"EDGE_RANGE 0.0 x0 l7 1.4 0.010000000000000002\n")
    for form in ("g2o", "pyfg"):
        with pytest.raises(GraphError, match="and two lines would be two independent measurements") as caught:
            nls.io.rendered(f"a.{form}", both, values)
        assert [advice.action for advice in caught.value.advice] == ["native"]


def test_poses_come_first_in_files_of_names() -> None:
    """The reader of the format's authors takes the dimension from the first line."""
    values = Values({l: (R(2), [[1.0, 1.0]], [7]), x: (SE2, SE2.identity(1))})
    assert nls.io.rendered("a.pyfg", FactorGraph(), values)[0].split()[0] == b"VERTEX_SE2"


def test_in_space_a_factor_without_offset_is_written_with_one_of_nothing(tmp_path: Path) -> None:
    sight = Landmark(nls.Keys("x", 0), nls.Keys("l", 9), [1, 2, 3], Isotropic(1))
    graph = FactorGraph([Prior(nls.Keys("x", 0), SE3.identity()[0], Isotropic(0.1)), sight])
    values = Values({nls.Kind("x"): (SE3, SE3.identity()), nls.Kind("l"): (R(3), [[1.0, 2.0, 3.5]], [9])})
    save(tmp_path / "out.g2o", graph, values)
    assert (tmp_path / "out.g2o").read_text().splitlines()[0] == "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1"
