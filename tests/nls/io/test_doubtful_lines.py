"""Tags typed wrong, blanks that are none, large angles, negative eigenvalues: refused at their line, or read."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factors.noise import NEGATIVE
from nls import GraphFileError, GraphWarning, load
from nls.io.files import read_bytes
from nls.io.pyfg import read_pyfg
from nls.io.text import Text
from nls.io.trajectory import read_tum
from nls.io.unused_lines import refuse_misspelt
from nls.io.weights import repaired
from nls.missions.folder.table import Table
from tests.combinations import for_all
from tests.nls.io import g2o_files
from tests.nls.io.g2o_files import PLANE, UPPER_3, again, assert_refused, cases, read, same, same_factors, write
from tests.nls.io.io_files import ALL, FILES, ISAM_3, PYFG, TORO_2, TORO_3, read_any

EDGE = f"0 3 1.05 2.05 3.1 {g2o_files.INFORMATION_2}"
SPACES = {
    "\u00a0": r"no-break space \(U\+00A0\)",
    "\u2003": r"em space \(U\+2003\)",
    "\u3000": r"ideographic space \(U\+3000\)",
    "\u200b": r"zero width space \(U\+200B\)",
    "\u2028": r"line separator \(U\+2028\)",
    "\u0085": r"next-line character \(U\+0085\)",
    "\ufeff": r"byte-order mark \(U\+FEFF\)",
}


# line, what stands there instead, words of the error
TYPED = cases(f"""
2 | VERTEX_SE2-1 1.1 0.1 0.1 | 'VERTEX_SE2-1' is no tag; expected VERTEX_SE2 and a blank before -1
2 | VERTX_SE2 1 1.1 0.1 0.1 | 'VERTX_SE2' is no tag; expected VERTEX_SE2
2 | vertex-se2 1 1.1 0.1 0.1 | 'vertex-se2' is no tag; expected VERTEX_SE2
2 | VRT 1 1.1 0.1 0.1 | edge on line 6 needs vertex 1, which no VERTEX_SE2 line has; .* 'VRT' is no tag
8 | EGDE_SE2 {EDGE} | 'EGDE_SE2' is no tag; expected EDGE_SE2
8 | ЕDGE_SE2 {EDGE} | expected EDGE_SE2 .* cyrillic .* ie \\(U\\+0415\\)
8 | EDGÉ_SE2 {EDGE} | expected EDGE_SE2 .* e with acute \\(U\\+00C9\\)
8 | EDGE­_SE2 {EDGE} | expected EDGE_SE2 .* soft hyphen \\(U\\+00AD\\)
8 | ＥDGE_SE2 {EDGE} | expected EDGE_SE2 .* letter e \\(U\\+FF25\\)
8 | EDGE_SE2, 0, 3, 1.05 2.05 3.1 1 0 0 1 0 1 | EDGE_SE2 and blanks, not commas
8 | "EDGE_SE2",0,3,1.05,2.05,3.1,1,0,0,1,0,1 | EDGE_SE2 and blanks, not commas
8 | "EDGE_SE2 {EDGE}" | EDGE_SE2 without quotation mark \\(U\\+0022\\)
8 | EDGE _SE2 {EDGE} | 'EDGE' is no tag; expected EDGE_SE2 without a blank
8 | edge_ se2 {EDGE} | 'edge_' is no tag; expected EDGE_SE2 without a blank
8 | EDGE SE2 {EDGE} | 'EDGE' is no tag; expected EDGE_SE2 without a blank
9 | fix 0 1 | 'fix' is no tag; expected FIX
9 | FIX0 | 'FIX0' is no tag; expected FIX and a blank before 0
""")


@for_all(case=TYPED)
def test_a_tag_typed_wrong_is_refused_at_its_line(case: list[str]) -> None:
    line, typed, expected = int(case[0]), case[1], case[2]
    lines = [*PLANE.splitlines(), ""]
    lines[line - 1] = typed
    error = assert_refused(line, "", read, "\n".join(lines))
    assert re.search(expected, str(error)), str(error)


@for_all(name=[name for name in ALL if name != "bal"])
def test_every_tag_of_every_format_may_lack_its_blank(name: str) -> None:
    """The number behind a tag becomes part of it: never a line less."""
    dialect, text = ALL[name]
    lines = text.splitlines()
    tags = [line.split()[0] for line in lines]
    for k in {tag: tags.index(tag) for tag in tags}.values():
        glued = "\n".join([*lines[:k], lines[k].replace(" ", "", 1), *lines[k + 1 :]])
        assert_refused(k + 1, "", read_any, glued.encode(), dialect)


def test_a_tag_of_another_program_is_not_taken_for_a_mistake() -> None:
    """A tag that is near, with another count of words; one that is far."""
    for line in ("VERTEX_XYZ 9 1 2 3", "EDGE_SE2_XYZ 0 9 1 2 3", "EDGE_SE2_MAXMIX 0 1 1 0 0.05", "VERTEX_SE2_OLD"):
        assert read(PLANE + line + "\n", ignore_tags=["EDGE_SE2_XYZ", "EDGE_SE2_MAXMIX"])[2].ignored == [line]
    for line in ("EDGE SE2_X 0 1", "\u0415\u0414\u0413 0 1", "\u00e9tat 3", "NAME=EDGE_SE2", "EDGE 2 1 0.5"):
        assert read(PLANE + line + "\n", ignore_tags=["EDGE"])[2].ignored == [line]
    assert read(TORO_2 + "EDGE 0 1 1 0 0\n", ignore_tags=["EDGE"])[2].ignored == ["EDGE 0 1 1 0 0"]
    assert read("EDGE3_TRUE 0 1 1 0 0 0 0 0\n" + FILES["isam, space"][1])[2].ignored[0].startswith("EDGE3_TRUE")


def test_the_first_mistake_of_several_is_named() -> None:
    text = Text(b"EDGE_SE2x\nEDGE_SE27\nEDGE_SE21\n", "a.g2o")
    with pytest.raises(GraphFileError, match=r"a\.g2o:2: 'EDGE_SE27' is no tag"):
        refuse_misspelt(text, text.tags, {b"EDGE_SE2": 11})
    refuse_misspelt(text, {}, {b"EDGE_SE2": 11})


@for_all(name=ALL)
def test_a_blank_that_is_none_is_named_with_its_line(name: str) -> None:
    """Behind the tag, between numbers, at both ends of a line, each space in turn: refused, never a line less."""
    dialect, text = ALL[name]
    lines = text.splitlines()
    k = len(lines) - 1
    for turn, place in enumerate(
        ("{0}{3}{1} {2}", "{3}{0} {1} {2}", "{0} {1} {2}{3}", "{0} {1} {2} {3}", "{0} {1}{3}{2}")
    ):
        space = list(SPACES)[(turn + len(name)) % len(SPACES)]
        words = lines[k].split(" ")
        if len(words) > 2 or turn in (1, 2, 3):
            changed = place.format(words[0], " ".join(words[1:-1]), words[-1] if len(words) > 1 else "", space)
            error = assert_refused(k + 1, "", read_any, "\n".join([*lines[:k], changed]).encode(), dialect)
            assert re.search(SPACES[space], str(error))


def test_latin_1_and_a_comment() -> None:
    with pytest.raises(GraphFileError, match=r"f\.g2o:4: .*no-break space of Latin-1 \(byte A0\)"):
        read(PLANE.encode().replace(b"VERTEX_SE2 3", b"VERTEX_SE2\xa03"))
    same(read(PLANE), read("# caf\u00e9\u00a0\u2003\n" + PLANE))


def test_a_blank_that_is_none_in_tables(tmp_path: Path) -> None:
    for text in ("1 0 0 0 0 0 0 1\n2\u00a00 0 0 0 0 0 1\n", "1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\u00a0\n"):
        with pytest.raises(GraphFileError, match=r"a\.tum:2: .*no-break space"):
            read_tum(write(tmp_path, text, "a.tum"))
    with pytest.raises(GraphFileError, match=r"depth\.csv:2: .*no-break space"):
        Table(write(tmp_path, "time_s,z_m\n1\u00a0,2\n", "depth.csv"), ["time_s", "z_m"]).floats("time_s")


def test_any_line_ends(tmp_path: Path) -> None:
    """Pairs stay: lines that are not used are written back byte for byte."""
    assert read_bytes(write(tmp_path, b"A 1\r\nB 2\r\n")) == b"A 1\r\nB 2\r\n"
    assert read_bytes(write(tmp_path, b"A 1\r\nB 2\rC\n")) == b"A 1\nB 2\nC\n"
    assert read_bytes(write(tmp_path, b"A 1\r")) == b"A 1\n"


DEGREES = "these degrees?"


def test_degrees_in_an_edge_are_warned_of_and_turns_of_a_vertex_noted() -> None:
    degrees = PLANE.replace("1.01 0.98 1.5", "1.01 0.98 86").replace("0.9 1.5", "0.9 -87")
    graph, _, report = read(degrees.replace("2.1 3.0", "2.1 15.5664"))
    (warning,), (note, _) = report.warnings, report.notes
    assert warning.startswith("2 lines have an angle of more than a turn, first on line 6 (EDGE_SE2): 86")
    assert warning.endswith(DEGREES)
    assert note.startswith("1 line has an angle of more than a turn, first on line 4 (VERTEX_SE2): 15.5664")
    assert graph.factors[0].z[1, 2] == 86  # read as it is
    for angle in ("6.2832", "-6.28", "3.2", "0"):  # up to a turn
        assert read(PLANE.replace("1.01 0.98 1.5", f"1.01 0.98 {angle}"))[2].notes == []


def test_roll_pitch_and_yaw_of_toro_and_poses_of_pyfg() -> None:
    """A prior of pyfg is a measurement, its vertex is none."""
    report = read(TORO_3.replace("0.11 -0.21 0.41", "0.11 -20.5 10.41"))[2]
    assert "first on line 4 (EDGE3): -20.5" in report.warnings[0]
    text = PYFG.replace("A1 1 0 0.1\n", "A1 1 0 90\n") + "VERTEX_SE2:PRIOR 0.5 A0 0 0 45.5 0.01 0 0 0.01 0 0.001\n"
    _, _, report = read_pyfg(text.encode(), "a.pyfg")
    assert [note.split(";")[0].split(", ")[1] for note in (*report.warnings, report.notes[0])] == [
        "first on line 6 (VERTEX_SE2:PRIOR): 45.5",
        "first on line 2 (VERTEX_SE2): 90",
    ]


TWO = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 2 2 0 0\n"
GOOD = "EDGE_SE2 0 1 1.01 0 0 4 0.5 0.25 3 0.125 2\n"
BAD = "EDGE_SE2 1 2 1.02 0.1 0.3 1 2 0 1 0 1\nEDGE_SE2 0 2 2.1 0 0.1 4 0 0 9 12 4\n"


def smallest(Omega: np.ndarray) -> np.ndarray:
    """Smallest eigenvalue of every matrix scaled to a diagonal of ones."""
    d = np.sqrt(np.abs(np.diagonal(Omega, axis1=1, axis2=2)))
    d = np.where(d > 0, d, 1)
    return np.linalg.eigvalsh(Omega / d[:, :, None] / d[:, None, :])[:, 0]


def test_refused_unless_asked_for(tmp_path: Path) -> None:
    path = write(tmp_path, TWO + GOOD + BAD)
    assert_refused(5, "measurement 1 has the negative eigenvalue -1", load, path)
    with pytest.warns(GraphWarning, match="2 information matrices of EDGE_SE2 .* first on line 5"):
        graph, values, report = load(path, repair_information=True)
    assert len(report.notes) == 1
    M = graph.factors[0].noise.matrix  # type: ignore[attr-defined]
    assert np.array_equal(M[0], [[4, 0.5, 0.25], [0.5, 3, 0.125], [0.25, 0.125, 2]])  # what is right stays to the bit
    assert M[1] == pytest.approx(np.array([[1.5, 1.5, 0], [1.5, 1.5, 0], [0, 0, 1]]))  # eigenvalues 3, -1 become 3, 0
    nearest = 1.5 * np.ones((2, 2))  # to 1, 2, 1: 9, 12, 4 with a diagonal of ones
    assert M[2, 1:, 1:] == pytest.approx(nearest * np.outer([3, 2], [3, 2]))
    assert graph.optimize(values).converged
    same((graph, values, report), again((graph, values, report), tmp_path))


def test_what_is_right_is_left_alone_without_a_word() -> None:
    _, _, report = read(TWO + GOOD, repair=True)
    assert report.notes == []
    same(read(TWO + GOOD), read(TWO + GOOD, repair=True))


def test_before_units_and_angles_are_turned(tmp_path: Path) -> None:
    line = ISAM_3.splitlines()[0]
    bad = line.replace(UPPER_3, UPPER_3.replace("600", "-600"))
    assert_refused(1, "negative eigenvalue", read, bad, dialect="toro")
    loaded = read(bad, dialect="toro", repair=True)
    assert "EDGE3 had negative eigenvalues, first on line 1" in loaded[2].warnings[0]
    assert smallest(loaded[0].factors[0].noise.matrix)[0] > -NEGATIVE  # type: ignore[attr-defined]
    same_factors(loaded, again(loaded, tmp_path, dialect="toro"))


@given(st.integers(0, 10**6), st.sampled_from([1, 2, 3, 6]), st.integers(-8, 8))
def test_repaired_is_semi_definite_and_near(seed: int, m: int, spread: int) -> None:
    """Accepted by the noise, and no nearer matrix: the removed part is at right angles to what is left."""
    rng = np.random.default_rng(seed)
    B = rng.normal(size=(20, m, m))
    scale = 10.0 ** (spread * rng.uniform(size=(20, m)))
    Omega = (B + B.mT) * scale[:, :, None] * scale[:, None, :]
    Omega[0] = 0
    Omega[1] = -np.eye(m)
    before = smallest(Omega)
    found, changed = repaired(Omega)
    assert (smallest(found) > -NEGATIVE).all()
    assert np.array_equal(changed, before < -NEGATIVE)
    assert np.array_equal(found[~changed], Omega[~changed])
    d = np.sqrt(np.abs(np.diagonal(Omega, axis1=1, axis2=2)))
    d = np.where(d > 0, d, 1)
    left = found / d[:, :, None] / d[:, None, :]
    removed = left - Omega / d[:, :, None] / d[:, None, :]
    assert np.abs(np.sum(left * removed, axis=(1, 2))).max() < 1e-5 * np.abs(removed).max()


def test_rounding_in_the_scale_of_the_result_is_repaired_too() -> None:
    """A variance that all but vanishes: what is rounding beside 1 is no rounding beside a^2 / 4."""
    a = np.logspace(-9, 0, 200)
    Omega = np.array([[[1.0, b], [b, -1.0]] for b in a.tolist()])
    found, changed = repaired(Omega)
    assert changed.all()
    assert (smallest(found) > -NEGATIVE).all()
    assert np.abs(found[:, 0, 0] - 1).max() < 0.3


@for_all(entries=["1e308 -1.1e308 0 1e308 0 1e-308", "-1e308 0 0 0 1e308 0", "0 1 0 0 0 0", "0 0 0 0 0 -1"])
def test_extreme_matrices(entries: str) -> None:
    text = TWO + GOOD + f"EDGE_SE2 1 2 1 0 0 {entries}\n"
    graph, values, report = read(text, repair=True)
    assert len(report.warnings) == 1
    assert np.isfinite(graph.chi2(values))
