"""Tags typed wrong, blanks that are none, line ends of old: refused at their own lines, or read."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from nls import GraphFileError
from nls.io.files import read_bytes
from nls.io.text import Text
from nls.io.trajectory import read_tum
from nls.io.unused_lines import refuse_misspelt
from nls.missions.folder.table import Table
from tests.combinations import for_all
from tests.nls.io.g2o_files import INFORMATION_2, PLANE, assert_refused, cases, read, same, write
from tests.nls.io.io_files import ALL, FILES, TORO_2, read_any

EDGE = f"0 3 1.05 2.05 3.1 {INFORMATION_2}"
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
