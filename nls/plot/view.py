"""A map to turn, zoom and ask: a figure of plotly with a layer for every kind of thing, and the page that holds it.

Lines have a color by chance: a measurement of m numbers is off by s = |b| sigmas, and s^2 is below the quantile p of
chi-squared with m degrees of freedom with probability p, if its sigmas are right. Limits have m = 0: none is beyond.
"""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping, Sequence, Sized
from os.path import basename
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np

from factors.keys import Keys
from models.chi_squared import chi2_tail
from models.errors import EvaluationError, GraphError, OptionError, SingularGeometryError
from models.visible import visible
from nls.covariance.frames import outlines
from nls.gauge import placeless_kinds
from nls.io.table import EMPTY
from nls.plot.ellipses import MOST as MOST_ELLIPSES
from nls.plot.ellipses import every_nth
from nls.plot.report.page import Page
from nls.plot.style import BEFORE, CLOSURE, ECHO, ELLIPSE, ESTIMATE, LANDMARK, REJECTED, SERIES, SIGHT, TRUE
from nls.plot.trajectory import is_down
from nls.posegraph import closures, places
from nls.sparse.pattern import measuring

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from models.algebra import Array, Index
    from nls.covariance import Marginals
    from nls.graph import FactorGraph
    from nls.io.report import LoadReport
    from nls.robust.graduated import Rejected
    from nls.values import Stack, Values

    Layer = dict[str, Any]

PAGE = Path(__file__).with_name("view.html")
MOST = 10_000  # elements of a layer that are drawn: 60,000 poses with their closures make a page of 10 MB
MOST_IN_LINE = 20_000  # poses in the line of a track, points of a cloud: nothing is said of each
FEW = 3_000  # elements: more are drawn thin
WIDER = 1.25  # times the width of the map: wider tracks are switched off at first
TAILS = np.array([[0.05], [0.001]])  # chances of a right measurement to be beyond
COLORS = {"within 95 %": CLOSURE, "beyond 95 %": "#e3a008", "beyond 99.9 %": "#e8590c"}  # of measurements
DARK = {ESTIMATE: "#6cc3e8", TRUE: "#f2f2f2", BEFORE: "#f0a060", REJECTED: "#ff5d73", ELLIPSE: "#d38add"}  # on black


def view(
    graph: FactorGraph,
    values: Values,
    report: LoadReport | None = None,
    *,
    tracks: Mapping[str, Values] | None = None,
    clouds: Mapping[str, tuple[Array, Array]] | None = None,
    rejected: Sequence[Rejected] = (),
    lines: Sequence[str] = (),
    marginals: Marginals | None = None,
    down: bool = False,
    title: str = "",
    remark: str = "",
) -> Figure:
    """Poses, landmarks and measurements as layers that one can switch; the mouse says what each is.

    Parameters
    ----------
    graph : its measurements are drawn, colored by their residuals at the values; of `nls.gnc` the graph that was kept.
    values : the variables; kinds without positions are left out.
    report : of the graph: times of the poses, file and line of every measurement.
    tracks : further values by what they are called, such as ``truth`` or ``dead reckoning``; of the variables of the
        graph, others are left out.
    clouds : further points by what they are called: (n, 2 or 3), m, and for each when it was seen: the time where the
        report has times of the poses, the number of the pose elsewhere.
    rejected, lines : measurements that `nls.gnc` has rejected, dashed and red; and the file and line of each.
    marginals : of the same values: sigmas, and 95 % ellipses as in `ellipses`.
    down : whether z points down, also where no factor says so.
    title, remark : head of the figure, and what is said below it.

    Returns
    -------
    plotly.graph_objects.Figure
        A notebook shows it; `view_page` makes a page of it, with a slider of time. Of a layer with more than 10,000
        elements an evenly spaced part is drawn, and its name says so.

    Raises
    ------
    OptionError
        The package plotly is not installed.
    GraphError
        No variable has a position; a track has no variable of the map.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls.plot import view, view_page
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=8)
    >>> figure = view(world.graph, world.truth, tracks={"start": world.start})
    >>> print(*sorted({layer.name for layer in figure.data}), sep="; ")
    loop closures within 95 % (4); other measurements (15); start (16); track (16)
    >>> len(view_page(figure)) < 6e6
    True
    """
    go, scene = drawing_package(), Scene(graph, values, report)
    layers = [*scene.clouds(clouds or {}), *scene.measurements(rejected, lines), *scene.others(tracks or {})]
    layers += scene.variables(marginals)
    layers.sort(key=lambda layer: layer["legendgroup"] == "rejected")  # on top of the track
    words = [f"{len(s):,} {'poses' if kind in scene.poses else 'points'} {kind}" for kind, s in scene.stacks.items()]
    words += [f"{len(graph):,} measurements"] + [f"{len(rejected):,} more rejected"] * bool(rejected)
    sentence = f"{remark}. " * bool(remark) + ", ".join(words)
    head = {"text": _escaped(title), "subtitle": {"text": _escaped(sentence)}}
    legend = {"itemsizing": "constant", "groupclick": "togglegroup", "traceorder": "reversed"}
    return go.Figure(layers, {"title": head, "legend": legend, "meta": scene.meta, **scene.axes(down)})


def view_page(figure: Figure) -> Page:
    """The page of a figure of `view`: the script of plotly is inside, and nothing is loaded over a network."""
    from plotly.offline import get_plotlyjs

    title, inside = figure.layout.title, {"plotly": get_plotlyjs(), "figure": figure.to_json()}  # with < escaped
    texts = {"title": title.text or "Map", "sentence": title.subtitle.text or ""}
    return Page(Template(PAGE.read_text(encoding="utf-8")).substitute(texts | inside))


def drawing_package() -> Any:
    """The graph objects of the package plotly.

    Raises
    ------
    OptionError
        It is not installed.
    """
    try:
        from plotly import graph_objects
    except ImportError as error:
        cure = 'install it with pip install "leadline[view]"'
        raise OptionError(f"the package plotly, which draws the page, is missing; {cure}") from error
    return graph_objects


class Scene:
    """Variables and measurements in one frame: where they are, since when they are known, and what is said of them.

    Parameters
    ----------
    graph, values, report : as for `view`.

    Attributes
    ----------
    dim : 2 or 3; only kinds of this dimension are drawn.
    stacks, poses : of these kinds, and the names of those that are poses.
    timed : whether the clock is that of the report: s; numbers of poses elsewhere.
    order : (V,) place of every variable in the order by kind and number.
    place, since : (V, dim) and (V,) of all variables: where, nan for those that are not drawn; and since when.
    part : (V,) of the track that a pose is in: none is joined to the one before, as the first of a dive.
    moments : since when the measurements (k,) of every batch are known.
    """

    def __init__(self, graph: FactorGraph, values: Values, report: LoadReport | None) -> None:
        lines = [] if report is None else [len(source.lines) for source in report.sources]
        self.report = report if lines == [len(factor) for factor in graph.factors] else None  # else of another graph
        self.graph, self.values = graph, values
        self.pattern = graph.pattern(values)
        stacks = [s for kind, s in values.stacks.items() if len(s) and kind not in placeless_kinds(self.pattern)]
        self.dim = max((_positions(stack).shape[1] for stack in stacks), default=0)
        if not self.dim:
            raise GraphError("view: no kind of the values has positions; nls.plot.factor_graph(graph) draws the graph")
        self.stacks = {stack.kind: stack for stack in stacks if _positions(stack).shape[1] == self.dim}
        self.poses = [kind for kind, stack in self.stacks.items() if stack.manifold.dim > self.dim]
        given = {} if report is None else report.vertex_times
        times = {kind: given[kind] for kind in self.poses if kind in given}
        # without those of several dives
        times = {k: t for k, t in times.items() if not (np.diff(t[np.argsort(self.stacks[k].numbers)]) < 0).any()}
        self.timed, self.order, V = bool(times), places(self.pattern), len(self.pattern.dims)
        self.place, when = np.full((V, self.dim), np.nan), np.full(V, -np.inf)
        for kind, stack in self.stacks.items():
            self.place[self._rows(kind)] = _positions(stack)
            if kind in (times or self.poses):
                when[self._rows(kind)] = times.get(kind, stack.numbers)
        known = when[np.isfinite(when)] if self.poses else np.zeros(1)
        first, parted, self.moments = np.full(V, np.inf), np.ones(V), []
        for batch in self.pattern.batches:
            moment = np.clip(np.max([when[v] for v in batch.variables], axis=0), known.min(), known.max())
            for variables in batch.variables:
                np.minimum.at(first, variables, moment)
            ends = np.sort(self.order[np.stack(batch.variables)], axis=0)
            parted[ends[1:][np.diff(ends, axis=0) == 1]] = 0  # a measurement joins it to the one before
            self.moments.append(moment)
        self.since = np.where(np.isfinite(when), when, np.clip(first, known.min(), known.max()))
        self.part = np.cumsum(parted)[self.order]
        self.near = bool(np.nanmax(np.abs(self.place), initial=0.0) < 1e4)  # m, where four bytes hold a millimeter

    def _rows(self, kind: str) -> slice:
        """Rows of the variables of a kind among all."""
        begin = self.pattern.offsets[kind]
        return slice(begin, begin + len(self.values.stacks[kind]))

    def axes(self, down: bool) -> dict[str, Any]:
        """Axes of one scale, and the way the mouse moves the map."""
        axes: dict[str, Any] = {f"{name}axis": {"title": {"text": f"{name} [m]"}} for name in "xyz"[: self.dim]}
        if self.dim == 2:
            return {**axes, "yaxis": axes["yaxis"] | {"scaleanchor": "x"}, "dragmode": "pan"}
        if down or is_down(self.graph):
            axes["yaxis"]["autorange"] = axes["zaxis"]["autorange"] = "reversed"
            axes["zaxis"]["title"] = {"text": "z, down [m]"}
        return {"scene": {**axes, "aspectmode": "data"}}

    @property
    def meta(self) -> dict[str, Any]:
        """The moments of the slider, whether they are times in s, and the colors on black by those on white."""
        clock = np.unique(np.concatenate([np.zeros(0), *(self.since[self._rows(kind)] for kind in self.poses)]))
        return {"moments": clock[_rows(clock)].tolist(), "timed": self.timed, "dark": DARK}

    def variables(self, marginals: Marginals | None) -> Iterator[Layer]:
        """Tracks and landmarks, with their ellipses; the mouse says name, time, position and sigma."""
        for kind, stack in self.stacks.items():
            P, since, pose = self.place[self._rows(kind)], self.since[self._rows(kind)], kind in self.poses
            lines = [f"<b>{_escaped(kind)}%{{customdata[0]}}</b>"] + ["time %{customdata[1]} s"] * self.timed
            lines += [", ".join(f"{axis} %{{{axis}:.5g}}" for axis in "xyz"[: self.dim]) + " m"]
            Sigma = np.zeros((len(stack), self.dim, self.dim))
            status = np.array([] if marginals is None else marginals.status(kind))
            if marginals is not None and len(known := np.flatnonzero(status == "estimated")):
                lines += ["sigma " + ", ".join(f"%{{customdata[{k + 2}]:.3g}}" for k in range(self.dim)) + " m"]
                Sigma[np.isin(status, EMPTY)] = np.nan
                Sigma[known] = marginals.covariance(Keys(kind, stack.numbers[known]), view="position")
                rows = known[_rows(since[known], MOST_ELLIPSES * (1 if pose else 10))]
                rings = np.full((len(rows), 25, self.dim), np.nan)  # 24 sides, and the end of the line
                rings[:, :24] = P[rows, None]
                rings[:, :24, :2] += outlines(Sigma[rows, :2, :2], 0.95)[:, ::2]
                line = {"color": ELLIPSE if pose else LANDMARK, "width": 1.5}
                yield self._layer(f"95 % ellipses of {kind}", known, rings, since[rows], not pose, line=line)
            name = f"landmarks {kind}" if not pose else f"track {kind}" if len(self.poses) > 1 else "track"
            dot = {"size": 6, "opacity": 0.0} if pose else {"color": LANDMARK, "size": 9 - 2 * self.dim}
            if pose:
                color = (ESTIMATE, *SERIES[5:])[self.poses.index(kind) % 4]  # no color of another thing
                line = {"color": color, "width": 1 + self.dim if len(P) < FEW else 1.5}
                yield self._layer(name, P, *_line(P, since, self.part[self._rows(kind)], MOST_IN_LINE), line=line)
            rows = _rows(since)
            numbers = np.column_stack([stack.numbers, since, np.sqrt(np.diagonal(Sigma, axis1=1, axis2=2))])[rows]
            words = "<br>".join(lines) + "<extra></extra>"
            about: dict[str, Any] = {"customdata": numbers, "hovertemplate": words, "showlegend": not pose}
            yield self._layer(name, P, P[rows], since[rows], marker=dot, **about)

    def others(self, tracks: Mapping[str, Values]) -> Iterator[Layer]:
        """Further tracks and points; points, and tracks that make the map much wider, are switched off at first."""
        own, width = self.stacks, np.ptp(self.place[~np.isnan(self.place[:, 0])], axis=0).max(initial=0.0)
        for name, values in tracks.items():
            color = TRUE if name == "truth" else BEFORE
            stacks = [s.only(np.isin(s.numbers, own[k].numbers)) for k, s in values.stacks.items() if k in own]
            stacks = [s for s in stacks if len(s) and _positions(s).shape[1] == self.dim]
            if not stacks:
                raise GraphError(f"view: track {name!r} has no variable of the {self.dim}-D map; leave it out")
            for stack in stacks:
                P, kind, pose = _positions(stack), stack.kind, stack.kind in self.poses
                rows = self.pattern.offsets[kind] + own[kind].index(Keys(kind, stack.numbers))
                line = {"line": {"color": color, "width": 2, "dash": "dot" if self.dim == 2 else "solid"}}
                style: dict[str, Any] = line if pose else {"marker": {"color": color, "size": 4, "symbol": "cross"}}
                near = pose and bool(np.ptp(P, axis=0).max(initial=0.0) <= WIDER * width)
                label = name if kind in self.poses[:1] else f"{name} {kind}"
                yield self._layer(label, P, *_line(P, self.since[rows], self.part[rows]), near, **style)

    def clouds(self, clouds: Mapping[str, tuple[Array, Array]]) -> Iterator[Layer]:
        """Points that are no variables, in space colored by z."""
        for name, (P, since) in clouds.items():
            rows = _rows(since, MOST_IN_LINE)
            color = {"color": P[rows, 2], "colorscale": "Viridis"} if self.dim == 3 else {"color": ECHO}
            yield self._layer(name, P, P[rows], since[rows], marker={"size": 2, "opacity": 0.6, **color})

    def measurements(self, rejected: Sequence[Rejected], lines: Sequence[str]) -> Iterator[Layer]:
        """Loop closures by chance, rejected ones, lines of sight, and the dots of all others; a dot says what it is."""
        looks = {f"loop closures {words}": {"color": color, "width": 1.5} for words, color in COLORS.items()}
        looks["rejected"] = {"color": REJECTED, "width": 2.5, "dash": "dash"}
        looks |= {"lines of sight": {"color": SIGHT, "width": 1}, "other measurements": {}}
        scale = {"colorscale": [[k / 2, color] for k, color in enumerate(COLORS.values())], "cmin": 0, "cmax": 2}
        columns = [np.concatenate(column) for column in zip(*self._columns(rejected), strict=True)] or [np.zeros(0)]
        for number, (name, line) in enumerate(looks.items()):
            if not len(members := np.flatnonzero(columns[0] == number)):
                continue
            rows = members[_rows(columns[-1][members])]
            chance, factor, row, i, j, sigmas, since = (column[rows] for column in columns[1:])
            a, b, shown, red = self.place[i, None], self.place[j, None], number < 4, name == "rejected"
            if line:
                ends = np.concatenate([a, b, np.full_like(a, np.nan)], axis=1)
                yield self._layer(name, members, ends, since, shown, line=line)
            at = np.linspace(0, 1, 5 if red else 3)[1:-1, None]  # of the way from one end to the other
            dot = {"size": 8 - 2 * self.dim if len(rows) < FEW else 2, "color": chance, **scale}
            texts = [
                _text(rejected[r].factor, s, lines[r : r + 1])
                if red
                else _text(self.graph.factors[f].describe(r), s, [self.report.place(f, r)] if self.report else [])
                for f, r, s in zip(factor.tolist(), row.tolist(), sigmas.tolist(), strict=True)
            ]
            about: dict[str, Any] = {"text": np.repeat(texts, len(at)).tolist(), "hoverinfo": "text"}
            about |= {"marker": dot | {"color": REJECTED} if red else dot, "showlegend": not line}
            yield self._layer(name, members, a + at * (b - a), since, shown, **about)

    def _columns(self, rejected: Sequence[Rejected]) -> Iterator[tuple[Array | Index, ...]]:
        """Of every batch (k,): layer, chance, factor, row, the two variables on the map, sigmas, and since when."""
        for f, (batch, closes) in enumerate(zip(self.pattern.batches, closures(self.pattern), strict=True)):
            placed = [v for kind, v in zip(batch.kinds, batch.variables, strict=True) if kind in self.stacks]
            if not placed:
                continue
            try:
                s = self.graph.factors[f].chi2(self.values)
            except (EvaluationError, SingularGeometryError):  # as for a bearing to the place of the sensor
                s = np.full(len(batch), np.nan)
            i, j = placed[0], placed[1 % len(placed)]
            chance = (~(chi2_tail(s, measuring(batch.model)) >= TAILS)).sum(axis=0)  # nan is beyond
            apart = (np.abs(self.order[i] - self.order[j]) > 1) | (batch.kinds[0] != batch.kinds[len(placed) - 1])
            sight = apart & (len(placed) > 1 and not batch.model.factor.sequential)
            layer = np.select([closes, sight], [chance, 4], 5)
            yield layer, chance, np.full(len(i), f), np.arange(len(i)), i, j, np.sqrt(s), self.moments[f]
        if rejected:
            i, j = np.array([self._ends(measurement) for measurement in rejected]).T
            rows, sigmas = np.arange(len(i)), np.array([measurement.sigmas for measurement in rejected])
            yield 0 * rows + 3, 0 * rows, 0 * rows, rows, i, j, sigmas, np.maximum(self.since[i], self.since[j])

    def _ends(self, measurement: Rejected) -> tuple[int, int]:
        """The two variables on the map, or the one twice, among all."""
        keys = [key for key in measurement.keys if key.kind in self.stacks] or measurement.keys
        rows = [self.pattern.offsets[key.kind] + int(self.values.stack(key.kind).index(key)[0]) for key in keys]
        return rows[0], rows[1 % len(rows)]

    def _layer(self, name: str, members: Sized, P: Array, since: Array, shown: bool = True, **style: Any) -> Layer:
        """A layer, or the part of its members that is drawn, in the order of time.

        Parameters
        ----------
        name, members : what it is called, and all that belongs to it.
        P, since : places (n, dim), lines (n, k, dim) that end with nan, or several places of one thing; and since when.
        shown : at first, not only named in the legend.
        style : as plotly takes it.
        """
        step = -(-len(members) // max(len(P), 1))
        return {
            "type": "scatter3d" if self.dim == 3 else "scattergl",
            "mode": "lines" if "line" in style else "markers",
            "name": f"{name} ({len(members):,})" + f", {every_nth(step)}drawn" * (step > 1),
            "legendgroup": name,
            "visible": shown or "legendonly",
            "meta": {"since": since.tolist(), "stride": 1 if P.ndim == 2 else P.shape[1]},
            **dict(zip("xyz", P.reshape(-1, self.dim).T.astype("f4" if self.near else "f8"), strict=False)),
            **({} if "text" in style or "hovertemplate" in style else {"hoverinfo": "skip"}),
            **style,
        }


def _rows(since: Array, most: int = MOST) -> Index:
    """Rows in the order of time, so many at most, evenly spaced."""
    return np.argsort(since, kind="stable")[:: max(1, -(-len(since) // most))]


def _line(P: Array, since: Array, part: Array, most: int = MOST) -> tuple[Array, Array]:
    """Places (n, dim) and since when, in the order of time; nan where a part of a track begins, if it has several."""
    rows = _rows(since, most)
    begins = np.append(0, np.diff(part[rows]))[: len(rows)] != 0
    return np.where(begins[:, None] & (begins.sum() < len(rows) - 1), np.nan, P[rows]), since[rows]


def _text(name: str, sigmas: float, place: Sequence[str]) -> str:
    """What the mouse says of a measurement: variables, residual, file and line."""
    return f"<b>{_escaped(name)}</b><br>{sigmas:.3g} sigmas" + "".join(f"<br>{_escaped(basename(p))}" for p in place)


def _escaped(text: str) -> str:
    """Text as a page has it."""
    return html.escape(visible(text))


def _positions(stack: Stack) -> Array:
    """Positions (n, 0 to 3) of some variables."""
    return np.asarray(stack.manifold.position(stack.X))
