r"""Estimates and covariances while a vehicle moved, against the truth: four pictures, the same for any estimator.

    map         the track beside the true one, and where vehicle and landmarks are with 95 %
    vehicle     sigma of the pose against the step
    errors      the pose minus the truth, within +-3 sigma or not
    landmarks   sigma of each landmark against the step, from where it was found

Errors and sigmas of the pose are those of the tangent step from the truth to the estimate. They are along the axes of
the body: ahead and to the left, m, and the heading, deg. The position of a landmark has one sigma, sqrt(trace(P) / d).

`belief` draws one step of a filter: ellipses of pose and landmarks, and the cloud where it has particles. Errors and
ellipses that are too small to be seen are drawn larger, about the truth, and the legend says how much.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from models import LINE
from nls.covariance import frames
from nls.covariance.frames import outlines
from nls.filters import consistency
from nls.filters.base import POSE, Filter
from nls.filters.fastslam import FastSLAM
from nls.plot.ellipses import draw_outlines, larger, magnification
from nls.plot.picture import axes_or_new, figure_of, full_legend, legend_below, name_plane, new_figure
from nls.plot.style import BEFORE, BELOW, ELLIPSE, ESTIMATE, LANDMARK, SERIES, TRUE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from factors.keys import Keys
    from models.algebra import Array
    from nls.filters.base import Track
    from nls.values import Values

DASHES = ("-", (0, (5, 2)), "-.", (0, (2, 2)))  # of lines that may lie on one another
BODY = (("ahead", "m"), ("to the left", "m"), ("heading", "deg"))
SHOWN_UNITS = np.array([1.0, 1.0, 180 / np.pi])


def estimator_figure(
    track: Track,
    truth: Values,
    history: Sequence[tuple[Keys, Array]],
    title: str = "",
    sightings: Sequence[Keys] | None = None,
) -> Figure:
    """The four pictures.

    Parameters
    ----------
    track : poses in SE2.
    truth : its poses and landmarks, under the same names.
    history : at each step, the landmarks found so far and their covariances (m, d, d).
    title : of the figure; the method of the track is always named.
    sightings : poses and the walls seen from them, see `estimator_map`.

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls.plot.filters import estimator_figure
    >>> from sim.estimators import followed
    >>> world = sim.subsea(np.random.default_rng(1), laps=1, known_start=True)
    >>> track, history = followed(world, "batch")
    >>> [axes.get_title() for axes in estimator_figure(track, world.truth, history).axes if axes.get_title()]
    ['map', 'sigma of the vehicle', 'errors and 3 sigma', 'sigma of the landmarks']
    """
    figure = new_figure(10.5, 9)
    grid = figure.add_gridspec(6, 2)
    estimator_map(track, truth, figure.add_subplot(grid[:3, 0]), sightings)
    vehicle_sigmas(track, figure.add_subplot(grid[:3, 1]))
    estimator_errors(track, truth, [figure.add_subplot(grid[row, 0]) for row in (3, 4, 5)])
    walls = len(track.landmarks) and track.values.stack(track.landmarks.kind).manifold is LINE
    right = grid[3:, 1].subgridspec(1 + walls, 1).subplots(squeeze=False, sharex=True)
    landmark_sigmas(track, history, [*right[:, 0]])
    figure.suptitle(f"{title}: {track.method}" if title else track.method)
    return figure


def estimator_map(track: Track, truth: Values, axes: Axes, sightings: Sequence[Keys] | None = None) -> None:
    """The track when each pose was the latest, the true one, and 95 % ellipses of the vehicle and of the landmarks.

    Walls are drawn as long as they were seen, over the feet of the perpendiculars from the poses. `sightings` are keys
    of poses and of walls. Without these they are drawn as infinite lines.
    """
    manifold = track.manifold
    axes.plot(*manifold.position(truth[track.x]).T, color=BELOW, linewidth=5.0, zorder=0, label="truth")
    axes.plot(*manifold.position(track.X).T, color=ESTIMATE, linewidth=1.0, label=track.method)
    # at most 30 ellipses of the vehicle, evenly spaced
    shown = np.unique(np.linspace(0, len(track.x) - 1, min(30, len(track.x))).astype(int))
    J, _ = frames.axes(track.x, manifold, track.X[shown], None, "position")
    p, P = manifold.position(track.X[shown]), frames.turned(J, track.P[shown])
    scale = magnification(float(np.ptp(p, axis=0).max()), float(np.sqrt(np.linalg.eigvalsh(P).max())))
    label = f"95 % of the vehicle{larger(scale)}"
    draw_outlines(axes, p, scale * outlines(P), color=ELLIPSE, linewidth=0.8, label=label)
    if len(track.landmarks):
        stack = track.values.stack(track.landmarks.kind)
        L = track.values[track.landmarks]
        if stack.manifold is LINE:
            _walls(axes, truth, track.landmarks, sightings, color=BELOW, linewidth=5.0, zorder=0)
            _walls(axes, track.values, track.landmarks, sightings, color=LANDMARK, linewidth=1.2, label="walls")
        else:
            axes.plot(*truth.stack(stack.kind).X.T, "+", color=TRUE, markersize=9, label="true landmarks")
            axes.plot(*L.T, ".", color=LANDMARK, markersize=4)
            label = f"95 % of the landmarks{larger(scale)}"
            draw_outlines(axes, L, scale * outlines(track.P_landmarks), color=LANDMARK, linewidth=0.8, label=label)
            _named(axes, track.landmarks, L)
    name_plane(axes, title="map")
    legend_below(axes)


def _named(axes: Axes, landmarks: Keys, places: Array) -> None:
    """The names of landmarks beside their places (m, 2)."""
    for key, place in zip(landmarks, places, strict=True):
        axes.annotate(f"{key!r}", place, (6, 4), textcoords="offset points", color=LANDMARK, fontsize=8)


def _walls(axes: Axes, values: Values, walls: Keys, sightings: Sequence[Keys] | None, **style: Any) -> None:
    """Lines (alpha, r) between the feet of the first and last perpendicular; infinite where no sightings are given."""
    label = style.pop("label", None)
    for number, (alpha, r) in zip(walls.numbers.tolist(), values[walls].tolist(), strict=True):
        normal, along = np.array([[np.cos(alpha), np.sin(alpha)], [-np.sin(alpha), np.cos(alpha)]])
        if sightings is None:
            axes.axline(r * normal, r * normal + along, label=label, **style)
        else:
            poses = sightings[0][sightings[1].numbers == number]
            foot = values.stack(poses.kind).manifold.position(values[poses]) @ along
            ends = r * normal + np.outer([foot.min(), foot.max()], along)
            axes.plot(*ends.T, label=label, **style)
        label = None


def vehicle_sigmas(track: Track, axes: Axes) -> None:
    """Sigma of the pose against the step: m on the left, deg on the right."""
    sigma = _sigmas(track)
    for k, (name, unit) in enumerate(BODY[:2]):
        axes.plot(track.x.numbers, sigma[:, k], color=SERIES[k], linewidth=1.0, label=f"{name} [{unit}]")
    right = axes.twinx()
    right.plot(track.x.numbers, sigma[:, 2], color=SERIES[2], linewidth=1.0, linestyle="--", label="heading [deg]")
    axes.set(title="sigma of the vehicle", xlabel="step", ylabel="sigma [m]")
    right.set_ylabel("sigma [deg]")
    _from_zero(axes, right)
    legend_below(axes, right)


def _from_zero(*panels: Axes) -> None:
    """Panels from zero up, with room above the highest line and for a line on zero."""
    for axes in panels:
        top = max((float(np.max(line.get_ydata())) for line in axes.lines), default=1.0)
        axes.set_ylim(-0.03 * top, 1.1 * top)


def estimator_errors(track: Track, truth: Values, rows: Sequence[Axes]) -> None:
    """Errors of the pose on three axes, one below the other, each with its band of 3 sigma."""
    e = -SHOWN_UNITS * track.manifold.local(track.X, truth[track.x])
    sigma = _sigmas(track)
    for k, (axes, (name, unit)) in enumerate(zip(rows, BODY, strict=True)):
        axes.fill_between(track.x.numbers, -3 * sigma[:, k], 3 * sigma[:, k], color=ESTIMATE, alpha=0.15, linewidth=0)
        axes.plot(track.x.numbers, e[:, k], color=ESTIMATE, linewidth=0.8)
        axes.set_ylabel(f"{name} [{unit}]", fontsize=8)
        axes.margins(x=0)
    rows[0].set_title("errors and 3 sigma")
    rows[-1].set_xlabel("step")


def landmark_sigmas(track: Track, history: Sequence[tuple[Keys, Array]], panels: Sequence[Axes]) -> None:
    """Sigma of each landmark against the step: of the position, on one panel; of r and alpha of a wall, on two."""
    manifold = track.values.stack(track.landmarks.kind).manifold
    units = ", ".join(dict.fromkeys(filter(None, manifold.units)))
    panels[0].set(title="sigma of the landmarks", ylabel=f"sigma [{units}]" if units else "sigma")
    panels[-1].set_xlabel("step")
    counts = [len(keys) for keys, _ in history]
    if not any(counts):
        return
    steps, numbers = np.repeat(track.x.numbers, counts), np.concatenate([keys.numbers for keys, _ in history])
    variances = np.concatenate([np.diagonal(P, axis1=1, axis2=2) for _, P in history if len(P)])
    if manifold is LINE:
        sigmas = [np.sqrt(variances[:, 1]), np.degrees(np.sqrt(variances[:, 0]))]
        for axes, name in zip(panels, ("r [m]", "alpha [deg]"), strict=True):
            axes.set_ylabel(f"sigma of {name}")
    else:
        sigmas = [np.sqrt(variances.mean(axis=1))]
    for axes, sigma in zip(panels, sigmas, strict=True):
        for k, number in enumerate(np.unique(numbers).tolist()):
            again, color = divmod(k, len(SERIES))
            at, label = numbers == number, f"{track.landmarks.kind}{number}"
            axes.plot(steps[at], sigma[at], color=SERIES[color], linewidth=1.0 + again, label=label)
    _from_zero(*panels)
    legend_below(panels[-1])


def belief(
    estimator: Filter, pose: Keys, truth: Values, axes: Axes | None = None, scale: float | None = None
) -> Figure:
    """The latest pose and the landmarks found so far with their 95 % ellipses, and the truth.

    Parameters
    ----------
    estimator : a filter after some steps, in the plane, with points for landmarks. Of `FastSLAM` the particles are
        drawn, too: a dot for the pose of each, and one for every landmark of each.
    pose : the latest pose, ``step.pose``.
    truth : poses ``x`` and landmarks.
    axes : where; a new figure when omitted.
    scale : errors and ellipses are drawn so many times as large; as many as they need to be seen when omitted.

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls.filters import FastSLAM, steps
    >>> from nls.plot import belief
    >>> world = sim.subsea(np.random.default_rng(1), laps=1)
    >>> first, *_ = steps(world.graph, world.start)
    >>> particles = FastSLAM(50, rng=np.random.default_rng(0))
    >>> particles.start(first, world.start)
    >>> [text.get_text() for text in belief(particles, first.pose, world.truth).legends[0].get_texts()]
    ['truth', 'particles', 'pose, 95 %', 'landmarks, 95 %']
    """
    alone = axes is None
    axes = axes_or_new(axes, (6, 6))
    keys, L, P_landmarks = estimator.landmarks
    (X, P), poses = estimator.pose, truth.stack(POSE)
    J, _ = frames.axes(pose, poses.manifold, X[None], None, "position")
    Sigma, path = frames.turned(J, P[None]), np.asarray(poses.manifold.position(poses.X))
    if scale is None:
        spread = [np.sqrt(np.linalg.eigvalsh(P_i).max()) for P_i in (Sigma, P_landmarks) if len(P_i)]
        # four times as large as the least that is seen: one of several ellipses may be much larger than the others
        scale = magnification(4.0 * float(np.ptp(path, axis=0).max()), float(max(spread)))
    true, true_landmarks = poses.manifold.position(truth[pose]), truth[keys] if len(keys) else L

    def drawn(p: Array, q: Array) -> Array:
        """Places p where their error about the truth q is as many times as large as the ellipses."""
        return np.asarray(q + scale * (p - q))

    axes.plot(*path.T, color=BELOW, linewidth=5.0, zorder=0, label="truth")
    for stack in truth.stacks.values():
        if stack is not poses:
            axes.plot(*stack.X.T, "+", color=TRUE, markersize=9)
    if isinstance(estimator, FastSLAM):
        dots = {"linestyle": "none", "marker": ".", "markersize": 3}
        cloud = drawn(poses.manifold.position(estimator.X), true)
        axes.plot(*cloud.T, color=ESTIMATE, alpha=0.5, label="particles", **dots)  # type: ignore[arg-type]
        if estimator.map is not None:
            clouds = drawn(estimator.map.L, true_landmarks).reshape(-1, 2)
            axes.plot(*clouds.T, color=LANDMARK, alpha=0.2, **dots)  # type: ignore[arg-type]
    place, places = drawn(poses.manifold.position(X[None]), true), drawn(L, true_landmarks)
    axes.plot(*place.T, "o", color=ESTIMATE, markersize=5)
    draw_outlines(axes, place, scale * outlines(Sigma), color=ELLIPSE, linewidth=1.2, label="pose, 95 %")
    if len(keys):
        style = {"color": LANDMARK, "linewidth": 1.2, "label": "landmarks, 95 %"}
        draw_outlines(axes, places, scale * outlines(P_landmarks), **style)
        axes.plot(*places.T, ".", color=LANDMARK, markersize=4)
        _named(axes, keys, true_landmarks)
    drawn_larger = "" if scale == 1 else f": errors and ellipses × {scale:g}"
    name_plane(axes, title=f"{pose!r}{drawn_larger}")
    figure = figure_of(axes)
    if alone:
        full_legend(axes)
    else:
        legend_below(axes)
    return figure


def several(tracks: Sequence[Track], truth: Values, dead: Values, title: str = "", probability: float = 0.95) -> Figure:
    """Several estimators on one data set: tracks, errors and 3 sigma of the position, NEES with bounds.

    Where a covariance is singular there is no NEES, and its line has a gap.

    Parameters
    ----------
    tracks : of the same poses, in SE2.
    truth : of these poses.
    dead : of these poses, by dead reckoning.
    title : of the figure.
    probability : that the NEES of a consistent estimator is within the bounds, at any one step.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = new_figure(10.5, 9)
    (places, errors), (sigmas, nees) = figure.subplots(2, 2)
    x, manifold = tracks[0].x, tracks[0].manifold
    q = manifold.position(truth[x])
    places.plot(*q.T, color=BELOW, linewidth=5.0, zorder=0, label="truth")

    def off(p: Array, name: str, **style: Any) -> None:
        away = np.linalg.norm(p - q, axis=1)
        places.plot(*p.T, label=f"{name}: {np.sqrt(np.mean(away**2)):.2g} m", **style)
        errors.semilogy(x.numbers, away, **style)

    off(manifold.position(dead[x]), "dead reckoning", color=BEFORE, linewidth=1.6, linestyle=(0, (1, 1)))
    colors = [color for color in SERIES if color != BEFORE]
    for k, track in enumerate(tracks):
        style = {"color": colors[k % len(colors)], "linewidth": 1.3, "linestyle": DASHES[k % len(DASHES)]}
        off(manifold.position(track.X), track.method, **style)
        sigmas.plot(x.numbers, 3 * np.sqrt(np.trace(track.P[:, :2, :2], axis1=1, axis2=2) / 2), **style)
        e2, valid = np.full(len(x), np.nan), consistency.regular(track.P)
        e2[valid] = consistency.nees(track.x[valid], manifold, track.X[valid], track.P[valid], truth[track.x[valid]])
        nees.plot(x.numbers, e2, **style)
    for bound in consistency.nees_bounds(manifold.dim, 1, probability):
        nees.axhline(bound, color=TRUE, linewidth=0.8, linestyle="--")
    name_plane(places, title="tracks")
    errors.set(title="error of the position", xlabel="step", ylabel="[m], logarithmic")
    sigmas.set(title="3 sigma of the position, per axis", xlabel="step", ylabel="[m]")
    _from_zero(sigmas)
    nees.set(title=f"NEES, {100 * probability:g} % between the dashed lines", xlabel="step", yscale="log")
    handles, labels = places.get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    legend.set_title("rms error of the positions when each was the latest")
    if title:
        figure.suptitle(title)
    return figure


def power_laws(
    panels: Mapping[str, Mapping[str, tuple[Sequence[int], Sequence[float], float]]], fitted: int, xlabel: str
) -> Figure:
    """Curves of what grows with a number, both axes logarithmic, with the slopes at the ends of the lines.

    Parameters
    ----------
    panels : by title; in each, by name, n, y and the exponent p of y ~ n^p, nan for none.
    fitted : how many of the last points p is from; they are drawn as a thick line.
    xlabel : what n is.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = new_figure(4.8 * len(panels), 4.2)
    for axes, (title, lines) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True):
        for color, (n, y, _) in zip(SERIES, lines.values(), strict=False):
            axes.loglog(n, y, "o-", color=color, linewidth=1.0, markersize=4)
            axes.loglog(n[-fitted:], y[-fitted:], color=color, linewidth=3.0)
        axes.set(title=title, xlabel=xlabel)
        axes.grid(alpha=0.3)
        right, (low, high) = axes.get_xlim()[1], np.log(axes.get_ylim())
        axes.set_xlim(right=20 * right)  # the words in one column, none above another
        axes.set_ylim(top=np.exp(high + 0.1 * (high - low)))
        place = -np.inf
        ends = [(y[-1], name, p, color) for (name, (_, y, p)), color in zip(lines.items(), SERIES, strict=False)]
        for y_end, name, p, color in sorted(ends):
            place = max(float(np.log(y_end)), place + 0.06 * (high - low))
            text = name if np.isnan(p) else f"{name}, slope {p:.2f}"
            axes.text(right, np.exp(place), text, va="center", color=color)
    return figure


def _sigmas(track: Track) -> Array:
    """Sigmas (n, 3) of the poses, m, m, deg."""
    return np.asarray(SHOWN_UNITS * np.sqrt(np.diagonal(track.P, axis1=1, axis2=2)))
