"""Numbers, ids and lines of a text file: every number is Python's float() to the bit, everything else has its line."""

from __future__ import annotations

import gzip
import itertools
import math
from decimal import Decimal, localcontext
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nls import GraphFileError
from nls.io import decimals as module
from nls.io import text as text_module
from nls.io.decimals import MARKS, PAD, UNREAD, WHOLE, decimals
from nls.io.files import read_bytes
from nls.io.records import among
from nls.io.text import Text
from tests.nls.io.g2o_files import assert_refused, write

digits = st.text("0123456789", max_size=25)
sign = st.sampled_from(["", "-", "+"])
exponent = st.one_of(
    st.just(""), st.builds("{}{}{}".format, st.sampled_from("eE"), sign, st.text("0123456789", min_size=1, max_size=3))
)


def same_bits(words: list[str]) -> None:
    """The words on one line are the numbers of Python."""
    expected = np.array([float(word) for word in words])
    found = Text(f"T {' '.join(words)}\n".encode()).table(np.array([0]), len(words), "numbers")[0]
    wrong = found.view(np.int64) != expected.view(np.int64)
    assert not wrong.any(), [(w, f, e) for w, f, e, bad in zip(words, found, expected, wrong, strict=True) if bad]


def is_number(word: str) -> bool:
    mantissa = word.lstrip("+-").split("e")[0].split("E")[0]
    return any(c.isdigit() for c in mantissa)


@given(
    st.lists(
        st.builds("{}{}{}{}{}".format, sign, digits, st.sampled_from(["", "."]), digits, exponent).filter(
            lambda word: is_number(word) and np.isfinite(float(word))
        ),
        min_size=1,
        max_size=40,
    )
)
@settings(max_examples=50)
@example(["4503599627370496", "4503599627370497", "9007199254740993", "450359962737049.6", "0.4503599627370496"])
@example(["-0", "-0.0", "-.0", "+0", "0.", ".5", "-.5", "5.", "-5.", "007", "-00.70"])
@example(["1e-320", "4.9e-324", "2.4703282292062327e-324", "2.4703282292062328e-324", "1e-400", "0.1e-322"])
@example(["1.7976931348623157e308", "123456789012345678901234567890", "0.30000000000000004", "99999999999999999"])
@example(["9999999999999999", "999999999999999.9", ".9999999999999999", "0.000000000000001", "1000000000000000.0"])
def test_every_number_is_read_to_the_bit(words: list[str]) -> None:
    same_bits(words)


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=60))
def test_the_shortest_digits_read_back(numbers: list[float]) -> None:
    same_bits([repr(x) for x in numbers])
    same_bits([f"{x:.17g}" for x in numbers])


WORDS = """nan NaN inf -inf Infinity 1_0 \uff11 \u0661 0x1A 1e 1e+ e5 . - + -. 1-2 1..2 1.2.3 --1 +-1 1,5 1e5.0 1f 1d0
1/2 5% \u22121 1.-2 None 1e1_0"""


def test_every_word_that_is_no_number_has_its_line() -> None:
    for word in WORDS.split():
        text = Text(f"T 1 2\nT 3 4\n\nT {word} 5\nT 6 7\n".encode(), "a.g2o")
        error = assert_refused(4, "is not a number", text.table, np.array([0, 1, 3, 4]), 2, "a b")
        assert (error.path, error.text) == ("a.g2o", f"T {word} 5")
    for word in ("1e309", "-1e400", "1" * 400, "1e99999"):
        assert_refused(2, "beyond the largest number", Text(f"\nT {word}\n".encode()).table, np.array([1]), 1, "a")


def test_the_first_wrong_line_is_named_with_the_expected_words() -> None:
    text = Text(b"T 1 2\nT 1 2 3\nT 1\n", "f")
    assert_refused(2, "f:2: 3 numbers after the tag, expected 2: a b [T 1 2 3]", text.table, np.arange(3), 2, "a b")


@given(st.lists(st.integers(-(2**63), 2**63 - 1), min_size=1, max_size=30))
@example([2**63 - 1, -(2**63), 2**53 + 1, 2**52, 2**52 + 1, 0, -1, 10**17, 10**16 - 1])
def test_ids_are_exact(numbers: list[int]) -> None:
    text = Text("".join(f"V {n}\n" for n in numbers).encode())
    found = text.whole(np.arange(len(numbers)), 1)
    assert found.dtype == np.int64
    assert found.tolist() == numbers


def test_ids_in_unusual_dress_and_words_that_are_none() -> None:
    for word in ("+7", "007", "-0"):
        assert Text(f"V {word}".encode()).whole(np.array([0]), 1).tolist() == [int(word)]
    for word in (str(2**63), str(-(2**63) - 1), "9" * 40, "1.0", "1.", "1e3", "x1", "1_0", "\uff11", "-"):
        text = Text(f"V 1\nV {word}\n".encode())
        assert_refused(2, "is not a whole number below 2^63", text.whole, np.array([0, 1]), 1)


def test_line_ends_tabs_and_blank_lines() -> None:
    for data in (b"A 1 2\nB 3\n", b"A 1 2\r\nB 3\r\n", b"\tA\t1 \t 2\t\n B  3  ", b"\n\nA 1 2\n\n\nB 3"):
        text = Text(data)
        assert list(text.tags) == [b"A", b"B"]
        assert text.table(text.tags[b"A"], 2, "").tolist() == [[1.0, 2.0]]
        assert text.table(text.tags[b"B"], 1, "").tolist() == [[3.0]]
    assert all(Text(data).tags == {} for data in (b"", b"\n", b"  \n\t\r\n "))


def test_tags_are_grouped_in_order_of_appearance() -> None:
    """Short ones at both ends of the text, those that share their ends, long ones, and more than any format has."""
    near = b"E EDGE_SE2 XEDGE_SE2 EDGE_SE2_XY EDGE_BEARING_SE2_XY EDGE_BEARING_SE3_XY 2 EE".split()
    long = [b"a" * 64, b"b" * 65, b"b" * 66, b"EDGE_SE3:QUAT", b"EDGE_SE2:QUAT", b"e"]
    rng = np.random.default_rng(0)
    for words in (near, near + long, *([b"t%d" % k for k in range(n)] for n in (15, 16, 17, 250))):
        drawn = [words[k] for k in (0, *rng.integers(0, len(words), 3 * len(words)), 0)]
        for ends in (b"", b" 1"):
            tags = Text(b"\n".join(word + ends for word in drawn)).tags
            expected: dict[bytes, list[int]] = {}
            for n, word in enumerate(drawn):
                expected.setdefault(word, []).append(n)
            assert {tag: lines.tolist() for tag, lines in tags.items()} == expected
            assert list(tags) == list(expected)


@given(st.binary(max_size=200))
def test_any_bytes_can_be_split(data: bytes) -> None:
    text = Text(data)
    assert [text.line(k) for k in range(len(text.first) - 1)] == data.split(b"\n")
    assert str(text.error("wrong", 0)).encode()  # printable, whatever the bytes
    words = [line.split() for line in data.split(b"\n")]  # bytes.split knows the blanks of ASCII only
    assert [text.token(k) for k in range(len(text.starts))] == [word for line in words for word in line]
    assert np.diff(text.first).tolist() == [len(line) for line in words]
    assert sum(map(len, text.tags.values())) == sum(bool(line) for line in words)


CONTENT = b"VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    def refused(data: bytes, message: str) -> None:
        with pytest.raises(GraphFileError, match=rf"graph\.g2o.*{message}"):
            read_bytes(write(tmp_path, data))

    packed = gzip.compress(CONTENT * 20)
    for cut in (3, 12, 30, -1, -5, -9):
        refused(packed[:cut], "is not a complete gzip file")
    damaged = bytearray(packed)
    damaged[len(damaged) // 2] ^= 0xFF
    refused(bytes(damaged), "is a damaged gzip file")
    packed = gzip.compress(CONTENT)  # another one and zeros may follow
    assert read_bytes(write(tmp_path, packed + bytes(100) + packed + bytes(9))) == 2 * CONTENT
    refused(packed + b"garbage", "7 bytes that are no gzip follow")
    for size in (16, 32):
        for order in ("le", "be"):
            refused(f"\ufeff{CONTENT.decode()}".encode(f"utf-{size}-{order}"), f"is UTF-{size} text")
            refused(CONTENT.decode().encode(f"utf-{size}-{order}"), "binary")
    refused(b"VERTEX_SE2\n\x00\x01\x02\n", ":2: has a zero byte")
    with pytest.raises(GraphFileError, match="is a folder"):
        read_bytes(tmp_path)
    with pytest.raises(GraphFileError, match=r"none\.g2o: cannot be read: No such file") as caught:
        read_bytes(tmp_path / "none.g2o")
    assert isinstance(caught.value, ValueError)


def test_a_long_line_is_cut_in_the_message() -> None:
    with pytest.raises(GraphFileError) as caught:
        Text(b"T " + b"9" * 5000 + b"x\n").table(np.array([0]), 1, "a")
    assert len(str(caught.value)) < 250
    assert len(caught.value.text) == 80
    numbers = " ".join(f"{k}.{k}5" for k in range(10, 60))
    for mark in (" ", "\t", ","):
        words = numbers.replace(" ", mark)
        with pytest.raises(GraphFileError) as caught:
            Text(f"T {words} x\n".encode()).table(np.array([0]), 51, "a")
        said, dots = caught.value.text.split(" ...")
        assert (dots, len(said) <= 76) == ("", True)
        assert f"T {words}{mark}".startswith(said + mark)  # whole numbers


def read(words: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Numbers and forms of the words, one blank between."""
    data = [word.encode() for word in words]
    lengths = np.array([len(word) for word in data])
    ends = PAD + np.cumsum(lengths + 1) - 1
    return decimals((b" " * PAD + b" ".join(data)).translate(MARKS), ends - lengths, ends)


def read_to_the_bit(words: list[str]) -> np.ndarray:
    """The forms of the words; what is read has the bits of float()."""
    value, form = read(words)
    expected = np.array([float(word) for word in words])
    bits = [(word, x) for word, x, y, f in zip(words, value, expected, form, strict=True) if f and x.hex() != y.hex()]
    assert not bits
    return form


def test_exponents_are_read_here_and_to_the_bit() -> None:
    mantissas = ("1", "8.5017", "-3.25", "0.000123456", "+12345678.", ".5", "123456789.012345", "-0.10000000000000001")
    exponents = (0, 1, 5, 6, 13, 22, 32)
    words = [f"{m}{e}{s}{x:02d}" for m, e, s, x in itertools.product(mantissas, "eE", "+-", exponents)]
    assert (read_to_the_bit(words) == 2).all()


@pytest.mark.parametrize("form", [".17g", ".16e", ".17f", "r"])
def test_numbers_of_all_digits_are_read_here_and_to_the_bit(form: str) -> None:
    numbers = np.random.default_rng(3).normal(size=3000) * 10.0 ** np.random.default_rng(4).integers(-5, 3, 3000)
    words = [repr(x) if form == "r" else format(x, form) for x in numbers.tolist()]
    assert (read_to_the_bit(words) == 2).mean() > 0.98
    assert max(map(len, words)) >= 22


def test_the_largest_integers_do_not_overflow() -> None:
    largest = 1843 * 10**16
    words = [f"{n + k * 10**p + 1}" for n in (largest, 2**64) for k in range(-9, 10) for p in range(2, 19)]
    words += [word[:k] + "." + word[k:] for word in words for k in (1, 3, 4, 5, 12)]
    form = read_to_the_bit(words)
    assert 0.1 < (form == 2).mean() < 0.3


@given(st.floats(1e-12, 1e20), st.integers(17, 25), st.integers(-2, 2), st.sampled_from(["f", "e"]))
def test_near_the_middle_of_two_numbers(x: float, digits: int, away: int, style: str) -> None:
    """The middle of two neighbors, cut to some digits, and what is one or two of the last digit from there."""
    with localcontext(prec=60):
        middle = (Decimal(x) + Decimal(math.nextafter(x, math.inf))) / 2
        near = Decimal(f"{middle:.{digits - 1}e}")
        unit = Decimal((0, (1,), near.adjusted() - digits + 1))
        words = [format(sign * (near + away * unit), style) for sign in (1, -1)]
    read_to_the_bit([words[0], "7", words[1]])


def test_a_number_in_the_middle_of_two_is_not_decided_here() -> None:
    middles = [str(2 * k + 1) for k in np.random.default_rng(5).integers(2**52, 2**53, 50).tolist()]
    assert not read_to_the_bit(
        [*middles, *(f"{m}.0" for m in middles), *(f"{m[:-3]}.{m[-3:]}e+03" for m in middles)]
    ).any()


SYNTAX = """- + . -. 1.2.3 1..2 --1 +-1 1-2 12345678.1234567.1 12.4567812.45678 e-05 .e-05 -.e-05 1e-5 1e-0x 1e-0. 1e-x5
1e-.5 1ex05 1e005 1e.05 1-05 1e-51 1e+51 1.2.3e-05 99999999999999999999 1.2345678.12345678901 1.23456789012.45678901
12345678901.34567.901 1234567890123456-8 .......1234567890123456 nan x 1x x1 1/2 12&5 1,5"""


def test_words_that_are_not_read_here() -> None:
    for word in (*SYNTAX.split(), "", "\xa0", "\u0661", "1\x1e2", "1\x102", "\x00", "1\x00"):
        value, form = read(["12345678.9", word, "87654321"])
        assert form.tolist() == [2, UNREAD, WHOLE], word
        assert read([f"-{word}e-05"])[1].tolist() == [UNREAD]
        assert value[[0, 2]].tolist() == [12345678.9, 87654321.0]


LINES = b"VERTEX 1 0.5 -2e-05\nE 1 2 12345678.25 7\n\n# remark 1\nVERTEX 2 1.5 9007199254740993\nE 2 1 -0 .5\n" * 3


def test_blocks_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Text(LINES)
    for size in (1, 2, 7, 16, len(LINES) + PAD, len(LINES) + PAD + 1):
        monkeypatch.setattr(module, "BLOCK", size)
        monkeypatch.setattr(text_module, "BLOCK", size)
        text = Text(LINES)
        assert text.starts.tolist() == whole.starts.tolist()
        assert text.first.tolist() == whole.first.tolist()
        for tag, columns in ((b"VERTEX", 3), (b"E", 4)):
            lines = text.tags[tag]
            assert text.table(lines, columns, "").tolist() == whole.table(lines, columns, "").tolist()


def test_among() -> None:
    numbers = np.array([[-(2**63), -8, -7, 0], [3, 4, 6, 2**63 - 1]])
    for known in ([], [3], [3, 4, 5], [-7, 0, 9], [-(2**63), 2**63 - 1], [-(2**63), -(2**63) + 1]):
        expected = [[n in known for n in row] for row in numbers]
        assert among(numbers, np.array(known, dtype=np.int64)).tolist() == expected
