"""Mutants of a file for `fuzz.py`: bits, bytes, blocks, lines, words, numbers, tags, encodings, control characters."""

from __future__ import annotations

import gzip
import io
import re
import zipfile
from collections.abc import Callable, Sequence

import numpy as np

Rng = np.random.Generator
GZIP, ZIP = b"\x1f\x8b", b"PK\x03\x04"
WORD = re.compile(rb"[^\s,;:{}\[\]\"=#]+")
NUMBER = re.compile(rb"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
NUMBERS = (
    *(b"nan", b"NaN", b"inf", b"-inf", b"Infinity", b"1e300", b"-1e300", b"1e308", b"1e999", b"-1e999", b"1e-308"),
    *(b"1e9", b"-1e9", b"1e6", b"-1e6", b"1e-9", b"123456.789", b"1e100", b"-1e150", b"1e18", b"1e-12"),
    *(b"1e160", b"1e-160", b"-0", b"-0.0", b"0", b"1", b"-1", b"2", b"", b"9007199254740993", b"9223372036854775807"),
    *(b"9223372036854775808", b"-9223372036854775809", b"99999999999999999999", b"1" * 400, b"0." + b"3" * 400),
    *(b"0x10", b"1_0", b"1,5", b"1.5.2", b"--1", b"+5", b"007", b"1.0", b"5.", b".5", b"1d3", b"1e", b"true", b"null"),
    *("１".encode(), "٣".encode(), b"1e5", b"3.141592653589793", b"7", b"100", b"1j", b"''", b'"1"', b"[]", b"{}"),
)
CONTROL = (
    *(bytes([k]) for k in (0, 1, 7, 8, 9, 10, 11, 12, 13, 27, 28, 29, 30, 31, 127)),
    *(b"\x1b[2J", b"\x1b]0;title\x07", "\x85".encode(), "\x9b".encode(), b"\x85", b"\x9b", b"\xa0", "\xa0".encode()),
    *("\u202e".encode(), "\u2028".encode(), "\u200b".encode(), "\ufeff".encode(), b"\xff\xfe", b"\xed\xa0\x80"),
)
SIGNS = (b" ", b"\t", b"#", b"%", b"\n", b"\r", b"-", b"+", b".", b",", b";", b":", b"e", b"/", b"\\", b'"', b"'", b"=")


def number_of(word: bytes) -> float | None:
    """A decimal number; None for another word."""
    return float(word) + 0.0 if NUMBER.fullmatch(word) else None


def unpacked(data: bytes) -> bytes:
    """The content of a file that may be gzip-compressed."""
    return gzip.decompress(data) if data[:2] == GZIP else data


def at(data: bytes, rng: Rng) -> int:
    """A place in the data, also its end."""
    return int(rng.integers(len(data) + 1))


def some_lines(data: bytes) -> list[bytes]:
    """Lines with their ends."""
    return data.splitlines(keepends=True)


def one_word(data: bytes, rng: Rng, number: bool) -> re.Match[bytes] | None:
    """A word that is a number, or one that is none."""
    words = [word for word in WORD.finditer(data) if bool(NUMBER.fullmatch(word[0])) == number]
    return words[int(rng.integers(len(words)))] if words else None


def put(data: bytes, word: re.Match[bytes] | None, new: bytes) -> bytes:
    """The data with another word in the place of one."""
    return data if word is None else data[: word.start()] + new + data[word.end() :]


def bits(data: bytes, rng: Rng) -> bytes:
    out = bytearray(data)
    for k in rng.integers(len(data), size=int(rng.integers(1, 4))) if data else ():
        out[k] ^= 1 << int(rng.integers(8))
    return bytes(out)


def some_bytes(data: bytes, rng: Rng) -> bytes:
    k, cut = at(data, rng), int(rng.integers(3))
    return data[:k] + rng.bytes(int(rng.integers(3))) + data[k + cut :]


def signs(data: bytes, rng: Rng) -> bytes:
    k, cut = at(data, rng), int(rng.integers(2))
    return data[:k] + SIGNS[int(rng.integers(len(SIGNS)))] + data[k + cut :]


def block_cut(data: bytes, rng: Rng) -> bytes:
    k = at(data, rng)
    return data[:k] + data[k + int(rng.integers(1, 2 + len(data) // 3)) :]


def block_twice(data: bytes, rng: Rng) -> bytes:
    k, to = at(data, rng), at(data, rng)
    return data[:to] + data[k : k + int(rng.integers(1, 2 + len(data) // 3))] + data[to:]


def lines_swapped(data: bytes, rng: Rng) -> bytes:
    lines = some_lines(data)
    if len(lines) > 1:
        a, b = rng.integers(len(lines), size=2).tolist()
        lines[a], lines[b] = lines[b], lines[a]
    return b"".join(lines)


def line_changed(data: bytes, rng: Rng) -> bytes:
    """A line left out, or twice."""
    lines = some_lines(data)
    if lines:
        k = int(rng.integers(len(lines)))
        lines[k : k + 1] = [lines[k]] * (2 * int(rng.integers(2)))
    return b"".join(lines)


def words_swapped(data: bytes, rng: Rng) -> bytes:
    lines = some_lines(data)
    if not lines:
        return data
    k = int(rng.integers(len(lines)))
    words = list(WORD.finditer(lines[k]))
    if len(words) > 1:
        a, b = sorted(rng.choice(len(words), 2, replace=False).tolist())
        line = put(lines[k], words[b], words[a][0])
        lines[k] = put(line, words[a], words[b][0])
    return b"".join(lines)


def number_changed(data: bytes, rng: Rng) -> bytes:
    return put(data, one_word(data, rng, True), NUMBERS[int(rng.integers(len(NUMBERS)))])


def number_moved(data: bytes, rng: Rng) -> bytes:
    """Another digit, sign or size of a number."""
    word = one_word(data, rng, True)
    if word is None:
        return data
    old, k = word[0], int(rng.integers(len(word[0])))
    ways = (
        old[:k] + b"%d" % rng.integers(10) + old[k + 1 :],
        old[:k] + b"%d" % rng.integers(10) + old[k:],
        old[:k] + old[k + 1 :],
        b"-" + old,
        repr(float(old) * float(rng.choice([0.999, 1.001, 10.0, -1.0, 1e3]))).encode(),
        old + b"." * (b"." not in old) + b"000",
    )
    return put(data, word, ways[int(rng.integers(len(ways)))])


def name_changed(data: bytes, rng: Rng) -> bytes:
    """Another tag, column or key: misspelt, or one from elsewhere in the file."""
    word, other = one_word(data, rng, False), one_word(data, rng, False)
    if word is None or other is None:
        return data
    old, k = word[0], int(rng.integers(len(word[0])))
    ways = (
        old[:k] + old[k + 1 :],
        old[:k] + b"%c" % rng.integers(65, 123) + old[k:],
        old[:k] + old[k + 1 : k + 2] + old[k : k + 1] + old[k + 2 :],
        old.swapcase(),
        old + b"%d" % rng.integers(10),
        other[0],
        other[0],
        b"X_" + old,
    )
    return put(data, word, ways[int(rng.integers(len(ways)))])


def encoded(data: bytes, rng: Rng) -> bytes:
    text, k = data.decode("utf-8", "replace"), at(data, rng)
    ways: tuple[Callable[[], bytes], ...] = (
        lambda: text.encode("utf-16"),
        lambda: text.encode("utf-16-le"),
        lambda: text.encode("utf-32"),
        lambda: b"\xef\xbb\xbf" + data,
        lambda: data[:k] + b"\xef\xbb\xbf" + data[k:],
        lambda: data.replace(b" ", b"\xc2\xa0", 1),
        lambda: data.replace(b" ", b"\xa0", 1),
        lambda: data.replace(b"E", "Е".encode(), 1),
        lambda: data.replace(b"\n", b"\r"),
        lambda: data.replace(b"-", "−".encode(), 1),
        lambda: data.replace(b".", b",", 1),
        lambda: data.replace(b",", b";"),
        lambda: data[:k] + "ä".encode("latin-1") + data[k:],
    )
    return ways[int(rng.integers(len(ways)))]()


def control(data: bytes, rng: Rng) -> bytes:
    k = at(data, rng)
    return data[:k] + CONTROL[int(rng.integers(len(CONTROL)))] + data[k + int(rng.integers(2)) :]


def truncated(data: bytes, rng: Rng) -> bytes:
    return data[: at(data, rng)]


def harmless(data: bytes, rng: Rng) -> bytes:
    """Blanks, empty lines, comments, ends and the order of lines."""
    lines = some_lines(data)
    k = int(rng.integers(len(lines) + 1))
    order = rng.permutation(len(lines))
    ways: tuple[Callable[[], bytes], ...] = (
        lambda: data.replace(b" ", (b"  ", b"\t", b" \t ")[k % 3]),
        lambda: b"".join([*lines[:k], b"\n", *lines[k:]]),
        lambda: b"".join([*lines[:k], b"# a comment, 1 2 3\n", *lines[k:]]),
        lambda: data.replace(b"\n", b"\r\n"),
        lambda: data.replace(b"\n", b"\n  "),
        lambda: data.replace(b"\n", b" \n"),
        lambda: data.rstrip(b"\n"),
        lambda: b"".join(lines[n].rstrip(b"\n") + b"\n" for n in order.tolist()),
    )
    return ways[int(rng.integers(len(ways)))]()


def columns_moved(data: bytes, rng: Rng) -> bytes:
    """The columns of a table in another order."""
    cells = [line.split(b",") for line in data.splitlines()]
    if len({len(row) for row in cells}) != 1 or len(cells[0]) < 2 or b'"' in data:
        return harmless(data, rng)
    order = rng.permutation(len(cells[0])).tolist()
    return b"".join(b",".join(row[k] for k in order) + b"\n" for row in cells)


BINARY: dict[str, Callable[[bytes, Rng], bytes]] = {
    "bits": bits,
    "bytes": some_bytes,
    "block cut": block_cut,
    "block twice": block_twice,
    "truncated": truncated,
}
TEXT = {
    **BINARY,
    "signs": signs,
    "lines swapped": lines_swapped,
    "line": line_changed,
    "words swapped": words_swapped,
    "number": number_changed,
    "digits": number_moved,
    "numbers": lambda data, rng: number_moved(number_changed(data, rng), rng),
    "name": name_changed,
    "encoding": encoded,
    "control": control,
    "harmless": harmless,
    "columns": columns_moved,
}


def mutated(data: bytes, others: Sequence[bytes], rng: Rng) -> tuple[str, bytes]:
    """A mutant and its name: one change, in a third of them up to four; unpacked and packed again in a third of those
    that are packed."""
    if data[:2] == GZIP and rng.random() < 0.3:
        name, inner = mutated(gzip.decompress(data), [], rng)
        return f"{name}, packed", gzip.compress(inner, mtime=0)
    if data[:4] == ZIP and rng.random() < 0.5:
        return _repacked(data, rng)
    kinds = BINARY if data[:2] in (GZIP, ZIP[:2]) else TEXT
    names, out = [], data
    for _ in range(1 if rng.random() < 0.7 else int(rng.integers(2, 5))):
        if others and rng.random() < 0.05:
            other = others[int(rng.integers(len(others)))]
            name, changed = "splice", out[: at(out, rng)] + other[at(other, rng) :]
        else:
            name = list(kinds)[int(rng.integers(len(kinds)))]
            changed = kinds[name](out, rng)
        names.append(name)
        out = changed
    return ", ".join(names), out


def _repacked(data: bytes, rng: Rng) -> tuple[str, bytes]:
    """An archive of which one member is another one, with checksums that are right."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = list(members)[int(rng.integers(len(members)))]
    text = members[name]
    if name.startswith("structure"):
        head, body = text[:128], text[128:]
        kind, new = mutated(body.decode("utf-32-le").encode(), [], rng)
        wide = new.decode("utf-8", "replace").encode("utf-32-le")
        text = re.sub(rb"<U[0-9]+", b"<U%d" % (len(wide) // 4), head).ljust(128)[:128] + wide
    else:
        kind = list(BINARY)[int(rng.integers(len(BINARY)))]
        text = BINARY[kind](text, rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for other, content in members.items():
            archive.writestr(zipfile.ZipInfo(other), text if other == name else content)
    return f"{kind}, packed", out.getvalue()
