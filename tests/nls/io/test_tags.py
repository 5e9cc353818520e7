"""What every g2o tag says, against its error written out with matrices; roles of vertices; starts without vertices."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from factors import Isotropic, Prior
from models import SE2, SE3, LieGroup, R
from nls import FactorGraph, Values, initialize, kinds
from nls.io.dialects import G2O
from nls.starts import chain
from tests.combinations import for_all
from tests.nls.io.g2o_files import CONVENTIONS, INFORMATION_2, UPPER_3, assert_refused, cases, read
from tests.nls.io.io_files import SENSORS_2, SENSORS_3, SIX, THREE

Numbers = tuple[float, ...]
x, l, o = kinds("x", "l", "o")
M2, M3 = np.array([[4, 0.5], [0.5, 3]]), np.array([[4, 0.5, 0.25], [0.5, 3, 0.125], [0.25, 0.125, 2]])
M6 = np.zeros((6, 6))
M6[np.triu_indices(6)] = np.array(UPPER_3.split(), dtype=float)
M6 = M6 + np.triu(M6, 1).T
TURNED = {r.tag.decode() for r in G2O.records if r.factor and r.element.space in (SE2, SE3)}
EDGE = np.array([[500, 1, 2], [1, 400, 3], [2, 3, 300]], dtype=float)


def T(group: LieGroup, X: npt.ArrayLike) -> np.ndarray:
    """Homogeneous matrix of one pose."""
    X = np.asarray(X, dtype=float)
    d = group.point_dim
    out = np.eye(d + 1)
    out[:d, :d], out[:d, d] = group.rotation(X), group.position(X)
    return out


def chart(group: LieGroup, E: np.ndarray) -> np.ndarray:
    """Translation and angle, or vector part of the quaternion, of a homogeneous matrix."""
    if group is SE2:
        return np.array([*E[:2, 2], np.arctan2(E[1, 0], E[0, 0])])
    w = np.sqrt(1 + np.trace(E[:3, :3])) / 2
    return np.array([*E[:3, 3], *(np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]]) / (4 * w))])


def expected(text: str, group: LieGroup) -> list[tuple[str, float]]:
    """Tag and chi2 of every measurement of a file, as the sources of g2o define its error."""
    d, size, inv = group.point_dim, group.size, np.linalg.inv
    rows = [(w[0], [float(n) for n in w[1:]]) for w in (line.split() for line in text.splitlines())]
    V, P = ({v[0]: T(group, v[1:]) for t, v in rows if t[0] == letter and len(v) == 1 + size} for letter in "VP")
    L = {v[0]: np.array([*v[1:], 1.0]) for t, v in rows if t[0] == "V" and len(v) == 1 + d}

    def turned(z: Numbers, X: np.ndarray, Y: np.ndarray) -> np.ndarray:
        return chart(group, inv(T(group, z[:size])) @ inv(X) @ Y)

    def seen(S: np.ndarray, l: np.ndarray, z: Numbers) -> np.ndarray:
        return (inv(S) @ l)[:d] - z[:d]

    def angle(p: np.ndarray) -> float:
        return float(np.arctan2(p[1], p[0]))

    errors: dict[str, Callable[..., npt.ArrayLike]] = {
        "EDGE_SE2 EDGE_SE3:QUAT": lambda i, j, *z: turned(z, V[i], V[j]),
        "EDGE_SE2_XY": lambda i, j, *z: seen(V[i], L[j], z),
        "EDGE_BEARING_SE2_XY": lambda i, j, *z: [angle(inv(V[i]) @ L[j]) - z[0]],
        "EDGE_PRIOR_SE2": lambda i, *z: turned(z, np.eye(d + 1), V[i]),
        "EDGE_PRIOR_SE2_XY": lambda i, *z: V[i][:d, d] - z[:d],
        "EDGE_PRIOR_XY EDGE_POINTXYZ_PRIOR": lambda i, *z: L[i][:d] - z[:d],
        "EDGE_POINTXY EDGE_POINTXYZ": lambda i, j, *z: (L[j] - L[i])[:d] - z[:d],
        "EDGE_SE2_OFFSET EDGE_SE3_OFFSET": lambda i, j, a, b, *z: turned(z, V[i] @ P[a], V[j] @ P[b]),
        "EDGE_SE2_POINTXY_OFFSET EDGE_SE3_TRACKXYZ": lambda i, j, a, *z: seen(V[i] @ P[a], L[j], z),
        "EDGE_SE2_CALIB EDGE_SE3_CALIB": lambda i, j, o, *z: turned(z, V[i] @ V[o], V[j] @ V[o]),
        "EDGE_SE2_XY_CALIB": lambda i, j, o, *z: seen(V[i] @ V[o], L[j], z),
        "EDGE_SE3_PRIOR": lambda i, a, *z: turned(z, np.eye(d + 1), V[i] @ P[a]),
        "EDGE_SE3_XYZ_PRIOR": lambda i, _, *z: V[i][:d, d] - z[:d],  # the parameter is ignored
    }
    by_tag = {tag: error for tags, error in errors.items() for tag in tags.split()}
    out = []
    for tag, v in (row for row in rows if row[0][0] == "E"):
        e = np.asarray(by_tag[tag](*v))
        M = EDGE if tag == "EDGE_SE2" else {1: np.array([[25.0]]), 2: M2, 3: M3, 6: M6}[len(e)]
        out.append((tag, float(e @ M @ e)))
    return out


@for_all(group=[SE2, SE3])
def test_every_tag_has_its_error(group: LieGroup) -> None:
    text = SENSORS_2 if group is SE2 else SENSORS_3
    graph, values, _ = read(text)
    wanted = expected(text, group)
    table = {r.tag.decode() for r in G2O.records if r.factor is not None and r.group is group and not r.foreign}
    assert {tag for tag, _ in wanted} == table
    found = sorted(float(c) for factor in graph.factors for c in factor.chi2(values))
    assert found == pytest.approx(sorted(c for _, c in wanted), rel=1e-9)


@for_all(text=[SENSORS_2, SENSORS_3])
def test_conventions_agree_to_first_order(text: str) -> None:
    """Near what is measured chi2 is the same in all conventions; for priors and sensors too."""
    lines = [line for line in text.splitlines() if line[0] in "PV" or line.split()[0] in TURNED]
    found = {}
    for convention in CONVENTIONS:
        graph, values, _ = read("\n".join(lines), convention)
        group = values.stacks["x"].manifold
        for factor in graph.factors:
            model, X = values.gather(factor)
            h, _ = factor.predict(model.manifolds, *X)
            delta = 1e-5 * np.random.default_rng(1).normal(size=(len(factor), group.dim))
            factor._z = group.retract(h, delta)
            factor._model = None
        found[convention] = graph.chi2(values)
    assert found["graphslam"] == pytest.approx(found["g2o"], rel=1e-4)
    assert found["log"] == pytest.approx(found["g2o"], rel=1e-4)
    ratio = found["gtsam"] / found["log"]
    assert ratio == pytest.approx(1) if text is SENSORS_2 else 1.2 < ratio < 4.1


@for_all(text=[SENSORS_2, SENSORS_3])
def test_kinds_and_what_is_held(text: str) -> None:
    graph, values, report = read(text)
    assert {k: s.numbers.tolist() for k, s in values.stacks.items()} == {"x": [0, 1, 2], "l": [10, 11], "o": [20]}
    assert [repr(k) for k in graph.fixed] == (["x0"] if text is SENSORS_2 else ["x0", "l10"])
    assert [repr(f.keys[0]) for f in graph.factors if len(f.keys) == 1] == (
        ["x0", "o20", "x1", "l10"] if text is SENSORS_2 else ["x0", "o20", "x1", "l11"]
    )
    unused = "EDGE_SE3_XYZ_PRIOR lines name a parameter that their error does not use"
    assert report.notes == ([] if text is SENSORS_2 else [unused])


def test_a_place_of_a_sensor_can_be_held() -> None:
    assert sorted(map(repr, read(SENSORS_2 + "FIX 20 11\n")[0].fixed)) == ["l11", "o20", "x0"]


# ---- what vertices are, and what is missing

two = r"VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_XY 5 1 1"
# file, line, words of the error
WRONG = cases(rf"""
{two}\nEDGE_SE2 0 5 1 0 0 {INFORMATION_2} | 4 | needs a pose, vertex 5 is a point (line 3)
{two}\nEDGE_SE2_XY 0 1 1 0 {THREE} | 4 | needs a point, vertex 1 is a pose (line 2)
{two}\nEDGE_SE2_XY 0 6 1 0 {THREE} | 4 | vertex 6, which no VERTEX_XY line has
VERTEX_SE2 0 0 0 0\nEDGE_SE2_XY 0 6 1 0 {THREE} | 2 | vertex 6, which no point vertex line has
{two}\nVERTEX_XY 1 1 1 | 4 | vertex 1 was given before, on line 2
EDGE_SE2_XY 0 1 1 0 {THREE}\nEDGE_SE2 0 1 1 0 0 {INFORMATION_2} | 2 | as pose here, and as point on line 1
EDGE_SE2_CALIB 0 1 2 1 0 0 {SIX}\nEDGE_SE2 1 2 1 0 0 {SIX} | 2 | as pose here, and as place of a sensor on line 1
EDGE_SE2_XY_CALIB 0 3 2 1 0 {THREE}\nEDGE_SE2_XY 0 2 1 0 {THREE} | 2 | as point here, and as place of a sensor on line 1
{two}\nPARAMS_SE2OFFSET 1 0 0 0\nEDGE_SE2_OFFSET 0 1 1 7 1 0 0 {SIX} | 5 | parameter 7, which no PARAMS_SE2OFFSET
{two}\nPARAMS_SE2OFFSET 1 0 0 0\nPARAMS_SE2OFFSET 1 0 0 0 | 5 | parameter 1 was given before
PARAMS_SE3OFFSET 1 0 0 0 0 0 0 0\nVERTEX_TRACKXYZ 0 1 2 3 | 1 | length 0
{two}\nEDGE_SE2_XY 0 5 1 0 1 0 0 1 0 1 | 4 | these are 6 entries for 3
{two}\nEDGE_PRIOR_SE2 0 0 0 0 | 4 | expected 10: i x y theta and 6 entries; these are 0
EDGE_SE2 0 1 1 0 0 {SIX}\nEDGE_BEARING_SE2_XY 0 5 1 1 | 2 | where point 5
VERTEX_XY 1 0 0\nEDGE_POINTXY 1 1 1 1 {THREE} | 2 | vertex 1 to itself
{two}\nFIX 0 21 | 4 | vertex 21, which no VERTEX_SE2 or VERTEX_XY line has
""")


@for_all(case=WRONG)
def test_every_mistake_has_its_line(case: list[str]) -> None:
    assert_refused(int(case[1]), case[2], read, case[0])


# ---- without vertices


@for_all(group=[SE2, SE3])
def test_without_vertices_everything_has_a_start(group: LieGroup) -> None:
    """Poses chained through fixed sensors too, points where they were seen: the optimum is that of the whole file."""
    text = SENSORS_2 if group is SE2 else SENSORS_3
    edges = "\n".join(line for line in text.splitlines() if line.startswith(("EDGE", "PARAMS")))
    graph, values, report = read(edges)
    assert not report.vertices_given
    assert [note.split(": ")[1] for note in report.notes if note.startswith("no vertices")] == [
        "3 poses chained along the edges",
        "2 points placed by the measurements",
        "1 place of a sensor begins at the vehicle's own",
    ]
    assert [stack.manifold for stack in values.stacks.values()] == [group, R(group.point_dim), group]
    best = read(text)
    best[0].fixed = []
    wanted, found = best[0].optimize(best[1]), graph.optimize(values)
    assert found.chi2_final == pytest.approx(wanted.chi2_final, rel=1e-6)


def test_a_chain_is_made_when_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A chordal start needs none; what was fixed, or set, is a start that the user states."""
    made: list[Values] = []

    def counted(graph: FactorGraph, values: Values) -> Values:
        made.append(values)
        return chain(graph, values)

    monkeypatch.setattr("nls.io.read.chain", counted)
    edges = f"EDGE_SE2 0 1 1 0 1.5 {SIX}\nEDGE_SE2 1 2 1 0 1.5 {SIX}\nEDGE_SE2 0 2 1.2 0.9 2.8 {SIX}\n"
    graph, values, _ = read(edges)
    start, name, chi2 = initialize(graph, values)
    assert graph.optimize(start).converged
    assert (name, set(chi2), made) == ("chordal", {"chordal"}, [])
    poses = values[x]
    assert poses[1].tolist() == [1, 0, 1.5]
    assert np.array_equal(pickle.loads(pickle.dumps(values))[x], poses)
    assert (set(initialize(graph, values)[2]), len(made)) == ({"chordal"}, 1)
    values[x[0]] = [5.0, 6.0, 0.1]
    start, _, chi2 = initialize(graph, values)
    assert (set(chi2), start[x[0]].tolist()) == ({"file", "chordal"}, [5.0, 6.0, 0.1])
    other = read(edges)[1]
    other.add(o, SE2, [[0, 0, 0]])
    assert (other.stated is other, values.stated is values) == (True, True)
    graph, values, _ = read(edges)
    graph.fix(x[2])
    start, _, chi2 = initialize(graph, values)
    assert (set(chi2), start[x[2]].tolist()) == ({"file", "chordal"}, poses[2].tolist())


def test_a_part_of_a_file_starts_where_its_edges_lead() -> None:
    """Poses that no measurement of the part moves stay where the file puts them; of all edges chordal is a start."""
    graph, values, _ = read("".join(f"EDGE_SE2 {k} {k + 1} 1 0 0 {SIX}\n" for k in range(6)))
    part = FactorGraph([graph.factors[0][[0, 1, 2, 4, 5]]])
    for method in ("auto", "chordal", "odometry"):
        start, *_ = initialize(part, values, method)
        assert start[x][:, 0] == pytest.approx(np.arange(7.0)), method
    with_prior = FactorGraph([*part.factors[0][[0, 1, 2]], Prior(x[5], [5.0, 0.0, 0.0], Isotropic(0.1))])
    assert with_prior.chi2(initialize(with_prior, values)[0]) == pytest.approx(0, abs=1e-20)
    assert set(initialize(graph, values)[2]) == {"chordal"}


def test_poses_are_chained_through_their_sensors() -> None:
    edges = f"EDGE_SE2_OFFSET 0 1 3 7 0.2 -0.3 1.5 {SIX}\nEDGE_SE2_OFFSET 1 2 3 7 1.2 0.7 1.4 {SIX}\n"
    graph, values, _ = read("".join(SENSORS_2.splitlines(keepends=True)[:2]) + edges)
    assert graph.chi2(values) == pytest.approx(0, abs=1e-25)
    edges = f"EDGE_SE2_CALIB 0 1 20 0.2 -0.3 1.5 {SIX}\nEDGE_PRIOR_SE2 20 0.4 0.3 0.2 {SIX}\n"
    graph, values, _ = read(edges)
    assert graph.chi2(values) == pytest.approx(0, abs=1e-25)


def test_points_follow_their_first_sight_a_prior_or_each_other() -> None:
    text = f"""EDGE_PRIOR_SE2 0 5 6 1.5707963267948966 {SIX}
EDGE_SE2 0 1 1 0 0 {SIX}
EDGE_SE2_XY 1 10 2 1 {THREE}
EDGE_SE2_XY 0 10 9 9 {THREE}
EDGE_PRIOR_XY 11 7 8 {THREE}
EDGE_SE2_XY 1 11 2 1 {THREE}
EDGE_POINTXY 11 12 1 1 {THREE}
"""
    _, values, _ = read(text)
    assert values[x[[0, 1]]] == pytest.approx(np.array([[5, 6, np.pi / 2], [5, 7, np.pi / 2]]))
    assert values[l[[10, 11, 12]]] == pytest.approx(np.array([[-4, 15], [7, 8], [8, 9]]))


def test_points_alone() -> None:
    edges = f"EDGE_PRIOR_XY 1 1 1 {THREE}\nEDGE_POINTXY 1 2 3 4 {THREE}\n"
    _, values, report = read(edges)
    assert values[l] == pytest.approx(np.array([[1, 1], [4, 5]]))
    assert (values.stacks["l"].manifold, report.dimension) == (R(2), "2-D")


def test_one_offset_for_all_is_kept_once() -> None:
    two = f"EDGE_SE2_POINTXY_OFFSET 0 10 3 2.5 0.5 {THREE}\nEDGE_SE2_POINTXY_OFFSET 1 10 3 0.9 -2.5 {THREE}\n"
    text = SENSORS_2.split("EDGE")[0] + two
    landmark = read(text)[0].factors[0]
    assert landmark.offset.shape == (1, 3)  # type: ignore[attr-defined]
    assert read(text.replace("1 10 3 0.9", "1 10 7 0.9"))[0].factors[0].offset.shape == (2, 3)  # type: ignore[attr-defined]
