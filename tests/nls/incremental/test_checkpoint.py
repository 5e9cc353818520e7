"""A checkpoint: what goes on from it is equal to the bit, what is damaged is refused, and nothing in it is run."""

from __future__ import annotations

import io
import pickle
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim
from factors import Bearing, Between, Factor, Huber, Isotropic, Prior
from models import SE2, R
from models.errors import GraphError, GraphFileError, LeadlineError
from nls import FactorGraph, Incremental, Values, kinds, save
from nls.incremental import checkpoint
from nls.incremental.checkpoint import read_smoother, smoother_bytes
from nls.incremental.steps import steps

x, l = kinds("x", "l")
START = Values({x: (SE2, [[0.0, 0.0, 0.0]]), l: (R(2), np.zeros((0, 2)), [])})
Updates = list[list[Factor]]


def ring() -> Updates:
    world = sim.ring(np.random.default_rng(6), laps=3, per_lap=20)
    return [step.factors for step in steps(world.graph.factors)]


def wrong() -> Updates:
    """The ring with two wrong closures, which a decision takes out."""
    closure = Between(x[[2, 5]], x[[30, 22]], [[9.0, 0.0, 1.0], [0.0, 9.0, 2.0]], Isotropic(0.05))
    updates = ring()
    updates[35] = [*updates[35], closure]
    return updates


def bearings() -> Updates:
    """Poses on a line that see landmarks by bearing: these wait for a second sighting, and leave with a lag."""
    rng = np.random.default_rng(3)
    L = np.column_stack([np.arange(0, 40, 2.0), rng.uniform(3, 6, 20)])
    updates: Updates = [[Prior(x[0], [0.0, 0.0, 0.0], Isotropic(0.01))]]
    for k in range(1, 40):
        updates.append([Between(x[k - 1], x[k], rng.normal([1.0, 0.0, 0.0], 0.02), Isotropic(0.05))])
        seen = np.flatnonzero(np.abs(L[:, 0] - k) < 4)
        angles = np.arctan2(L[seen, 1], L[seen, 0] - k) + rng.normal(0, 0.01, len(seen))
        updates[-1].append(Bearing(x[np.full(len(seen), k)], l[seen], angles[:, None], Isotropic(0.02)))
    return updates


def huber() -> Updates:
    return [[factor.robust(Huber(1.0)) for factor in update] for update in ring()]


WORLDS: dict[str, tuple[Callable[[], Updates], dict[str, Any]]] = {
    "ring": (ring, {}),
    "kernel": (huber, {}),
    "lag": (ring, {"lag": 12}),
    "decisions": (wrong, {"decide_every": 8}),
    "waiting": (bearings, {}),
    "landmarks that leave": (bearings, {"lag": 6}),
    "landmarks that stay": (bearings, {"lag": 6, "landmarks": "stay"}),
}


def drive(smoother: Incremental, updates: Updates, begin: int = 0) -> None:
    for k, update in enumerate(updates[begin:], begin):
        smoother.update(update, START if k == 0 else None)


def same(a: Incremental, b: Incremental) -> None:
    """Equal to the bit: all that goes on, and what stays behind."""
    assert (a.chi2, a.gap, a.passes, a.batch_solutions) == (b.chi2, b.gap, b.passes, b.batch_solutions)
    assert repr((a.waiting, a.pending, a.behind, a.rejected)) == repr((b.waiting, b.pending, b.behind, b.rejected))
    for one, other in ((a.values, b.values), (a.left, b.left)):
        assert one.stacks.keys() == other.stacks.keys()
        for kind, stack in one.stacks.items():
            np.testing.assert_array_equal(stack.X, other.stack(kind).X, strict=True)
            np.testing.assert_array_equal(stack.numbers, other.stack(kind).numbers)


@pytest.mark.parametrize("name", WORLDS)
def test_it_goes_on_as_if_it_had_never_stopped(name: str, tmp_path: Path) -> None:
    world, options = WORLDS[name]
    updates, path = world(), tmp_path / "state"
    whole = Incremental(**options)
    for k, update in enumerate(updates):
        if k % 18 == 4:
            whole.save(path)
            again = Incremental.load(path)
            same(again, whole)
            drive(again, updates, k)
            path.with_name(f"{k}").write_bytes(smoother_bytes(again))
        whole.update(update, START if k == 0 else None)
    ends = [Incremental.load(end) for end in sorted(tmp_path.glob("[0-9]*"))]
    assert len(ends) == len(range(4, len(updates), 18))
    for end in ends:
        same(end, whole)


def test_it_settles_removes_and_decides_as_before(tmp_path: Path) -> None:
    smoother = Incremental()
    drive(smoother, wrong())
    smoother.save(tmp_path / "state.gz")
    again = Incremental.load(tmp_path / "state.gz")
    for one in (smoother, again):
        one.decide()
        one.update([Between(x[58], x[59], [0.5, 0.0, 0.3], Isotropic(0.05))])
        one.remove(one.given[-1])
    same(smoother, again)
    assert smoother.rejected


def test_a_function_is_no_array(tmp_path: Path) -> None:
    smoother = Incremental()
    smoother.update(Factor.from_function(lambda X: X, x[0], 3), START)
    with pytest.raises(GraphError, match="is made of a function, and a file holds no code"):
        smoother.save(tmp_path / "state")
    assert not [*tmp_path.iterdir()]


def damaged(data: bytes, rng: np.random.Generator, count: int) -> Iterator[bytes]:
    """Bits, bytes, blocks and ends of a file that are not as they were."""
    for k in range(count):
        at, n = int(rng.integers(len(data))), int(rng.integers(1, 200))
        one = bytes([data[at] ^ 1 << int(rng.integers(8))]) if k % 4 == 0 else rng.bytes(1)
        yield data[:at] + (b"" if k % 4 == 3 else rng.bytes(n) + data[at + n :] if k % 4 == 2 else one + data[at + 1 :])


def test_what_is_damaged_is_refused_or_the_same(tmp_path: Path) -> None:
    smoother, path = Incremental(lag=6), tmp_path / "state"
    drive(smoother, bearings())
    whole = smoother_bytes(smoother)
    refused = []
    for data in damaged(whole, np.random.default_rng(0), 200):
        path.write_bytes(data)
        try:
            same(Incremental.load(path), smoother)
        except GraphFileError as error:
            refused.append(str(error))
    assert len(refused) > 150  # what is left are dates of the archive
    assert all(message.startswith(str(path)) for message in refused)


class Touch:
    """Unpickled it makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path,)


def crafted(smoother: Incremental, change: Callable[[dict[str, Any]], None]) -> bytes:
    """A checkpoint of other content whose checksum is right."""
    plain: dict[str, Any] = {}

    def changed(tree: dict[str, Any], arrays: dict[str, Any]) -> Any:
        plain.update(tree)
        change(plain)
        return without(plain, arrays)

    without = checkpoint.without_arrays
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checkpoint, "without_arrays", changed)
        return smoother_bytes(smoother)


def test_crafted_files_run_nothing(tmp_path: Path) -> None:
    path, touched = tmp_path / "state", tmp_path / "touched"
    smoother = Incremental()
    drive(smoother, ring())
    old = b"checkpoint of nls stream, version 1\n" + pickle.dumps(Touch(touched))
    member, arrays = io.BytesIO(), io.BytesIO()
    np.save(member, np.array([Touch(touched)], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(arrays, "w") as archive:
        archive.writestr("structure.npy", member.getvalue())

    def swap(name: str, value: Any) -> Callable[[dict[str, Any]], None]:
        return lambda plain: plain.update({name: value})

    entries = [{"is": "os.system", "of": "true"}, {"is": "Growing", "of": {}}, {"is": "list", "of": {"items": 3}}]
    forged = [crafted(smoother, swap("entries", (entry,))) for entry in entries]
    forged += [crafted(smoother, swap(*pair)) for pair in (("smoother", 7), ("version", 2), ("factors", None))]
    for data in (old, pickle.dumps(Touch(touched)), arrays.getvalue(), b"", b"hello", *forged):
        path.write_bytes(data)
        with pytest.raises(LeadlineError, match="checkpoint"):
            read_smoother(path, Incremental)
    assert not touched.exists()
    save(tmp_path / "graph.npz", FactorGraph(), Values())
    with pytest.raises(GraphFileError, match=r"is no checkpoint; expected what nls\.Incremental\.save or nls stream"):
        Incremental.load(tmp_path / "graph.npz")


HELD = {  # by a checkpoint of version 4: with other attributes it is another version
    "Arrivals": "_known _window _pending _tried",
    "Decision": "every rejected _new",
    "Growing": "rows room order",
    "GrowingBatch": "given variables _first kernel _own _index _z _W _A _columns _b _cost _linearized entered total "
    "_sparse",
    "GrowingSystem": "variables batches iterations factorizations _preconditioner _age _needed held _damping",
    "Known": "system spaces starts",
    "Preconditioner": "used rows n width _begun _added _by_columns",
    "Variables": "kind manifold place _X _numbers _columns",
    "Window": "lag landmarks behind _tracks _sensors _left",
    "Incremental": "tol gap passes batch_solutions _system _window _decision _arrivals _undecided",
}


def test_other_attributes_are_another_version() -> None:
    smoother, held = Incremental(1e-9), dict[str, str]()

    def look(plain: dict[str, Any]) -> None:
        entries = [entry["of"] for entry in plain["entries"] if entry["is"] in HELD]
        held.update(zip((e["is"] for e in plain["entries"] if e["is"] in HELD), map(" ".join, entries), strict=True))

    drive(smoother, ring())
    crafted(smoother, look)
    assert (checkpoint.VERSION, held) == (4, HELD)
