"""Input of `integrate`: arrays of the right shape, finite, with rising times; all else is refused by name."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array, Mask
from models.errors import GraphError, OptionError
from models.finite import first_not_finite, numbers
from models.manifolds.euler import quaternion_from_angles
from models.manifolds.se3 import SE3
from models.manifolds.so3 import not_unit
from models.options import is_number


def rising(name: str, value: npt.ArrayLike) -> Array:
    """Two or more finite times that rise, s."""
    t = numbers("integrate", name, value)
    if t.ndim != 1 or len(t) < 2:
        raise GraphError(f"integrate: {name} has shape {t.shape}, expected (n,) with n of 2 or more, in seconds")
    _finite(name, t[:, None])
    late = np.flatnonzero(t[1:] <= t[:-1])
    if len(late):
        k = int(late[0]) + 1
        raise GraphError(
            f"integrate: {name}[{k}] = {float(t[k])!r} s does not rise over {float(t[k - 1])!r} s before it; sort the "
            "samples by time and leave out repeated ones"
        )
    return t


def vectors(name: str, value: npt.ArrayLike, n: int, ok: Mask | None = None) -> Array:
    """Vectors (n, 3), finite where they are ok."""
    x = _shaped(name, numbers("integrate", name, value), n, (3,))
    _finite(
        name,
        x if ok is None else np.where(ok[:, None], x, 0.0),
        "; mark what is not measured in valid" if name == "v" else "",
    )
    return x


def attitudes(value: npt.ArrayLike, n: int) -> Array:
    """Unit quaternions (n, 4) from themselves, or from roll, pitch, yaw (n, 3)."""
    x = _shaped("attitude", numbers("integrate", "attitude", value), n, (4, 3))
    _finite("attitude", x)
    if x.shape[1] == 3:
        return quaternion_from_angles(x)
    if (problem := not_unit(x)) is not None:
        raise GraphError(f"integrate: attitude[{problem[0]}]: {problem[1]}")
    return x


def bottom_lock(valid: npt.ArrayLike | None, n: int) -> Mask:
    """Which of n velocities are valid."""
    ok = np.ones(n, dtype=bool) if valid is None else np.asarray(valid)
    if ok.shape != (n,) or not (ok.dtype == bool or np.isin(ok, (0, 1)).all()):
        raise GraphError(
            f"integrate: valid has shape {ok.shape} and type {ok.dtype}, expected ({n},) of True and False"
        )
    if np.count_nonzero(ok) < 2:
        raise GraphError(f"integrate: {np.count_nonzero(ok)} of {n} velocities are valid; expected 2 or more")
    return ok.astype(bool)


def positive(name: str, sigma: npt.ArrayLike | None, n: int) -> Array:
    """Standard deviations (n, 3) from one number, three, or all of them."""
    if sigma is None:
        raise OptionError(name, None, "a number above 0, or three")
    x = numbers("integrate", name, sigma)
    if x.shape not in ((), (3,), (n, 3)):
        raise GraphError(f"integrate: {name} has shape {x.shape}, expected a number, (3,) or ({n}, 3)")
    if not (np.isfinite(x) & (x > 0)).all():
        raise OptionError(name, sigma, "finite and above 0")
    return np.broadcast_to(x, (n, 3))


def fraction(scale: float) -> float:
    """The standard deviation of a scale factor."""
    if not (is_number(scale) and 0 <= scale < np.inf):
        raise OptionError("scale", scale, "a fraction of the speed, 0 or above: 0.002 for 0.2 %")
    return scale


def mounting(mount: npt.ArrayLike) -> Array:
    """The one pose (1, 7) of the DVL on the vehicle."""
    O = numbers("integrate", "mount", mount)
    if O.shape != (7,):
        raise GraphError(f"integrate: mount has shape {O.shape}, expected (7,): one pose x y z qx qy qz qw")
    return SE3.stack(O)


def not_negative(name: str, sigma: npt.ArrayLike) -> Array:
    """Standard deviations (3,) from one number or three, of an error that may be none."""
    x = numbers("integrate", name, sigma)
    if x.shape not in ((), (3,)):
        raise GraphError(f"integrate: {name} has shape {x.shape}, expected a number or (3,)")
    if not (np.isfinite(x) & (x >= 0)).all():
        raise OptionError(name, sigma, "finite and 0 or above")
    return np.broadcast_to(x, (3,))


def unused(name: str, sigma: npt.ArrayLike | None, alternative: str) -> None:
    """Refuse the sigma of the sensor that is not given."""
    if sigma is not None:
        raise OptionError(name, sigma, f"None where {alternative} is given")


def bridge(sigma: float | None, begin: float, end: float) -> float:
    """The density of what a bridge over the drop-out from begin to end does not know."""
    if sigma is None or not (is_number(sigma) and 0 <= sigma < np.inf):
        raise OptionError(
            "sigma_bridge",
            sigma,
            "the density by which the velocity wanders in a drop-out, m/s/sqrt(s), 0 or above: no velocity is valid "
            f"between {begin:.6g} and {end:.6g} s",
        )
    return sigma


def turning(sigma: npt.ArrayLike | None, m: int, begin: float, end: float) -> Array:
    """The densities (m, 3) by which the attitude wanders after each of m samples, where the next is far."""
    if sigma is None:
        raise OptionError(
            "sigma_turn",
            None,
            "the density by which the attitude wanders in a drop-out, rad/sqrt(s), 0 or above: none is measured "
            f"between {begin:.6g} and {end:.6g} s",
        )
    x = numbers("integrate", "sigma_turn", sigma)
    if x.shape not in ((), (3,), (m, 3)):
        raise GraphError(f"integrate: sigma_turn has shape {x.shape}, expected a number, (3,) or ({m}, 3)")
    if not (np.isfinite(x) & (x >= 0)).all():
        raise OptionError("sigma_turn", sigma, "finite and 0 or above")
    return np.broadcast_to(x, (m, 3))


def within(b: Array, t: Array, record: str) -> None:
    """Refuse boundaries outside of samples: nothing is extrapolated."""
    bad = (b < t[0]) | (b > t[-1])
    if bad.any():
        k = int(np.argmax(bad))
        raise GraphError(
            f"integrate: boundaries[{k}] = {float(b[k])!r} s is outside of the {record}, which last from "
            f"{float(t[0])!r} to {float(t[-1])!r} s"
        )


def _shaped(name: str, x: Array, n: int, sizes: tuple[int, ...]) -> Array:
    if x.ndim != 2 or len(x) != n or x.shape[1] not in sizes:
        shapes = " or ".join(f"({n}, {size})" for size in sizes)
        raise GraphError(f"integrate: {name} has shape {x.shape}, expected {shapes}: one row for each of {n} times")
    return x


def _finite(name: str, x: Array, cure: str = "") -> None:
    if (k := first_not_finite(x)) is not None:
        raise GraphError(f"integrate: {name}[{k}] is {np.squeeze(x[k]).tolist()}, expected finite numbers{cure}")
