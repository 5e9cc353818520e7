"""``nls stream``: the measurements of a file or a pipe as they arrive, and a line of JSON for every step."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shlex
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from io import BufferedReader
from itertools import chain, dropwhile, pairwise
from time import perf_counter
from typing import Any, cast

import nls
from factors.base import Factor
from factors.definite import diagonal
from factors.replaced import replaced
from factors.robust import kernel_from_text
from models import SE2, SE3, LieGroup
from models.algebra import Index
from models.finite import finite_or_none
from nls.cli.outputs import input_name, refuse_unwritable
from nls.gauge import fixed_variables
from nls.incremental.checkpoint import read_smoother, smoother_bytes
from nls.incremental.steps import Arrived, steps
from nls.io import ids
from nls.io.dialects import TAGGED
from nls.io.files import GZIP, ZIP, read_bytes, read_stream, write_bytes
from nls.io.formats import FORMATS, Format, Reading, by_content
from nls.io.read import read_graph
from nls.io.records import KINDS
from nls.io.unused_lines import not_there

EVERY = 100  # steps from one checkpoint to the next
AT_ONCE, LONGEST = 1 << 20, 1 << 22  # bytes of a pipe, and of a line, at most
OF_SWITCH = b"|".join((ids.VERTEX, ids.PRIOR))
PARAMETERS, SWITCH, VERTEX, FIX = (
    re.compile(rb"^[ \t]*" + tag + rb"[^\n]*(?:\n|\Z)", re.MULTILINE)
    for tag in (rb"PARAMS_", rb"(?:%s)\b" % OF_SWITCH, rb"(?!(?:%s)\b)VERTEX" % OF_SWITCH, rb"FIX\b")
)
LINE_END = rb"\r*\n"  # a line is what `Text` counts as one: a carriage return alone ends none
MEASUREMENT = re.compile(rb"^[ \t]*(?!PARAMS_|(?:%s)\b)[^#\s]" % OF_SWITCH, re.MULTILINE)
SETTINGS = "tol", "lag", "landmarks", "robust", "convention", "dialect", "repair_information", "ignore_tags"


@dataclass
class Session:
    """How far a stream is.

    The last step of a file may go on in a longer one: a checkpoint at the end has the estimate before it.

    Attributes
    ----------
    smoother : the estimate.
    step, line : the last ones that are in it.
    printed : line up to which steps were printed.
    digest : of all lines up to that one.
    """

    smoother: nls.Incremental
    step: int = 0
    line: int = 0
    printed: int = 0
    digest: str = ""


def stream(options: argparse.Namespace) -> int:
    """Read, settle and print, step by step; returns the exit status."""
    if options.checkpoint is not None:
        refuse_unwritable({"--checkpoint": options.checkpoint}, options.file)
    if os.path.isdir(options.file):
        file = f"{os.path.basename(os.path.abspath(options.file))}.npz"
        cure = f"nls convert {shlex.join([options.file, file])} writes one"
        raise nls.GraphFileError(f"is a folder; expected a file or a pipe: {cure}", options.file)
    session, name = _begun(options), input_name(options.file)
    options.phase.now(f"while streaming {name}")
    reader = _Reader(options, session)
    same = False
    for arrived, values, last in _arrivals(options, reader):
        if not same and arrived.line >= session.printed:
            _refuse_other(options, session, reader)
            same = True
        state = _checkpoint(options, session, reader, arrived.line) if last else b""
        began = perf_counter()
        session.smoother.update(arrived.factors, values)
        session.step, session.line = session.step + 1, arrived.line
        if arrived.line > session.printed:
            facts = _facts(session, arrived, 1e3 * (perf_counter() - began))
            print(json.dumps(finite_or_none(facts)), flush=True)
            session.printed = arrived.line
        if session.step % EVERY == 0 and same and not last:
            state = _checkpoint(options, session, reader, arrived.line)
        if state:
            write_bytes(options.checkpoint, state)
    for note in not_there(options.ignore_tags, reader.tags):
        warnings.warn(f"{name}: {note}", nls.GraphWarning, stacklevel=2)
    if not session.step:
        raise nls.GraphFileError("has no measurement: nothing to stream", name)
    if not same:
        _refuse_other(options, session, reader)
    if options.checkpoint is not None and options.file == "-":
        write_bytes(options.checkpoint, _checkpoint(options, session, reader, session.line))
    return 0


def _arrivals(options: argparse.Namespace, reader: _Reader) -> Iterator[tuple[Arrived, nls.Values, bool]]:
    """Steps, what is said of their variables, and whether a step is the last: of a file, nobody knows it of a pipe."""
    arrivals = chain.from_iterable(map(reader.steps, _blocks(options)))
    end: list[Any] = [None]
    if options.file == "-":
        yield from ((*arrival, False) for arrival in arrivals)
    else:
        yield from ((*arrival, ahead is None) for arrival, ahead in pairwise(chain(arrivals, end)))


def _facts(session: Session, arrived: Arrived, milliseconds: float) -> dict[str, Any]:
    """The facts that are printed of a step."""
    smoother = session.smoother
    facts = {
        "step": session.step,
        "variable": repr(arrived.pose),
        "estimate": smoother[arrived.pose].tolist() if arrived.pose in smoother else None,
        "chi2": smoother.chi2,
        "gap": smoother.gap,
        "milliseconds": round(milliseconds, 3),
    }
    more = {"waiting": [*map(repr, smoother.waiting)], "behind": sum(map(len, smoother.behind))}
    return facts | {key: value for key, value in more.items() if value}


def _blocks(options: argparse.Namespace) -> Iterator[bytes]:
    """Whole lines as they come: a file at once, of a pipe what is there."""
    if options.file != "-":
        yield read_bytes(options.file, archive=True)
        return
    name = input_name(options.file)
    if sys.stdin is None:
        raise nls.GraphFileError("cannot be read: standard input is closed", name)
    pipe = cast(BufferedReader, sys.stdin.buffer)
    if pipe.peek(2)[:2] in (GZIP, ZIP[:2]) or pipe.peek(1)[:1] == b"{":  # no lines
        yield read_stream(pipe, name, archive=True)
        return
    rest = b""
    for block in iter(partial(pipe.read1, AT_ONCE), b""):
        lines, newline, rest = (rest + block).rpartition(b"\n")
        if newline:
            yield lines + newline
        if len(rest) > LONGEST:
            raise nls.GraphFileError(f"has a line of more than {LONGEST:,} bytes: this is no graph", name)
    if rest:
        yield rest


class _Reader:
    """The steps of blocks of lines, which are numbered from the first block on."""

    def __init__(self, options: argparse.Namespace, session: Session) -> None:
        self.options, self.name, self.dialect = options, input_name(options.file), options.dialect
        self._done = session.line  # the last that is in the estimate
        self.before, self._parameters, self._vertices, self._begun = 0, b"", b"", session.step > 0
        self._switches = b""  # of edges to come
        self.tags: set[str] = set()
        self._fixed: set[bytes] = set()
        self._keyed, self._plain = set[str](), set[str]()  # kinds by their ids, in all blocks
        self._numbers: dict[str, set[int]] = {kind: set() for kind in KINDS.values()}
        self._lines: list[bytes] = []  # that are not in the digest yet, where one is wanted
        self._hash, self._hashed = hashlib.sha256(), 0

    def steps(self, block: bytes) -> Iterator[tuple[Arrived, nls.Values]]:
        """The measurements of a block as they arrive, and what is said of their variables."""
        row = by_content(block, self.name)[0] if self.dialect == "auto" else FORMATS[self.dialect]
        if row is not None and row.whole:
            yield from self._whole(block, row)
            return
        before, self.before = self.before, self.before + block.count(b"\n")
        if self.options.checkpoint is not None:
            *whole, rest = re.split(LINE_END, block)
            self._lines += [*whole, rest] if rest else whole
        self._fixed.update(word for line in FIX.findall(block) for word in line.split()[1:])
        self._refuse_held(len(self._fixed))
        if row is not None and row.timeless:
            raise nls.GraphFileError(row.timeless, self.name)
        if row is not None and not row.tagged:
            named = Reading(self.options.convention, ignore_tags=self.options.ignore_tags)
            yield from self._arriving(*row.read(named, block, self.name))
            return
        if not self._begun:
            self._vertices += b"".join(VERTEX.findall(block))
        head = self._parameters + self._switches
        data = head + FIX.sub(b"\n", VERTEX.sub(b"\n", block))
        before -= head.count(b"\n")
        self._parameters += b"".join(PARAMETERS.findall(block))
        if MEASUREMENT.search(data) is None:
            self._switches += b"".join(SWITCH.findall(block))
            return
        how = self.options.convention, self.dialect, self.options.repair_information
        graph, values, report = read_graph(data, self.name, *how, before, False, self.options.ignore_tags)
        self.dialect = report.format
        unused = "\n".join([*report.ignored, ""]).encode("utf-8", "surrogateescape")
        self._switches = b"".join(SWITCH.findall(unused))
        self._keyed |= set(report.gtsam_kinds)
        self._plain |= set(values.stacks) - set(report.gtsam_kinds)
        if both := self._keyed & self._plain:
            two = f"uses {min(both)} as an id and as a key of GTSAM; give the file, not a pipe"
            raise nls.GraphFileError(two, self.name)
        self._refuse_two_things(graph, report)
        yield from self._arriving(graph, values, report)

    def _refuse_two_things(self, graph: nls.FactorGraph, report: nls.LoadReport) -> None:
        """Refuse a number that is a pose in one block and a point in another: what a line is about, others say."""
        format, tags = TAGGED[report.format], {*self.tags, *report.tags}
        if format.apart or any(record.apart for record in format.records if record.tag.decode() in tags):
            return
        plain = self._numbers.keys() - set(report.gtsam_kinds)
        for keys in (keys for factor in graph.factors for keys in factor.keys if keys.kind in plain):
            numbers = set(keys.numbers.tolist())
            for kind in plain - {keys.kind}:
                if both := numbers & self._numbers[kind]:
                    two = f"{kind}{min(both)} in one part of the stream and {keys.kind}{min(both)} in another"
                    raise nls.GraphFileError(f"has one number for {two}; give the file, not a pipe", self.name)
            self._numbers[keys.kind] |= numbers

    def _whole(self, block: bytes, row: Format) -> Iterator[tuple[Arrived, nls.Values]]:
        """The steps of a file without lines, in the order of their newest poses."""
        graph, values, report = row.read(Reading(), block, self.name)
        self._refuse_held(int(fixed_variables(graph.fixed, values).sum()))
        self._hash.update(block)
        yield from self._arriving(graph, values, report)

    def _refuse_held(self, count: int) -> None:
        """Refuse a file that holds several variables."""
        if count > 1:
            held = f"fixes {count} variables; a stream fixes its first pose alone, so give the others priors"
            raise nls.GraphFileError(held, self.name)

    def _arriving(
        self, graph: nls.FactorGraph, values: nls.Values, report: nls.LoadReport
    ) -> Iterator[tuple[Arrived, nls.Values]]:
        """The measurements of a graph that was read, step by step."""
        self.tags.update(report.tags)
        for note in report.warnings:
            warnings.warn(f"{self.name}: {note}", nls.GraphWarning, stacklevel=2)
        if self.options.robust is not None:
            graph = graph.robust(kernel_from_text(self.options.robust))
        places = {factor.keys[slot].kind for factor in graph.factors for slot in factor.unmoved}
        moved = [stack for stack in values.stacks.values() if stack.kind not in places]
        poses = [s.kind for s in moved if s.manifold in (SE2, SE3)]
        kinds = poses or [s.kind for s in moved if isinstance(s.manifold, LieGroup)][:1] or ["x"]
        lines = [source.lines for source in report.sources] if report.has_lines else None
        for arrived in self._new(graph.factors, lines, kinds):
            arrived = replace(arrived, factors=[*map(_alone, arrived.factors)])
            yield arrived, values.spaces() if self._begun else self._beginning(arrived, values)
            self._begun = True

    def _new(self, factors: list[Factor], lines: list[Index] | None, kinds: list[str]) -> Iterator[Arrived]:
        """The steps of measurements that are not in the estimate yet."""
        if lines is None:
            yield from dropwhile(lambda arrived: arrived.line <= self._done, steps(factors, None, kinds))
            return
        masks = [at > self._done for at in lines]
        rest = [(factor[new], at[new]) for factor, at, new in zip(factors, lines, masks, strict=True) if new.any()]
        if rest:
            yield from steps([factor for factor, _ in rest], [at for _, at in rest], kinds)

    def _beginning(self, arrived: Arrived, values: nls.Values) -> nls.Values:
        """The first pose of a stream: as its vertex has it, otherwise in the origin."""
        kind = arrived.pose.kind
        first = min(int(keys.numbers.min()) for f in arrived.factors for keys in f.keys if keys.kind == kind)
        given = values.stack(kind)
        if self._vertices:
            given = read_graph(self._vertices, self.name, "g2o", self.dialect)[1].stacks.get(kind, given)
        here = given.numbers == first
        X = given.X[here] if here.any() else given.manifold.identity(1)
        return values.spaces().extended(nls.Keys(kind, first), X)

    def digest(self, line: int) -> str:
        """Of all lines up to one."""
        count = line - self._hashed
        self._hash.update(b"".join(text + b"\n" for text in self._lines[:count]))
        del self._lines[:count]
        self._hashed = line
        return self._hash.hexdigest()


def _alone(factor: Factor) -> Factor:
    """Measurements as in a file of their own: one full matrix in a file makes the whiteners of all full."""
    model = factor._model
    full = model is None or (model.W.ndim == 3 and diagonal(model.W) is not None)
    return replaced(factor) if full else factor


def _begun(options: argparse.Namespace) -> Session:
    """The session of the checkpoint, or a new one.

    Raises
    ------
    GraphFileError
        No checkpoint, or one of other options.
    """
    path = options.checkpoint
    if path is None or not os.path.exists(path):
        return Session(nls.Incremental(options.tol, options.lag, options.landmarks))
    smoother, about = read_smoother(path, nls.Incremental)
    if about.keys() != {"settings", "step", "line", "printed", "digest"}:
        raise nls.GraphFileError("is a smoother that nls stream did not write; give --checkpoint another name", path)
    for name, value in about.pop("settings").items():
        if (given := getattr(options, name)) != value:
            was, now = (_option(name, v) for v in (value, given))
            raise nls.GraphFileError(f"was made {was}, not {now}; give the same options, or remove it", path)
    return Session(smoother, **about)


def _option(name: str, value: object) -> str:
    """How an option was given.

    Examples
    --------
    >>> _option("lag", 5), _option("repair_information", True), _option("ignore_tags", "")
    ('with --lag 5', 'with --repair-information', 'without --ignore-tags')
    """
    option = "--" + name.replace("_", "-")
    if value is None or value is False or value == "":
        return f"without {option}"
    return f"with {option}" if value is True else f"with {option} {shlex.quote(str(value))}"


def _checkpoint(options: argparse.Namespace, session: Session, reader: _Reader, line: int) -> bytes:
    """The bytes of a checkpoint whose steps are printed up to a line; none where none is wanted."""
    if options.checkpoint is None:
        return b""
    settings = {name: getattr(options, name) for name in SETTINGS}
    how_far = {"step": session.step, "line": session.line, "printed": line, "digest": reader.digest(line)}
    return smoother_bytes(session.smoother, {"settings": settings, **how_far})


def _refuse_other(options: argparse.Namespace, session: Session, reader: _Reader) -> None:
    """Refuse an input that does not begin with the lines a checkpoint was made of."""
    if session.printed and reader.digest(session.printed) != session.digest:
        raise nls.GraphFileError(
            f"its first {session.printed} lines differ from the input that {options.checkpoint} was made of; give that "
            "input from its beginning, or remove the checkpoint",
            input_name(options.file),
        )
