r"""EKF-SLAM: pose and landmarks filtered jointly, by the factors a graph would take.

    motion factor     A_i d_i + A_j d_j = b + v     F = -A_j^-1 A_i,  Q = A_j^-1 A_j^-T,   X_j where b = 0
    first sighting    A_x d_x + A_l d_l = b + v     G = -A_l^-1 A_x,  Q = A_l^-1 A_l^-T,   L where the factor has it
    other factors     A d = b + v                   all of one step stacked into one update
    iterated          A T d = b + A T d_k + v       linearized where step d_k led, T the turn of the pose's axes there

v ~ N(0, I): factors are whitened. Motion and first sighting are the same thing: a variable is added where one factor
says all of it. Its covariance and its correlation with everything else follow from the factor's own Jacobians.

Sources: R. Smith, M. Self, P. Cheeseman, "Estimating uncertain spatial relationships in robotics", 1990; S. Thrun,
W. Burgard, D. Fox, Probabilistic Robotics, 2005, chapter 10. Iterated updates: B. M. Bell, F. W. Cathey, "The iterated
Kalman filter update as a Gauss-Newton method", IEEE Transactions on Automatic Control 38, 1993. First estimates:
G. P. Huang, A. I. Mourikis, S. I. Roumeliotis, "Analysis and improvement of the consistency of extended Kalman filter
based SLAM", ICRA 2008.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np

from factors import Factor, Sighting
from factors.keys import Keys
from models import LieGroup, R
from models.algebra import Array, Index
from models.chi_squared import chi2_gate
from models.errors import GraphError, OptionError
from models.options import check_between, check_whole
from nls.covariance import Joint
from nls.filters.association import Association
from nls.filters.base import POSE, Filter, Step
from nls.filters.delayed import Waiting, can_wait
from nls.filters.map_state import MapState, Measurements, associated, distances, select, stacked
from nls.filters.motion import Copies, jacobians, most_likely, slot_of
from nls.values import Values

LANDMARKS = ("correlated", "delayed", "first-sight", "independent")


class EKF(Filter):
    """Extended Kalman filter over the latest pose and the landmarks seen so far.

    Parameters
    ----------
    landmarks : what is believed of a landmark at its first sighting, unless a prior of its own came before.
        ``correlated``: the prediction of pose and sighting, with its correlation to everything else; ``delayed``: the
        same, and ranges, bearings and sonar contacts, which do not locate their landmark, wait until several do (not
        with `first_estimates` or `associate`); ``first-sight``: its place with `prior_sigma`, uncorrelated, which
        counts information nobody measured (the filter becomes over-confident; known from simulations in the
        literature, kept for comparison); ``independent``: nothing, every landmark must have a `Prior`.
    first_estimates : Jacobians are taken where a variable was first estimated, residuals where it is now. What no
        measurement sees, such as the heading of everything, then stays unseen.
    prior_sigma : of ``first-sight``, for every component of a landmark or one each, m (and rad for lines).
    associate : how sightings find their landmarks where the graph does not know, `nls.filters.association`; the
        landmarks named in the graph are then ignored, new ones are numbered from 0. None: those of the graph.
    iterations : how often at most an update is linearized, again where the last linearization led, until that moves
        by less than 1e-6 (m, rad). More than one is needed where landmarks are known worse than they are measured.
    gate : probability with which a sighting of a known landmark is within its gate; what is outside is of something
        else and is left out. None: every sighting is used, and a wrong one is never undone.

    Attributes
    ----------
    found : with `associate`, the landmark each sighting was given to, in the order of time; -1 for one left out. With
        one factor of sightings in the graph, `nls.filters.association.identified` puts them back into it.
    left_out : sightings that were outside of the gate.
    waiting : with ``delayed``, landmarks that were seen and are not located; they are not in the map.
    given_up : sightings that waited and were not used, since at most 40 poses are copied for what waits.

    Raises
    ------
    OptionError
        An option with a value it cannot have.

    Notes
    -----
    All factors of a step about known variables make one stacked update; then new landmarks are added, each from its
    first sighting that locates it, and what else was seen of those makes a second update. A prediction costs O(n) for n
    landmarks, an update O(n^2), each further iteration O(n). A graph that closes loops between poses needs them all: a
    filter of the latest pose refuses such factors.

    A chart to 4 m, bearings to 0.2 deg. At 25 m a sighting moves a landmark by 46 sigma of its bearing, too far for one
    linearization. The mean NEES of the last pose is 3 for a consistent filter. Over 30 seeds of `sim.subsea` with
    ``independent`` landmarks it is 74 with one iteration. With ten at most, 4 in the mean, it is 2.6. Landmarks that
    begin where they were seen, ``correlated``, need no more than one.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls.filters.ekf import EKF
    >>> world = sim.subsea(np.random.default_rng(1), known_start=True)
    >>> track = EKF().run(world.graph, world.start)
    >>> track.ate(world.truth).rmse < 0.4, track.P.shape, track.landmarks
    (True, (181, 3, 3), l[0, 1, 5, 2, 3, 4])
    """

    def __init__(
        self,
        landmarks: Literal["correlated", "delayed", "first-sight", "independent"] = "correlated",
        first_estimates: bool = False,
        prior_sigma: float | Sequence[float] = 4.0,
        associate: Association | None = None,
        iterations: int = 1,
        gate: float | None = None,
    ) -> None:
        if landmarks not in LANDMARKS:
            raise OptionError("landmarks", landmarks, "one of " + ", ".join(LANDMARKS))
        if not isinstance(first_estimates, bool):
            raise OptionError("first_estimates", first_estimates, "True or False")
        sigmas = np.asarray(prior_sigma, dtype=float)
        if not (np.isfinite(sigmas) & (sigmas > 0)).all() or sigmas.ndim > 1:
            raise OptionError("prior_sigma", prior_sigma, "a sigma above 0, or one for each component of a landmark")
        if not isinstance(associate, Association | None):
            raise OptionError("associate", associate, "an association such as JointCompatibility(0.95), or None")
        expected = "a whole number of at least 1; 1 with first_estimates, which keep their Jacobians"
        self.iterations = check_whole("iterations", iterations, 1, expected)
        if first_estimates and self.iterations > 1:
            raise OptionError("iterations", iterations, expected)
        if landmarks == "delayed" and (first_estimates or associate is not None):
            expected = "'correlated' with first_estimates or associate: sightings wait by name, and take new Jacobians"
            raise OptionError("landmarks", landmarks, expected)
        self.initial, self.first_estimates, self.prior_sigma = landmarks, first_estimates, sigmas
        self.associate = associate
        if gate is not None and associate is not None:
            raise OptionError("gate", gate, "None with an association, which has gates of its own")
        if gate is not None:
            check_between("gate", gate, 0, 1, "a probability between 0 and 1, such as 0.999, or None")
        self.gate, self.left_out = gate, 0
        self.associations: list[int] = []
        self._state: MapState | None = None
        self._delayed: Waiting | None = None

    @property
    def method(self) -> str:
        options: list[str] = [self.initial] if self.initial != "correlated" else []
        options += ["first estimates"] if self.first_estimates else []
        options += [f"{self.iterations} iterations"] if self.iterations > 1 else []
        options += [f"gate {self.gate:g}"] if self.gate is not None else []
        options += [type(self.associate).__name__] if self.associate is not None else []
        return "EKF" + (f" ({', '.join(options)})" if options else "")

    @property
    def waiting(self) -> Keys:
        """Landmarks that were seen and are not located."""
        return Keys(self._kind, self._delayed.numbers) if self._delayed else Keys("l", [])

    @property
    def given_up(self) -> int:
        """How many sightings left with their pose, and never were used."""
        return self._delayed.given_up if self._delayed else 0

    @property
    def state(self) -> MapState:
        """Pose, landmarks, and their joint covariance.

        Raises
        ------
        GraphError
            No step has been taken.
        """
        if self._state is None:
            raise GraphError("EKF: no step has been taken; call `start` or `run`")
        return self._state

    @property
    def pose(self) -> tuple[Array, Array]:
        return self.state.X, self.state.pose_covariance

    @property
    def joint(self) -> Joint:
        """Joint covariance of the latest pose, along the axes of the world, and of all landmarks found so far.

        Examples
        --------
        >>> import numpy as np
        >>> import sim
        >>> from nls.filters.ekf import EKF
        >>> world = sim.subsea(np.random.default_rng(1), laps=1)
        >>> ekf = EKF()
        >>> _ = ekf.run(world.graph, world.start)
        >>> ekf.joint.matrix.shape, ekf.joint.names[:4]
        ((15, 15), ('x90: x', 'x90: y', 'x90: yaw', 'l0: x'))
        """
        state = self.state
        pose, landmark = state.spaces
        d, keys = pose.dim, (self._pose, *Keys(self._kind, state.numbers))
        J = pose.world_axes(state.X[None])[0] @ state.turn(state.first[None], state.X[None])[0]
        own = np.append(np.arange(d), np.arange(state.begin, state.n))
        P = state.P[own[:, None], own]
        P[:d] = J @ P[:d]
        P[:, :d] = P[:, :d] @ J.T
        begin = [0, *(d + landmark.dim * np.arange(len(keys))).tolist()]
        parts = [slice(a, b) for a, b in pairwise(begin)]
        names = [(key, pose if key is self._pose else landmark) for key in keys]
        return Joint(P, tuple(f"{key!r}: {name}" for key, space in names for name in space.components), keys, parts)

    @property
    def landmarks(self) -> tuple[Keys, Array, Array]:
        state = self.state
        return Keys(self._kind, state.numbers), state.L, state.landmark_covariances

    def start(self, step: Step, values: Values) -> None:
        pose = values.stack(POSE)
        landmark_stacks = [stack for name, stack in values.stacks.items() if name != POSE]
        kinds = {keys.kind for factor in step.observations for keys in factor.keys} - {POSE}
        self._kind = next(iter(kinds), landmark_stacks[0].kind if landmark_stacks else "l")
        landmark = values.stack(self._kind).manifold if landmark_stacks else R(2)
        self._values, self._spaces = values, {POSE: pose.manifold, self._kind: landmark}
        if self.prior_sigma.ndim and len(self.prior_sigma) != landmark.dim:
            raise OptionError("prior_sigma", self.prior_sigma.tolist(), f"one number, or {landmark.dim} for {landmark}")
        self._pose, self.associations, self.left_out = step.pose, [], 0
        own = [factor for factor in step.observations if all(keys.kind == POSE for keys in factor.keys)]
        self._refuse_kernels(step)
        parts = [(replace(self._copies(factor), n=len(factor)), 0, ()) for factor in own]
        X, Lambda = most_likely(parts, pose.manifold, values[step.pose][None], step.pose)
        self._state = MapState((pose.manifold, landmark), X[0], _inverse(Lambda)[0], self.first_estimates)
        self._delayed = Waiting(self._state)
        self._see([factor for factor in step.observations if not any(factor is own_factor for own_factor in own)])

    def step(self, step: Step) -> None:
        state, before = self.state, self._pose
        if not step.motion:
            raise GraphError(f"EKF: {step.pose} has no motion from {before}, where the filter is", [before, step.pose])
        for factor in step.motion:
            if before not in factor.keys:
                raise GraphError(f"EKF is at {before}; {factor!r} does not begin there", [before, step.pose])
        self._refuse_kernels(step)
        X_i = state.X[None]
        parts = [(self._copies(factor), slot_of(factor, step.pose), (X_i,)) for factor in step.motion]
        X_j, Lambda = most_likely(parts, state.spaces[0], X_i, step.pose)
        A_i, A_j = jacobians(parts, state.first[None], X_j)
        F = -np.asarray(np.linalg.lstsq(A_j, A_i)[0], dtype=float)
        if np.abs(A_i + A_j @ F).max() > 1e-9 * np.abs(A_i).max():  # more than rounding
            factors = ", ".join(map(repr, step.motion))
            message = f"{factors} together also constrain {before}, which is past"
            raise GraphError(f"EKF: {message}; fuse them to one, or use a graph", [before, step.pose])
        self._pose = step.pose
        state.predict(X_j[0], F, _inverse(Lambda)[0])
        self._see(step.observations)

    @staticmethod
    def _refuse_kernels(step: Step) -> None:
        """A robust kernel is refused at once, also of a sighting that waits."""
        factor = next((factor for factor in (*step.motion, *step.observations) if factor.kernel is not None), None)
        if factor is not None:
            message = "has a robust kernel, which a filter cannot reweight later; use its noise alone, or a graph"
            raise GraphError(f"EKF: {factor!r} {message}", factor.keys, factor.name)

    def _copies(self, factor: Factor) -> Copies:
        """The factor for `most_likely`, one measurement for each copy of its variables."""
        return Copies(factor, factor.bind(*(self._spaces[keys.kind] for keys in factor.keys)), 1)

    def _see(self, factors: list[Factor]) -> None:
        """Everything that touches the latest pose alone, landmarks, or both."""
        pieces = [self._identified(factor) for factor in factors]
        pieces = self._spent(pieces, lambda factor: len(factor.keys) == 1, self._chart)
        rows = [None if numbers is None else self.state.rows(numbers) for _, numbers in pieces]
        known = [select(piece, None if r is None else r >= 0) for piece, r in zip(pieces, rows, strict=True)]
        self._update([self._within(piece) for piece in known])
        unknown = [select(piece, r < 0) for piece, r in zip(pieces, rows, strict=True) if r is not None]
        rest = self._spent(unknown, lambda factor: isinstance(factor, Sighting) and factor.locates, self._locate)
        if self.initial == "delayed" and self._delayed:
            rest = self._delayed.take(self._pose, rest)
        self._update(rest)

    def _identified(self, factor: Factor) -> Measurements:
        """The factor, and the landmark of each measurement, as the graph says or as the association finds."""
        slots = [slot for slot, keys in enumerate(factor.keys) if keys.kind != POSE]
        for keys in factor.keys:
            if keys.kind not in self._spaces:
                raise GraphError(f"EKF: {factor!r}: landmarks are of kind {self._kind}, not {keys.kind}", factor.keys)
            if keys.kind == POSE and (past_pose := keys.numbers != self._pose.numbers[0]).any():
                past = keys[[int(np.argmax(past_pose))]]
                message = f"{factor.describe(int(np.argmax(past_pose)))} needs {past}, which is past"
                cure = "a filter of the latest pose closes no loops between poses: use a Smoother or a graph"
                raise GraphError(f"EKF at {self._pose}: {message}; {cure}", [past], factor.name)
        if len(slots) > 1:
            raise GraphError(f"EKF: {factor!r} connects landmarks; use a graph", factor.keys, factor.name)
        if not slots:
            return factor, None
        if self.associate is None or not isinstance(factor, Sighting):
            return factor, factor.keys[slots[0]].numbers
        numbers = associated(self.state, self.associate, factor, self._copies(factor).model.manifolds)
        self.associations += numbers.tolist()
        return select((factor, numbers), numbers >= 0)

    def _within(self, piece: Measurements) -> Measurements:
        """Without the sightings of known landmarks that are outside of their gate."""
        factor, numbers = piece
        if self.gate is None or numbers is None or not len(factor) or not isinstance(factor, Sighting):
            return piece
        model = self._copies(factor).model
        within = distances(self.state, model, self.state.rows(numbers))[0] <= chi2_gate(model.dim, self.gate)
        self.left_out += int((~within).sum())
        return select(piece, within)

    def _spent(
        self, pieces: list[Measurements], accept: Callable[[Factor], bool], add: Callable[[Factor, Index], None]
    ) -> list[Measurements]:
        """New landmarks added, each from its first measurement by a factor that is wanted; the measurements left."""
        remainder = []
        for factor, numbers in pieces:
            left = np.ones(len(factor), dtype=bool)
            if numbers is not None and accept(factor):
                _, first = np.unique(numbers, return_index=True)
                first = np.sort(first[self.state.rows(numbers[first]) < 0])
                left[first] = False
                if len(first):
                    add(factor[first], numbers[first])
            remainder.append(select((factor, numbers), left))
        return remainder

    def _chart(self, factor: Factor, numbers: Index) -> None:
        """New landmarks (r,) as their priors say."""
        start = self._values[Keys(self._kind, numbers)]
        L, Lambda = most_likely([(self._copies(factor), 0, ())], self.state.spaces[1], start, factor.keys[0])
        d = self.state.spaces[0].dim
        self.state.add(numbers, L, np.zeros((*Lambda.shape[:2], d)), _inverse(Lambda))

    def _locate(self, factor: Factor, numbers: Index) -> None:
        """New landmarks (r,) where the latest pose saw them."""
        assert isinstance(factor, Sighting)
        state = self.state
        pose, landmark = state.spaces
        if self.initial == "independent":
            keys, cure = Keys(self._kind, numbers), "add one, or choose 'correlated'"
            message = f"{keys[[0]]} is observed and has no Prior, which landmarks='independent' needs; {cure}"
            raise GraphError(f"EKF: {message}", [keys])
        copied = self._copies(factor)
        assert isinstance(pose, LieGroup)
        X = np.tile(state.X, (len(numbers), 1))
        start = factor.locate(pose, factor.sensor_pose(pose, X), copied.model.z)
        L, Lambda = most_likely([(copied, 1, (X,))], landmark, start, factor.keys[1])
        Q, G = _inverse(Lambda), np.zeros((len(L), landmark.dim, pose.dim))
        if self.initial == "first-sight":
            Q = np.tile(np.diag(np.broadcast_to(np.square(self.prior_sigma), landmark.dim)), (len(L), 1, 1))
        else:
            (A_x, A_l), _ = copied.linearize(np.tile(state.first, (len(numbers), 1)), L)
            G = -np.asarray(np.linalg.solve(A_l, A_x))
        state.add(numbers, L, G, Q)

    def _update(self, pieces: list[Measurements]) -> None:
        """All measurements of known variables at once."""
        state, known = self.state, []
        for factor, numbers in pieces:
            if not len(factor):
                continue
            rows = None if numbers is None else state.rows(numbers)
            if rows is not None and numbers is not None and (rows < 0).any():
                k = int(np.argmax(rows < 0))
                key = Keys(self._kind, int(numbers[k]))
                named = self.associate is None and not self.first_estimates
                waits = named and self.initial != "delayed" and can_wait(factor, state.spaces)
                cure = ", or EKF(landmarks='delayed'), where sightings wait for each other" if waits else ""
                needs = f"a filter needs a sighting with direction and distance first, or a Prior of {key}{cure}"
                message = f"{factor.describe(k)} is the first of {key} and does not determine its position; {needs}"
                raise GraphError(message, [self._pose, key], factor.name)
            known.append((self._copies(factor).model, rows))
        if not known:
            return
        A, columns, b = stacked(state, known)
        before, d = np.zeros(state.n), state.spaces[0].dim
        for _ in range(self.iterations - 1):
            delta = state.step(A, columns, b, self._pose)
            if np.abs(delta - before).max() < 1e-6:  # m, rad
                break
            before = delta
            target = state.moved(delta)
            A, columns, b = stacked(target, known)
            # J_r(delta) in its place lets a shift of everything be seen: NEES 18, not 3.4, of correlated landmarks
            A[:, :d] = A[:, :d] @ state.turn(state.X[None], target.X[None])[0]
            b = b + A @ delta[columns]
        state.update(A, columns, b, self._pose)


def _inverse(Lambda: Array) -> Array:
    """Covariances (n, d, d) of informations, symmetric; scaled to a diagonal of ones first."""
    D = 1 / np.sqrt(np.diagonal(Lambda, axis1=1, axis2=2))
    scale = D[:, :, None] * D[:, None, :]
    return np.asarray(scale * np.linalg.inv(scale * Lambda))
