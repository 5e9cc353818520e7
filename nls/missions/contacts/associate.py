r"""Which sightings are of one target, where nothing names them: tracks of near pings, then rounds over the whole graph.

1. Sightings of pings that follow one another are linked where one fits the arc of the other and nothing else does. The
   same must hold backwards. Links that hang together are tracks.
2. Tracks are landmarks of a graph with a robust kernel. Its optimum says how well poses and landmarks are known.
3. A track whose sightings fit the landmark of another is joined with it (`nls.missions.contacts.partition`), and
   sightings alone with one another. A track with two answers waits. A sighting that its landmark does not explain is
   alone again.
   Pieces without which chi2 is much less are a landmark of their own again (`nls.missions.contacts.decisions`). Of a
   track in one piece, whose chi2 no noise explains, the worst sighting is alone.

2 and 3 again, from the better estimate, until next to nothing changes. First gates are narrow, where poses are known
well beside each other. Then they are twice as wide, until no pair that fits is wider. The narrow ones correct the
poses, and wide gates become narrow. In the end the sightings of a ping that are still open are decided together
(`nls.missions.contacts.decisions`).

A mission of many pings has stretches of its own before (`nls.missions.contacts.partition`). Their rounds join sightings
where dead reckoning has drifted little. Then all landmarks of a stretch together tell where it lies on another one
(`nls.missions.contacts.loops`), however far dead reckoning has gone. The rounds of the whole begin with what that
joins.

The cost of an answer is chi2, a price for every number of a landmark, and one for every undecided sighting.

Source: G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6, 1978, for the price of a number.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from factors.keys import Keys, Kind, kinds
from factors.sighting import Sighting
from models.algebra import Array, Index
from models.chi_squared import chi2_gate
from models.errors import GraphFileError, UnderconstrainedError
from models.options import check_between, check_whole
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.missions.contacts import partition
from nls.missions.contacts.decisions import Cuts, resolved
from nls.missions.contacts.estimate import (
    FIRST_KERNEL,
    KERNEL,
    Anchored,
    Estimate,
    Pairs,
    estimated,
    landmark_distances,
    near_landmarks,
    near_pings,
    near_sightings,
    sighting_distances,
)
from nls.missions.contacts.loops import closed, local_maps
from nls.missions.contacts.pings import Pings, bounds, stretch_of_ping, stretches, without
from nls.missions.folder.contacts import sonar_parts
from nls.missions.folder.folder import MissionReport
from nls.stages import announce, stage
from nls.values import Values

STRETCH_PINGS = 150  # of a stretch, at most
MOST_EXPELLED = 2  # a sighting that its landmark did not explain so often is joined with no other any more
l = kinds("l")[0]
Asked = tuple[int, float, int]  # least, probability and rounds of `associate`


@dataclass(frozen=True, repr=False)
class Associated:
    """Landmarks for sightings without names.

    Attributes
    ----------
    numbers : (n,) landmark of each sighting, from 0 in the order of their first ones; -1 where it is undecided.
    sightings : the decided ones, as measurements of these landmarks.
    values : poses and landmarks, by all decided sightings.
    rounds : after each round of the whole how many sightings were decided.
    settled : whether the last round joined next to nothing. What it takes apart stays apart.
    cost : chi2 with its robust kernel, and log N for each number of a landmark where N numbers are measured. Each
        undecided sighting adds the kernel's charge at the gate.
    d2 : (n,) squared residual of each decided sighting, in sigmas; nan of the others.
    history : the tracks (n,) after each round, see `nls.missions.contacts.partition`.
    """

    numbers: Index
    sightings: Sighting
    values: Values
    rounds: tuple[int, ...]
    settled: bool
    cost: float
    d2: Array = field(repr=False)
    history: tuple[Index, ...] = field(repr=False)

    @property
    def landmarks(self) -> int:
        """How many there are."""
        return int(self.numbers.max(initial=-1)) + 1

    @property
    def share(self) -> float:
        """Part of the sightings that landmarks explain."""
        return float(np.mean(self.numbers >= 0))

    @property
    def nis(self) -> tuple[Keys, Array]:
        """Poses with decided sightings, and the mean of d2 of each: far above 2 where its sightings do not fit."""
        ping = self.sightings.keys[0]
        numbers, place, count = np.unique(ping.numbers, return_inverse=True, return_counts=True)
        return Keys(ping.kind, numbers), np.bincount(place, self.d2[self.numbers >= 0], len(numbers)) / count

    def __repr__(self) -> str:
        return f"Associated({np.count_nonzero(self.numbers >= 0)} of {len(self.numbers)}, {self.landmarks} landmarks)"

    def __str__(self) -> str:
        n, decided = len(self.numbers), int(np.count_nonzero(self.numbers >= 0))
        end = "" if self.settled else f"; not settled after {len(self.rounds)} rounds"
        return (
            f"{decided:,} of {n:,} sightings are of {self.landmarks:,} landmarks, mean d2 "
            f"{float(np.nanmean(self.d2)) if decided else 0.0:.2f}; the others are undecided{end}"
        )


def associate(
    graph: FactorGraph,
    values: Values,
    sightings: Sighting,
    aperture: float | None = None,
    kind: Kind = l,
    least: int = 3,
    probability: float = 0.995,
    rounds: int = 40,
) -> Associated:
    """Landmarks of sightings without names.

    Parameters
    ----------
    graph, values : all other measurements, and the poses by them, such as dead reckoning. Both stay as they are.
    sightings : the targets that they name are ignored.
    aperture : height of the view of an imaging sonar, rad; needed for `RangeAzimuth`.
    kind : of the landmarks.
    least : sightings that make a landmark; fewer stay undecided.
    probability : with which a right pairing is within its gate.
    rounds : at most, of the whole and of each stretch.

    Returns
    -------
    Associated

    Raises
    ------
    GraphError
        Sightings that leave more free than an elevation, whose sensor has no known place, or of a kind that has values.
    OptionError
        An aperture, a probability or a count that is none.
    UnderconstrainedError
        The graph leaves poses free.

    Notes
    -----
    A round costs one solution with its covariances. Sightings are compared with what is near, found by trees, and poses
    and landmarks have covariances beside what is near. So the cost grows little faster than the mission.

    Examples
    --------
    >>> import numpy as np
    >>> import nls, sim
    >>> mission = sim.hauv_floor(np.random.default_rng(1), legs=1, per_leg=16)
    >>> others = nls.FactorGraph(mission.graph.factors[:4])
    >>> poses = nls.Values.of([mission.start.stack("x")])
    >>> associated = associate(others, poses, mission.contacts, aperture=mission.sonar.aperture)
    >>> associated.settled, associated.share > 0.9
    (True, True)
    """
    check_whole("least", least, 2)
    check_between("probability", probability, 0, 1, "a number between 0 and 1, such as 0.995")
    check_whole("rounds", rounds, 1)
    pings = Pings.of(sightings, values, kind, aperture)
    asked, gate = (least, probability, rounds), chi2_gate(pings.dim, probability)
    pieces = _linked(pings, graph, values, gate)
    poses, tracks = graph.optimize(values).values, pieces.copy()
    if len(pings.poses) > STRETCH_PINGS:
        maps = []
        for rows, part, between, start in stretches(pings, graph, poses, STRETCH_PINGS):
            linked_there = partition.renamed(pieces[rows])
            of_stretch, there, _ = _rounds(part, between, start, linked_there, linked_there, asked, part=True)
            tracks[rows] = rows[of_stretch[-1]]
            own = local_maps(part, estimated(part, between, there, of_stretch[-1]), least)
            maps.append([local._replace(sightings=rows[local.sightings]) for local in own])
        stretch = stretch_of_ping(bounds(len(pings.poses), STRETCH_PINGS))[pings.ping]
        tracks = partition.continued(tracks, pieces, pings.ping, stretch)
        tracks, poses = closed(pings, graph, poses, tracks, maps, probability)
    history, poses, settled = _rounds(pings, graph, poses, tracks, pieces, asked)
    return _associated(pings, graph, poses, history, least, gate, settled)


def _rounds(
    pings: Pings, graph: FactorGraph, values: Values, tracks: Index, pieces: Index, asked: Asked, part: bool = False
) -> tuple[list[Index], Values, bool]:
    """Tracks (n,) after every round, poses by them, and whether the last round joined next to nothing.

    Sightings that are still open in the end are decided in the whole alone, not in a `part` of it.
    """
    least, probability, rounds = asked
    gate = chi2_gate(pings.dim, probability)
    poses, expelled = estimated(pings, graph, values, tracks, FIRST_KERNEL).values, np.zeros(len(pings), dtype=np.intp)
    # the widest innovations of the first rounds, in sigmas of the sensor
    widest, complete, last, settled = 2.0, False, False, False
    history: list[Index] = []
    Sigma = pings.covariances_of_poses(Marginals(graph, values))
    while len(history) < rounds and not settled:
        estimate = estimated(pings, graph, without(poses, pings.kind), tracks)
        poses, cuts = estimate.values, Cuts(pings, graph, estimate, pieces)
        open_ = np.flatnonzero(expelled < MOST_EXPELLED)
        alone = open_[partition.sizes(tracks)[open_] == 1]
        near = near_landmarks(pings, estimate, Sigma, open_, gate, np.inf if last else widest)
        pairs = near_sightings(pings, estimate, Sigma, alone[:0] if last else alone, gate, widest)
        anchored = Anchored(pings, cuts.tied, near[::-1], pairs)
        Sigma = pings.covariances_of_poses(anchored.marginals)
        if last:
            joined = resolved(pings, estimate, anchored, *near, least, probability)
        else:
            joined, complete = _joined(pings, estimate, anchored, near, pairs, gate, widest)
        misfits = estimate.doubtful & ~partition.several(tracks, pieces)
        outside = (partition.largest(tracks, estimate.d2) & misfits) | (estimate.d2 > 1.5 * gate)
        # pieces of one target stay together with this probability; what leaves before the last may be joined again
        leaving = cuts.leaving(anchored.marginals, chi2_gate(pings.group.point_dim, 0.98 if last else 0.9))
        moved = np.mean(partition.moved(tracks, joined))
        few = moved <= (0.01 if complete else 0.1)
        tracks = partition.single(partition.parted(joined, tracks, leaving), outside)
        expelled += outside | leaving
        settled = bool(few and complete and (last or part))
        if few and not complete:
            widest *= 2
        elif few and not last:  # what no single track was for may be somebody's with all of its ping
            last = True
            expelled[:] = 0
        history.append(tracks)
        decided = np.count_nonzero(partition.sizes(tracks) >= least)
        announce(f"{decided:,} of {len(tracks):,} contacts are of landmarks" + " in a part of the mission" * part)
    return history, without(poses, pings.kind), settled


def _linked(pings: Pings, graph: FactorGraph, values: Values, gate: float) -> Index:
    """Tracks (n,) of sightings in pings that follow one another, up to the third after one."""
    c, d, motions = near_pings(pings, graph, values, 3, gate)
    d2, _ = sighting_distances(pings, values, c, d, motions)
    tracks = partition.linked(c, d, d2, pings.ping[d] - pings.ping[c], len(pings), gate)
    return partition.once_per_ping(tracks, pings.ping)


def _joined(
    pings: Pings, estimate: Estimate, anchored: Anchored, near: Pairs, pairs: Pairs, gate: float, widest: float
) -> tuple[Index, bool]:
    """The tracks (n,) of an estimate, joined by what fits, and whether no pair that fits was too wide.

    near : sightings, and landmarks (k,) near them.
    pairs : of sightings (q,) that are alone.
    """
    tracks, (d, landmarks), (c, e) = estimate.tracks, near, pairs
    of_landmarks = landmark_distances(pings, estimate, anchored, d, landmarks)
    of_one = sighting_distances(pings, estimate.values, c, e, anchored.of_sightings(c, e))
    d2, width = (np.concatenate([a, b, b]) for a, b in zip(of_landmarks, of_one, strict=True))
    narrow = width < widest
    b, a = np.concatenate([tracks[d], c, e])[narrow], np.concatenate([landmarks, e, c])[narrow]
    return partition.merged(tracks, pings.ping, b, a, d2[narrow], gate), bool((narrow | (d2 >= gate)).all())


def _associated(
    pings: Pings, graph: FactorGraph, poses: Values, history: list[Index], least: int, gate: float, settled: bool
) -> Associated:
    """The last tracks that are landmarks, numbered, and their estimate."""
    tracks = history[-1]
    decided = partition.sizes(tracks) >= least
    estimate = estimated(pings, graph, poses, np.where(decided, tracks, np.arange(len(tracks))))
    numbers, values = np.full(len(tracks), -1), estimate.values
    names, numbers[decided] = np.unique(tracks[decided], return_inverse=True)
    sightings = pings.of_landmarks(numbers[decided], np.flatnonzero(decided))
    if len(names):
        stack = values.stack(pings.kind)
        values = without(values, pings.kind)
        values.add(pings.kind, stack.manifold, stack.X, np.arange(len(names)))
    price = np.log(pings.dim * len(tracks)) * pings.group.point_dim
    undecided = float(KERNEL.rho(np.array(gate))) * np.count_nonzero(~decided)
    cost = float(estimate.graph.chi2(estimate.values) + price * len(names) + undecided)
    d2 = np.where(decided, estimate.d2, np.nan)
    rounds = tuple(int(np.count_nonzero(partition.sizes(tracks) >= least)) for tracks in history)
    return Associated(numbers, sightings, values, rounds, settled, cost, d2, tuple(history))


def associated(graph: FactorGraph, values: Values, report: MissionReport) -> tuple[FactorGraph, Values, MissionReport]:
    """The graph of a mission with the contacts that its file gives no names, once their landmarks are found.

    Reading a mission leaves such contacts out of the graph, and counts them. Association solves the graph several
    times. Landmarks are numbered from 0 in the order of their first contacts. Undecided contacts become no factors.

    Parameters
    ----------
    graph, values, report : of `nls.load` or `read_mission`. All three stay as they are.

    Returns
    -------
    graph, values, report : with the factors of the decided contacts, their landmarks ``l``, and the lines of both; a
        note says how many contacts landmarks explain. The same three where no contact is without a name.

    Raises
    ------
    GraphFileError
        The track is not determined without the contacts.

    Notes
    -----
    See the page on the theory of association, and `nls.sonar.contacts.associate`, which takes any graph.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import nls, sim
    >>> mission = sim.hauv_floor(np.random.default_rng(1), legs=1, per_leg=8)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = nls.missions.write_mission(folder, mission.graph, mission.sonar, mission.offset)
    ...     file = Path(folder, "contacts.csv")
    ...     rows = [row.split(",") for row in file.read_text().splitlines()]
    ...     _ = file.write_text("".join(",".join(row[:1] + row[2:]) + "\\n" for row in rows))
    ...     graph, values, report = nls.load(folder)
    >>> report.counts["contacts_without_names"], list(values.stacks)
    (265, ['x'])
    >>> graph, values, report = nls.missions.associated(graph, values, report)
    >>> report.counts, list(values.stacks)
    ({}, ['x', 'l'])
    >>> graph.optimize(values).converged
    True
    """
    if (unnamed := report.unnamed) is None:
        return graph, values, report
    assert report.sonar is not None
    with stage("associate"):
        announce(f"{len(unnamed):,} contacts without names")
        try:
            answer = associate(graph, values, unnamed.contacts, report.sonar.aperture)
        except UnderconstrainedError as error:
            needed = "names no landmarks, so that the track must be determined without them"
            raise GraphFileError(f"{needed}: {error.message}", unnamed.table.path, advice=error.advice) from error
    remark, replaced = f"contacts.csv names no landmarks: {answer}", unnamed.note(report.path)
    notes = [remark if note == replaced else note for note in report.notes]
    factors, sources = list(graph.factors), list(report.sources)
    if answer.landmarks:
        rows = unnamed.rows[answer.numbers >= 0]
        for factor, own in sonar_parts(answer.sightings, unnamed.table, rows, report, unnamed.elevation):
            factors.append(factor)
            sources.append(own)
        values = Values.of([*values.stacks.values(), answer.values.stack(l)])
    return FactorGraph(factors, graph.fixed), values, replace(report, notes=notes, sources=sources, unnamed=None)
