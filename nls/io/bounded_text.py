"""The bytes of a text file as they come, refused as soon as they are known to be too much.

It takes more memory than is allowed: `PER_BYTE` for every byte and `PER_WORD` for every word and line. Or there are
more blanks and comments than `SLACK` bytes and `SHARE` times all others, or a word has more than `WORD` bytes.
"""

import re

import numpy as np

from models.errors import ResourceLimitError
from nls.linear.limits import default_limit, gigabytes

PER_BYTE, PER_WORD = 8, 100  # memory at the peak of reading, measured: at most 7 and 90 in every reader
SLACK, SHARE = 1 << 22, 4  # bytes of blanks and comments that a file may have, and more for every other byte
WORD = 1 << 22  # bytes of one word
BETWEEN = re.compile(rb"[\x00-\x20,]")  # words
COMMENT = re.compile(rb"[\n\r][ \t\v\f]*#[^\n\r]*")


class BoundedText:
    """The chunks of a text as they come, refused as soon as they are known to be too much.

    Parameters
    ----------
    subject : the file and a verb, for the message.
    """

    def __init__(self, subject: str) -> None:
        self.subject, self.limit = subject, default_limit()
        self.chunks: list[bytes] = []
        self.size = self.words = self.content = 0
        self.weighed = self.counted = 0  # chunks whose content, whose words are counted: only where it can matter
        self.word = 0  # bytes of the last chunks, where no word ends in them
        self.line = b"\n"  # the last line so far: blanks, a comment ("\n#") or something else ("x")

    def add(self, chunk: bytes) -> None:
        """One more chunk.

        Raises
        ------
        ResourceLimitError
        """
        self.chunks.append(chunk)
        self.size += len(chunk)
        self.word = 0 if BETWEEN.search(chunk) else self.word + len(chunk)
        if self.word > WORD:
            much = f"{self.subject} a word of {self.word:,} bytes or more, the limit is {WORD:,}"
            cure = "expected tags and numbers with blanks between them"
            raise ResourceLimitError(f"{much}; {cure}", self.word, WORD, "word")
        if self.size > SLACK:
            self.content += sum(map(self._content, self.chunks[self.weighed :]))
            self.weighed = len(self.chunks)
            idle, allowed = self.size - self.content, SLACK + SHARE * self.content
            if idle > allowed:
                much = f"{idle:,} bytes or more of blanks, commas and comments beside {self.content:,} others"
                message = f"{self.subject} {much}, the limit is {allowed:,}; take them out"
                raise ResourceLimitError(message, idle, allowed, "blanks and comments")
        if (PER_BYTE + PER_WORD) * self.size > self.limit:
            self.words += sum(map(_words, self.chunks[self.counted :]))
            self.counted = len(self.chunks)
            self.refuse_above(self.size, self.words)

    def add_binary(self, chunk: bytes) -> None:
        """One more chunk of something that is no text.

        Raises
        ------
        ResourceLimitError
        """
        self.chunks.append(chunk)
        self.size += len(chunk)
        self.refuse_above(self.size)

    def refuse_above(self, size: int, words: int = 0) -> None:
        """Refuse a text of so many bytes, and so many words and lines, when reading it takes more than the limit.

        Raises
        ------
        ResourceLimitError
        """
        needed = float(PER_BYTE * size + PER_WORD * words)
        if needed > self.limit:
            much = f"{self.subject} {size:,} bytes or more, to read them takes {gigabytes(needed)} of memory or more"
            cure = f"the limit is {gigabytes(self.limit)}; split the file or leave lines out"
            raise ResourceLimitError(f"{much}, {cure}", needed, self.limit, "reading")

    def _content(self, chunk: bytes) -> int:
        """The bytes of the next chunk that are neither blanks, nor commas, nor in comments."""
        before, end = self.line, max(chunk.rfind(b"\n"), chunk.rfind(b"\r"))
        start = chunk[end + 1 :].lstrip()[:1]
        if end >= 0 or before == b"\n":
            self.line = {b"": b"\n", b"#": b"\n#"}.get(start, b"x")
        text = chunk
        if b"#" in before or b"#" in chunk:
            text = COMMENT.sub(b"", before + chunk).removeprefix(b"x")
        dark = np.frombuffer(text, dtype=np.uint8) > 0x20
        # the search for a comma takes a tenth of the time
        return int(np.count_nonzero(dark)) - (text.count(b",") if b"," in text else 0)


def _words(chunk: bytes) -> int:
    """The words, lines and cells of a chunk, or one more; cells of a table may be empty."""
    dark = np.frombuffer(chunk, dtype=np.uint8) > 0x20
    lines = max(chunk.count(b"\n"), chunk.count(b"\r"))
    return int(np.count_nonzero(dark[:-1] > dark[1:])) + 1 + lines + chunk.count(b",") + chunk.count(b'"')
