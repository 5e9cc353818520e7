"""Names of variables in graph text files: letters of GTSAM, kinds that the files know, numbers that clash.

A key of GTSAM is a letter and a number in one id of 64 bits, ``c << 56 | k``; a second letter, the label, is at bit 48.
A vertex 6989586621679009836 is a44, number 44 of kind ``a``: the poses of robot a. With a label B it is aB44. Plain ids
beside them keep their kinds. An id that is neither leaves all as numbers, and so does one name for two things. The
*head* of an id are its letter and label, the 16 bits from bit 48: 0 of a plain number, -1 of neither.

A file in which all vertices share one numbering gets new numbers where they clash. It cannot say the old ones. Widely
used readers lose edges over a comment, and stop at an unknown tag. So a note states the old names, all of them.

Source: F. Dellaert and the GTSAM contributors, GTSAM 4, gtsam/inference/Symbol.h and LabeledSymbol.h.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from string import ascii_letters

import numpy as np

from factors.keys import Keys
from factors.replaced import replaced
from models import SE2, SE3, R
from models.algebra import Mask, Numbers
from models.errors import GraphError
from nls.graph import FactorGraph
from nls.io.records import KINDS, different
from nls.io.report import LoadReport
from nls.values import Stack, Values

BITS = 48  # of the number of a key
LETTERS = list(ascii_letters.encode())
SPACES = {SE2: "pose", SE3: "pose", R(2): "point", R(3): "point"}


def with_letters(
    graph: FactorGraph, values: Values, report: LoadReport, ids: Mapping[str, Numbers]
) -> tuple[FactorGraph, Values, LoadReport]:
    """A graph as read, its variables named by the letters and numbers of their keys; as it is where there are none.

    Parameters
    ----------
    graph, values, report : as read, the numbers of variables their ids.
    ids : of all vertices, by kind, rising.
    """
    if not any(int(n[-1]) >> BITS > 0 for n in ids.values() if len(n)):
        return graph, values, report
    heads = [(kind, head) for kind, n in ids.items() for head in different(_heads(n)).tolist()]
    letters = tuple(_name(*pair) for pair in heads if pair[1] > 0)
    if not letters:
        return graph, values, report
    names = [_name(*pair) for pair in heads]
    odd = ["others are neither that nor below 2^56"] * any(head < 0 for _, head in heads)
    odd += [f"{name} would be two kinds" for name in letters if names.count(name) > 1]
    if odd:
        report.notes.append(f"ids look like keys of GTSAM ({', '.join(letters)}), and are kept as numbers: {odd[0]}")
        return graph, values, report
    report.notes.append(f"ids are keys of GTSAM, a letter and a number in one: kinds {', '.join(letters)}")
    parts = [
        (k, mine, replaced(factor if mine.all() else factor[mine], keys))
        for k, factor in enumerate(graph.factors)
        for mine, keys in _parts(*factor.keys)
    ]
    stacks = []
    for stack in values.stacks.values():
        for mine, (key,) in _parts(Keys(stack.kind, stack.numbers if len(stack) else ids[stack.kind])):
            X = stack.X[mine] if len(stack) else stack.X
            stacks.append(Stack(key.kind, stack.manifold, X, key.numbers[: len(X)]))
    fixed = [key for keys in graph.fixed for _, (key,) in _parts(keys)]
    report = replace(report.of_parts(graph.factors, parts), gtsam_kinds=letters)
    return FactorGraph([part for _, _, part in parts], fixed), Values.of(stacks), report


def id_text(number: int) -> str:
    """An id in words, with its name where it is a key.

    Examples
    --------
    >>> id_text(17), id_text(ord("b") << 56 | 2)
    ('17', 'b2 (7061644215716937730)')
    """
    ((_, (key,)),) = _parts(Keys("", [number]))
    return f"{key!r} ({number})" if key.kind else str(number)


class VertexIds:
    """How the variables of a graph stand in a graph text file.

    Kinds x, l and o are poses, points and places of sensors with plain ids, unless the graph was read with keys of
    these letters. Other kinds of one or two letters have keys, and are what their space and their use says.

    Parameters
    ----------
    graph, values, report : as for `nls.save`.

    Attributes
    ----------
    roles : ``pose``, ``point`` or ``mount``, by kind; of kinds that have one.
    keyed : kinds whose ids are keys.
    """

    def __init__(self, graph: FactorGraph, values: Values, report: LoadReport | None) -> None:
        self.roles = {kind: role for role, kind in KINDS.items()}
        plain = set(self.roles) - set(() if report is None else report.gtsam_kinds)
        mounts = {factor.keys[slot].kind for factor in graph.factors for slot in factor.unmoved}
        spaces = {s.kind: SPACES[s.manifold] for s in values.stacks.values() if s.manifold in SPACES}
        self.keyed = {
            kind for kind in spaces if kind not in plain and kind.isascii() and kind.isalpha() and len(kind) < 3
        }
        for kind in sorted(self.keyed):
            self.roles[kind] = "mount" if spaces[kind] == "pose" and kind in mounts else spaces[kind]

    def of(self, keys: Keys) -> Numbers:
        """Ids (n,) of variables.

        Raises
        ------
        GraphError
            A number that a key has no room for.
        """
        if keys.kind not in self.keyed:
            return keys.numbers
        if len(wrong := keys[(keys.numbers < 0) | (keys.numbers >> BITS > 0)]):
            raise GraphError(f"{wrong[[0]]!r} is no key of GTSAM: its number must be from 0 to 2^48 - 1", [wrong])
        letter, label = (keys.kind + "\0").encode()[:2]
        return keys.numbers | (letter << 8 | label) << BITS


def _heads(ids: Numbers) -> Numbers:
    """Head (n,) of every id."""
    head = ids >> BITS
    is_key = np.isin(head >> 8, LETTERS) & np.isin(head & 255, [0, *LETTERS])
    return np.where(is_key, head, np.where(ids < 1 << 56, 0, -1))


def _name(kind: str, head: int) -> str:
    """The kind of the ids of a head, plain ones of this kind.

    Examples
    --------
    >>> _name("x", 0), _name("x", ord("a") << 8), _name("x", ord("a") << 8 | ord("B"))
    ('x', 'a', 'aB')
    """
    return bytes([head >> 8, head & 255]).decode().rstrip("\0") if head > 0 else kind


def _parts(*slots: Keys) -> Iterator[tuple[Mask, list[Keys]]]:
    """For every combination of heads in these slots, which rows (n,) have it, and their variables."""
    heads = np.stack([_heads(keys.numbers) for keys in slots])
    _, first, of = np.unique(heads, axis=1, return_index=True, return_inverse=True)
    for k in np.argsort(first):
        mine = of.reshape(-1) == k
        combination = zip(slots, heads[:, first[k]].tolist(), strict=True)
        yield mine, [Keys(_name(s.kind, head), s.numbers[mine] - (head << BITS)) for s, head in combination]


def renumbered(
    graph: FactorGraph, values: Values, report: LoadReport | None = None, names: Mapping[str, str] | None = None
) -> tuple[FactorGraph, Values, list[str]]:
    """The graph with every number once, and which variable was which, in words.

    Poses keep their numbers. Places of sensors, then points, keep those that no variable before them has; the others
    get the numbers behind the largest, in the order of the old ones. Where these are too large, they get the first that
    are free.

    Parameters
    ----------
    graph, values : not changed; given back as they are where every number is there once.
    report : as for `nls.save`; kinds whose ids are keys of GTSAM keep their numbers.
    names : what the kinds were called in the graph of the user, for the words; as they are when omitted.

    Examples
    --------
    >>> from factors import Isotropic, Landmark
    >>> from models import R
    >>> from nls import kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([Landmark(x[0], l[[0, 7, 1]], [[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]], Isotropic(0.1))])
    >>> values = Values({x: (SE2, [[0, 0, 0], [1, 0, 0]]), l: (R(2), [[1, 0], [2, 0], [3, 0]], [0, 7, 1])})
    >>> graph, values, notes = renumbered(graph, values)
    >>> graph.factors, values.stack(l).numbers.tolist(), notes
    ([Landmark(x[0, 0, 0], l[8, 7, 9])], [8, 7, 9], ['2 variables have new numbers: l8 to l9 were l0 to l1'])
    """
    keyed = VertexIds(graph, values, report).keyed
    stacks = sorted((stack for stack in values.stacks.values() if stack.kind not in keyed), key=_rank)
    used = np.concatenate([np.zeros(0, dtype=np.int64), *(stack.numbers for stack in stacks)])
    taken: Numbers = used[:0]
    new = {stack.kind: stack.numbers for stack in values.stacks.values()}
    runs, count = [], 0
    for stack in stacks:
        numbers = np.array(stack.numbers)
        clash = np.flatnonzero(np.isin(numbers, taken))
        if len(clash):
            clash = clash[np.argsort(numbers[clash])]
            numbers[clash] = _free(used, len(clash))
            used = np.concatenate([used, numbers[clash]])
            old = (names or {}).get(stack.kind, stack.kind)
            runs += _runs(stack.kind, numbers[clash], old, stack.numbers[clash])
            count += len(clash)
        new[stack.kind] = numbers
        taken = np.concatenate([taken, numbers])
    if not count:
        return graph, values, []

    def key(keys: Keys) -> Keys:
        return Keys(keys.kind, new[keys.kind][values.stack(keys.kind).index(keys)])

    other = Values({s.kind: (s.manifold, s.X, new[s.kind]) for s in values.stacks.values()})
    have = "variables have new numbers" if count > 1 else "variable has a new number"
    return with_keys(graph, key), other, [f"{count} {have}: {', '.join(runs)}"]


def _rank(stack: Stack) -> int:
    """Poses of the vehicle first, then places of sensors, then all others."""
    return 2 if stack.manifold not in (SE2, SE3) else 1 if stack.kind == KINDS["mount"] else 0


def _runs(kind: str, new: Numbers, old_kind: str, old: Numbers) -> list[str]:
    """New and old names of variables (n,), in words; one phrase where both go on by 1.

    Examples
    --------
    >>> _runs("l", np.array([7, 8, 9]), "L", np.array([0, 1, 5]))
    ['l7 to l8 were L0 to L1', 'l9 was L5']
    """
    breaks = np.flatnonzero((np.diff(new) != 1) | (np.diff(old) != 1)) + 1
    runs = []
    for run in np.split(np.arange(len(new)), breaks):
        a, b = run[0], run[-1]
        several = f"{kind}{new[a]} to {kind}{new[b]} were {old_kind}{old[a]} to {old_kind}{old[b]}"
        runs.append(several if b > a else f"{kind}{new[a]} was {old_kind}{old[a]}")
    return runs


def _free(numbers: Numbers, count: int) -> Numbers:
    """So many numbers that nothing has: those after the largest, where they are below 2^63, else the first from 0.

    Examples
    --------
    >>> _free(np.array([0, 7]), 2), _free(np.array([0, 2**63 - 1]), 2)
    (array([8, 9]), array([1, 2]))
    """
    largest = int(numbers.max())
    if largest + count < 2**63:
        return largest + 1 + np.arange(count)
    free: Numbers = np.setdiff1d(np.arange(len(numbers) + count), numbers)[:count]
    return free


def with_known_kinds(graph: FactorGraph, values: Values) -> tuple[FactorGraph, Values, list[str]]:
    """The graph with its only kind of poses called x and its only kind of points l, and what was changed, in words.

    A graph with more kinds, or with others, is given back as it is, as is one in which nothing has to change.

    Examples
    --------
    >>> from factors import Isotropic, Landmark
    >>> from nls import kinds
    >>> A, L = kinds("A", "L")
    >>> graph = FactorGraph([Landmark(A[1], L[[1, 2]], [[1.0, 0.0], [2.0, 0.0]], Isotropic(0.1))])
    >>> values = Values({A: (SE2, [[0, 0, 0]], [1]), L: (R(2), [[1, 0], [2, 0]], [1, 2])})
    >>> graph, values, changes = with_known_kinds(graph, values)
    >>> graph.factors, values, changes
    ([Landmark(x[1, 1], l[1, 2])], Values(x: 1 x SE2, l: 2 x R(2)), ['poses A are written as x, points L as l'])
    """
    poses = [stack for stack in values.stacks.values() if stack.manifold in (SE2, SE3)]
    points = [stack for stack in values.stacks.values() if stack.manifold in (R(2), R(3))]
    if len(poses) != 1 or len(points) > 1 or len(values.stacks) > 2 or len(poses + points) != len(values.stacks):
        return graph, values, []
    names = {stack.kind: KINDS[role] for stack, role in zip(poses + points, ("pose", "point"), strict=False)}
    changes = ", ".join(
        f"{noun} {old} {'are written ' if noun == 'poses' else ''}as {name}"
        for noun, (old, name) in zip(("poses", "points"), names.items(), strict=False)
        if old != name
    )
    if not changes:
        return graph, values, []
    stacks = values.stacks.values()
    renamed = Values({names[s.kind]: (s.manifold, s.X, s.numbers) for s in stacks})
    return with_keys(graph, lambda keys: Keys(names[keys.kind], keys.numbers)), renamed, [changes]


def with_keys(graph: FactorGraph, key: Callable[[Keys], Keys]) -> FactorGraph:
    """A graph with its measurements and held variables under other names."""
    other = FactorGraph([replaced(factor, tuple(map(key, factor.keys))) for factor in graph.factors])
    for keys in graph.fixed:
        other.fix(key(keys))
    return other
