"""Decimal numbers of a text, eight characters at a time, by arithmetic on whole arrays of 64-bit words.

Every byte of the text is first turned into its mark: a digit into its value, a point into 16, all others into 128 and
more. The last eight marks of a token are one word, the eight before them another where it is longer. In a word

    a point is closed up: the marks in front of it move one place,
    neighbors are joined: pairs of digits 10 a + b, pairs of those 100 a + b, and 10,000 a + b.

The number is an integer up to 2^53 divided by a power of ten up to 10^22. Both are exact, and so the one rounding is
that of the division: the correctly rounded number (W. Clinger, "How to read floating point numbers accurately", 1990).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array, Index, Mask, Numbers

__all__ = ["MARKS", "PAD", "UNREAD", "WHOLE", "decimals"]
Words = npt.NDArray[np.uint64]
Bytes = npt.NDArray[np.uint8]
Places = npt.NDArray[np.int8]

POINT, OTHER, MINUS, PLUS, EXPONENT, BLANK, LINE_END = 0x10, 0x80, 0x81, 0x82, 0x83, 0xC0, 0xC1  # blanks last
KNOWN = {b".": POINT, b"-": MINUS, b"+": PLUS, b"eE": EXPONENT, b" \t\v\f\r": BLANK, b"\n": LINE_END}
KNOWN |= {b"%d" % digit: digit for digit in range(10)}
MARKS = bytes(next((mark for known, mark in KNOWN.items() if byte in known), OTHER) for byte in range(256))
PAD = 16  # bytes needed in front of the first token: its words begin before it
BLOCK = 1 << 14  # tokens at a time: their words stay in the cache

LAST = np.array([2**64 - 2 ** (64 - 8 * k) for k in range(9)], dtype=np.uint64)  # the last k bytes of a word
NO_POINT = -1  # in the place of the count of digits behind it
POWERS = 10.0 ** np.arange(23)  # all exact
SCALES = np.concatenate([[1.0], POWERS, [-1.0], -POWERS])  # by SIGN + digits behind the point
SIGN = np.array([1, len(POWERS) + 2], dtype=np.int8)  # of positive and of negative numbers
JOIN = np.array([10**8, 10**7], dtype=np.uint64)  # what the word before counts more, where the last one has a point
UNREAD, WHOLE, FRACTION = 0, 1, 2  # forms of a number: to be read otherwise, digits alone, with a point or exponent


def windows(text: bytes) -> Words:
    """The eight bytes from every place on as a word, its first byte the lowest: a view (n - 7,) of n bytes."""
    return np.ndarray(len(text) - 7, dtype="<u8", buffer=text, strides=(1,))


def words(window: Words, ends: Index, lengths: Index) -> Words:
    """The last eight bytes of tokens, (n,), zeros in front of shorter ones."""
    w = window[ends - 8]
    w &= LAST.take(lengths, mode="clip")
    return w


def decimals(marks: bytes, starts: Index, ends: Index) -> tuple[Array, Bytes]:
    """Correctly rounded numbers (n,) of tokens, and their forms (n,); those `UNREAD` have another number.

    Read are a sign or none, at most 16 digits and point together, and an exponent of a sign and two digits or none.
    """
    value, form = np.empty(len(starts)), np.empty(len(starts), dtype=np.uint8)
    window, mark = windows(marks), np.frombuffer(marks, dtype=np.uint8)
    for begin in range(0, len(starts), BLOCK):
        block = slice(begin, begin + BLOCK)
        negative, length = _unsigned(mark, starts[block], ends[block])
        integer, behind, plain = _integers(window, ends[block], length)
        np.divide(integer, SCALES.take(behind + SIGN.take(negative), mode="clip"), out=value[block])
        np.left_shift(plain.view(np.uint8), behind != NO_POINT, out=form[block])
    unread = (form == UNREAD).nonzero()[0]
    unread = unread[mark[ends[unread] - 4] == EXPONENT]
    for begin in range(0, len(unread), BLOCK):
        chunk = unread[begin : begin + BLOCK]
        negative, length = _unsigned(mark, starts[chunk], ends[chunk])
        value[chunk], form[chunk] = _with_exponent(window, mark, ends[chunk], length)
        value[chunk] *= 1.0 - 2.0 * negative
    return value, form


def _unsigned(mark: Bytes, starts: Index, ends: Index) -> tuple[Mask, Index]:
    """Which tokens begin with a minus, and the lengths of all without their signs."""
    first, length = mark.take(starts), ends - starts
    negative = first == MINUS
    length -= negative | (first == PLUS)
    return negative, length


def _with_exponent(window: Words, mark: Bytes, ends: Index, length: Index) -> tuple[Array, Bytes]:
    """Numbers without sign that end in an exponent of a sign and two digits."""
    sign, ten, unit = (mark[ends - k] for k in (3, 2, 1))  # a ten that is no digit is 16 or more: too large
    integer, behind, plain = _integers(window, ends - 4, length - 4)
    exponent = 10.0 * ten + unit
    shift = (np.where(sign == MINUS, -exponent, exponent) - np.maximum(behind, 0)).astype(np.intp)
    plain &= ((sign == MINUS) | (sign == PLUS)) & (unit < 10) & (np.abs(shift) <= 22)
    shift *= plain
    return integer * POWERS[np.maximum(shift, 0)] / POWERS[np.maximum(-shift, 0)], plain * np.uint8(FRACTION)


def _integers(window: Words, ends: Index, length: Index) -> tuple[Numbers, Places, Mask]:
    """Tokens of digits and at most one point: the integer without it, digits behind it or `NO_POINT`.

    And which tokens are such.
    """
    n, long = len(ends), (length > 8).nonzero()[0]
    more = length[long] - 8
    w = words(window, np.concatenate([ends, ends[long] - 8]), np.concatenate([length, more]))
    integer, behind, plain = _eight(w)
    high, before, fine = integer[n:], behind[n:], plain[n:]
    integer, behind, plain = integer[:n], behind[:n], plain[:n]
    after = behind[long]
    pointed, whole = after != NO_POINT, before == NO_POINT
    high *= JOIN.take(pointed)
    high += integer[long]
    integer[long] = high
    behind[long] = np.where(whole, after, before + 8)
    plain[long] &= fine & (more <= 8) & (whole | ~pointed) & (high <= 2**53)
    plain &= length > (behind != NO_POINT)
    return integer.view(np.int64), behind, plain


def _eight(w: Words) -> tuple[Words, Places, Mask]:
    """Words of digits and at most one point: the integer without it, digits behind it or `NO_POINT`.

    And which words are such.
    """
    point = w & 0x1010101010101010
    point &= -point  # the first one, in byte k
    w -= point
    point >>= 4
    point -= 1  # has 8 k bits, 64 without a point
    behind = 7 - (np.bitwise_count(point) >> 3).view(np.int8)
    point += point >> 63  # bytes 0 .. k - 1, none without a point
    point &= w
    point *= 255
    w += point  # what stood in front of it moved by one byte, over the point
    plain = (w & 0xF0F0F0F0F0F0F0F0) == 0
    w *= 1 + (10 << 8)
    w >>= 8
    w &= 0x00FF00FF00FF00FF
    w *= 1 + (100 << 16)
    w >>= 16
    w &= 0x0000FFFF0000FFFF
    w *= 1 + (10_000 << 32)
    w >>= 32
    return w, behind, plain
