"""Decimal numbers of a text, eight characters at a time, by arithmetic on whole arrays of 64-bit words.

Every byte of the text is first turned into its mark. This is the value of a digit, 16 for a point, 128 and more for all
others. The last eight marks of a token are one word, the eight before them another where it is longer. In a word

    a point is closed up: the marks in front of it move one place,
    neighbors are joined: pairs of digits 10 a + b, pairs of those 100 a + b, and 10,000 a + b.

The number is an integer w up to 2^53 divided by a power of ten up to 10^22. Both are exact, and so the one rounding is
that of the division: the correctly rounded number (W. Clinger, "How to read floating point numbers accurately", 1990).

A longer number, or one with an exponent, has three words: w < 2^64. With p the first 64 bits of 10^k, the product w p
of 128 bits is below the number by less than 2^64. So the number's first 64 bits are known up to 4. They round to 53 but
for one number in 512, which is left unread (D. Lemire, "Number parsing at a gigabyte per second", 2021).
"""

import numpy as np
import numpy.typing as npt

from models.algebra import Array, Index, Mask, Numbers

Words = npt.NDArray[np.uint64]
Bytes = npt.NDArray[np.uint8]
Places = npt.NDArray[np.int8]
Digits = tuple[Words, Places, Mask]
"""The integer without its point, the digits behind it or `NO_POINT`, and whether they are digits and one point."""

KNOWN = {b".": 0x10, b"-": 0x81, b"+": 0x82, b"eE": 0x83, b" \t\v\f\r": 0xC0, b"\n": 0xC1}  # blanks last
KNOWN |= {b"%d" % digit: digit for digit in range(10)}
MARKS = bytes(next((mark for known, mark in KNOWN.items() if byte in known), 0x80) for byte in range(256))
MINUS, PLUS, EXPONENT, BLANK, LINE_END = (MARKS[byte] for byte in b"-+e \n")
PAD = 24  # bytes needed in front of the first token: its words begin before it
BLOCK = 1 << 14  # tokens at a time: their words stay in the cache

LAST = np.array([2**64 - 2 ** (64 - 8 * k) for k in range(9)], dtype=np.uint64)  # the last k bytes of a word
NO_POINT = -1  # in the place of the count of digits behind it
POWERS = 10.0 ** np.arange(23)  # all exact
SCALES = np.concatenate([[1.0], POWERS, [-1.0], -POWERS])  # by SIGN + digits behind the point
SIGN = np.array([1, len(POWERS) + 2], dtype=np.int8)  # of positive and of negative numbers
LARGEST_POWER = 50  # powers of ten beyond which a number is left unread


def _tens() -> tuple[Words, Numbers]:
    """The first 64 bits of 10^k up to the largest powers, and what their last one counts as a power of 2, plus 63."""
    bits, exponents = [], []
    for k in range(-LARGEST_POWER, LARGEST_POWER + 1):
        n = 10 ** abs(k)
        size = n.bit_length()
        bits.append((n << 64) >> size if k >= 0 else (1 << size + 63) // n)
        exponents.append(size - 1 if k >= 0 else -size)
    return np.array(bits, dtype=np.uint64), np.array(exponents)


TENS, EXPONENTS = _tens()
UNREAD, WHOLE = 0, 1  # forms of a number: to be read otherwise, digits alone; 2 with a point or exponent


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

    Read are a sign or none, at most 24 digits and point together, and an exponent of a sign and two digits or none.
    """
    value, form = np.empty(len(starts)), np.empty(len(starts), dtype=np.uint8)
    window, mark = windows(marks), np.frombuffer(marks, dtype=np.uint8)
    for begin in range(0, len(starts), BLOCK):
        block = slice(begin, begin + BLOCK)
        negative, length = _unsigned(mark, starts[block], ends[block])
        w, behind, plain = _digits(window, ends[block], length)
        plain &= (length <= 16) & (w <= 2**53)
        integer = w.view(np.int64)  # the faster one to divide
        np.divide(integer, SCALES.take(behind + SIGN.take(negative), mode="clip"), out=value[block])
        np.left_shift(plain.view(np.uint8), behind != NO_POINT, out=form[block])
    unread = (form == UNREAD).nonzero()[0]
    first = mark.take(starts[unread])
    unread = unread[(first < MARKS[0]) | (first == MINUS) | (first == PLUS)]  # a digit, a point or a sign
    most = max(BLOCK // 2, 1)  # twice as many at once, and the system is asked for memory all the time
    for begin in range(0, len(unread), most):
        chunk = unread[begin : begin + most]
        value[chunk], form[chunk] = _longer(window, mark, starts[chunk], ends[chunk])
    return value, form


def _unsigned(mark: Bytes, starts: Index, ends: Index) -> tuple[Mask, Index]:
    """Tokens that begin with a minus (n,), and the lengths of all without their signs."""
    first, length = mark.take(starts), ends - starts
    negative = first == MINUS
    length -= negative | (first == PLUS)
    return negative, length


def _longer(window: Words, mark: Bytes, starts: Index, ends: Index) -> tuple[Array, Bytes]:
    """Numbers of three words, with an exponent of a sign and two digits or none."""
    negative, length = _unsigned(mark, starts, ends)
    tail = 4 * (mark[ends - 4] == EXPONENT)
    sign, ten, unit = (mark[ends - k] for k in (3, 2, 1))  # a ten that is no digit is 16 or more: too large
    exponent = np.where(tail > 0, 10 * ten.astype(np.intp) + unit, 0)
    plain = (tail == 0) | (((sign == MINUS) | (sign == PLUS)) & (unit < 10))
    ends, length = ends - tail, length - tail
    w, behind, fine = _digits(window, ends, length)
    if len(long := (length > 16).nonzero()[0]):
        before = _eight(words(window, ends[long] - 16, length[long] - 16))
        w[long], behind[long], fine[long] = _joined(before, (w[long], behind[long], fine[long]), 16)
        fine[long] &= before[0] < 1843  # the integer is below 2^64
    shift = np.where(sign == MINUS, -exponent, exponent) - np.maximum(behind, 0)
    plain &= fine & (length <= 24) & (np.abs(shift) <= LARGEST_POWER)
    bits, certain = _scaled(w, shift)
    bits |= negative.astype(np.uint64) << 63
    return bits.view(float), (plain & certain) * np.uint8(2)


def _scaled(w: Words, shift: Index) -> tuple[Words, Mask]:
    """Bits of w 10^shift (n,), correctly rounded where that is certain, which it never is of 0."""
    # too large by 1 just below a power of two, where nothing is certain then
    top = w.astype(float).view(np.int64) >> 52
    w = w << (1086 - top).view(np.uint64)
    p = TENS.take(shift + LARGEST_POWER, mode="clip")
    low = np.uint64(0xFFFFFFFF)
    a, b, c, d = w >> 32, w & low, p >> 32, p & low
    ad, bc = a * d, b * c
    middle = (b * d >> 32) + (ad & low) + (bc & low)
    high = a * c + (ad >> 32) + (bc >> 32) + (middle >> 32)
    short = 1 - (high >> 63)
    high <<= short
    rest = high & 0x7FF
    exponent = EXPONENTS.take(shift + LARGEST_POWER, mode="clip") + top - short.view(np.int64)
    bits = (high >> 11) + (rest > 0x400) + (exponent << 52).view(np.uint64)
    return bits, (rest - 0x3FD > 3) & (high >> 63 > 0)  # half is 0x400


def _digits(window: Words, ends: Index, length: Index) -> Digits:
    """The last two words of tokens."""
    n, long = len(ends), (length > 8).nonzero()[0]
    w = words(window, np.concatenate([ends, ends[long] - 8]), np.concatenate([length, length[long] - 8]))
    integer, behind, plain = _eight(w)
    before = integer[n:], behind[n:], plain[n:]
    integer, behind, plain = integer[:n], behind[:n], plain[:n]
    integer[long], behind[long], plain[long] = _joined(before, (integer[long], behind[long], plain[long]), 8)
    plain &= length > (behind != NO_POINT)
    return integer, behind, plain


def _joined(before: Digits, last: Digits, places: int) -> Digits:
    """Digits, and those of so many characters behind them."""
    pointed, whole = last[1] != NO_POINT, before[1] == NO_POINT
    integer = before[0] * np.where(pointed, np.uint64(10 ** (places - 1)), np.uint64(10**places)) + last[0]
    return integer, np.where(whole, last[1], before[1] + np.int8(places)), before[2] & last[2] & (whole | ~pointed)


def _eight(w: Words) -> Digits:
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
