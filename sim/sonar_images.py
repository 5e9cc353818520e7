r"""A plain synthetic sonar image, beams by range bins, of points or of a scene, and the contacts in it.

Every point in view adds an echo spread over neighboring beams and bins; speckle and background are those of a sum of
many small echoes of random phase:

    A(b, k) = sum_i a exp(-((b - b_i)^2 + (k - k_i)^2) / (2 s^2)),     I = |A + w (n_1 + j n_2)|,  n_1, n_2 ~ N(0, 1)

where b_i and k_i are the place of point i in beams and bins, not rounded. Without a point that is a Rayleigh variable
of scale w (mean 1.25 w, above 4 w once in 3,000 cells); with a strong one it is a + w n. No losses on the way: sonars
make up for those with gain. Which elevation an echo came from, the image does not show.

Surfaces of a scene (walls and piles, `sim.scene`) are rough: their echo is speckle, too. `RAYS` rays a beam, N in one
beam, each meet their first surface at an angle of incidence i, and

    I = |A + u (n_1 + j n_2)|
    u^2 = t v^2 + a^2 / (2 N sqrt(pi) s) sum_i cos^2(i) exp(-((b - b_i)^2 + (k - k_i)^2) / s^2)

so that a wall at right angles has the root mean square amplitude a, and an oblique one less by the law of Lambert. The
background is v = w before the first surface, and `shadow` times w behind it (the share of the rays counts where the
edge of a shadow is in a beam). The texture t is 1 for Rayleigh speckle. For K-distributed speckle it is a gamma
variable of shape nu and mean 1, drawn for every cell. The smaller nu, the more often a bright cell.

Source: J. Goodman, Speckle Phenomena in Optics, 2007, sections 2.2 (background) and 2.3 (a constant plus speckle);
E. Jakeman and P. Pusey, "A model for non-Rayleigh sea echo", IEEE Trans. Antennas and Propagation 24(6), 1976;
D. Abraham and A. Lyons, "Novel physical interpretations of K-distributed reverberation", IEEE JOE 27(4), 2002.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.errors import GraphError, OptionError
from models.options import check_positive
from models.sensors import ImagingSonar, range_azimuth
from sim.checks import check_fraction, check_not_negative, check_rng
from sim.scene import Scene

__all__ = ["contacts", "sonar_image"]

FAR = 4.0  # standard deviations of an echo beyond which it is less than 0.0004 of its peak
RAYS = 5  # a beam, evenly spaced: 9 mm apart at 10 m for a beam of 0.25 deg


def sonar_image(
    p: Array | Scene,
    sonar: ImagingSonar,
    rng: np.random.Generator,
    echo: float = 1.0,
    background: float = 0.05,
    spread: float = 1.0,
    *,
    pose: npt.ArrayLike | None = None,
    shadow: float = 0.3,
    speckle: Literal["rayleigh", "k"] = "rayleigh",
    nu: float | None = None,
) -> Array:
    """Image of points or of a scene, amplitude by beam (from port to starboard) and range bin (from near to far).

    Parameters
    ----------
    p : (n, 3) points in the frame of the sonar, m; those it does not see leave no echo. Or a scene: its rocks are
        points at elevation 0, its walls and piles are rough surfaces that hide all behind them.
    sonar : its beams, bins, fan, aperture and window.
    rng : source of the speckle.
    echo : amplitude a of a point; root mean square amplitude of a wall at right angles.
    background : scale w of the speckle.
    spread : standard deviation s of an echo, in beams and in bins.
    pose : (3,) x, y and yaw of the sonar in the world of the scene, m and rad; for a scene only, and needed there.
    shadow : scale of the speckle behind a surface over that before it, 0 to 1.
    speckle : "rayleigh", or "k" for K-distributed amplitudes of the background.
    nu : shape of its texture, above 0, for "k" only, and needed there: 0.5 is spiky, 10 nearly Rayleigh.

    Returns
    -------
    (beams, bins) array, at least 0.

    Raises
    ------
    OptionError
        An amplitude below 0, a spread or shape that is not above 0, a shadow outside 0 to 1; another speckle, a shape
        that is missing or of no use.
    GraphError
        A scene without a pose, points with one.

    Examples
    --------
    >>> import numpy as np
    >>> from models.sensors import DIDSON_HIGH
    >>> image = sonar_image(np.array([[4.0, 0.5, 0.2]]), DIDSON_HIGH, np.random.default_rng(0))
    >>> image.shape, bool(image.max() > 10 * np.median(image))
    ((96, 512), True)

    A pile 5 m ahead; in its shadow the speckle is weaker:

    >>> from sim import Scene
    >>> scene = Scene(piles=[[5.0, 0.0, 0.3]])
    >>> image = sonar_image(scene, DIDSON_HIGH, np.random.default_rng(0), pose=[0, 0, 0])
    >>> bool(image[46:50, 300:].mean() < 0.5 * image[:20, 300:].mean())
    True
    """
    check_rng(rng)
    check_not_negative(echo=echo, background=background)
    check_positive(spread=spread)
    check_fraction(shadow=shadow)
    _check_speckle(speckle, nu)
    _check_pose(p, pose)
    scale: float | Array = background
    surfaces: float | Array = 0.0
    if isinstance(p, Scene):
        at = np.asarray(pose, dtype=float)
        shaded, lit = _surfaces(p, sonar, at, spread)
        scale = background * np.sqrt(1 - (1 - shadow**2) * shaded)
        surfaces = echo**2 * lit
        p = p.visible_rocks(at)
    p = np.asarray(p, dtype=float).reshape(-1, 3)
    p = p[sonar.sees(p)]
    A = np.zeros((sonar.beams, sonar.bins))
    if len(p):
        r, azimuth = range_azimuth(p)[0].T
        A = _spread(sonar, r, azimuth, np.full(len(p), echo), spread)
    n_1, n_2 = rng.standard_normal((2, *A.shape))
    if speckle == "k":
        assert nu is not None
        scale = scale * np.sqrt(rng.gamma(nu, 1 / nu, A.shape))
    u = np.sqrt(scale**2 + surfaces) if isinstance(surfaces, np.ndarray) else scale
    return np.asarray(np.hypot(A + u * n_1, u * n_2))


def contacts(image: Array, sonar: ImagingSonar, threshold: float) -> Array:
    """Contacts in an image: cells above the threshold that no cell within two beams and bins exceeds.

    Two points closer than that are one contact. `nls.sonar.detect` gives all cells of an echo, above a threshold that
    follows the noise.

    Parameters
    ----------
    image : (beams, bins) array.
    sonar : that made it.
    threshold : least amplitude of a contact, in the unit of the image.

    Returns
    -------
    (n, 2) range, m, and azimuth, rad, of the centers of these cells, by beam, then by bin. They are off by a cell at
    most while the echo stands well above the background.

    Raises
    ------
    GraphError
        An image of another sonar.

    Examples
    --------
    >>> import numpy as np
    >>> from models.sensors import DIDSON_HIGH
    >>> image = sonar_image(np.array([[4.0, 0.5, 0.2]]), DIDSON_HIGH, np.random.default_rng(0))
    >>> contacts(image, DIDSON_HIGH, threshold=0.5).round(2)
    array([[4.04, 0.12]])
    """
    from scipy.ndimage import center_of_mass, label, maximum_filter

    image = np.asarray(image, dtype=float)
    if image.shape != (sonar.beams, sonar.bins):
        raise GraphError(
            f"contacts: an image of shape {image.shape}, {sonar.name} makes ({sonar.beams}, {sonar.bins}): beams, bins"
        )
    peaks = (image >= threshold) & (image == maximum_filter(image, size=5, mode="constant"))
    labels, count = label(peaks, structure=np.ones((3, 3)))  # equal neighbors are one peak, at their middle
    b, k = np.array(center_of_mass(peaks, labels, np.arange(1, count + 1))).reshape(-1, 2).T
    near, far = sonar.window
    r, azimuth = near + (k + 0.5) / sonar.bins * (far - near), ((b + 0.5) / sonar.beams - 0.5) * sonar.fan
    return np.column_stack([r, azimuth])


def _surfaces(scene: Scene, sonar: ImagingSonar, pose: Array, spread: float) -> tuple[Array, Array]:
    """Share of the rays of a beam that a surface has stopped before a bin, and power of the surfaces, (beams, bins)."""
    near, far = sonar.window
    azimuth = ((np.arange(sonar.beams * RAYS) + 0.5) / (sonar.beams * RAYS) - 0.5) * sonar.fan
    hits = scene.hits(pose[None], azimuth)
    r, cosine = hits.range[0], hits.cosine[0]
    middle = near + (np.arange(sonar.bins) + 0.5) / sonar.bins * (far - near)
    shaded = (middle > r.reshape(sonar.beams, RAYS, 1)).mean(axis=1)
    met = (near <= r) & (r <= far)
    power = cosine[met] ** 2 / (2 * RAYS * np.sqrt(np.pi) * spread)
    return shaded, _spread(sonar, r[met], azimuth[met], power, spread / np.sqrt(2))


def _spread(sonar: ImagingSonar, r: Array, azimuth: Array, peak: Array, spread: float) -> Array:
    """Sum of bells (beams, bins) of the given peaks (n,) at ranges and azimuths (n,)."""
    out = np.zeros((sonar.beams, sonar.bins))
    near, far = sonar.window
    b_i = (azimuth / sonar.fan + 0.5) * sonar.beams - 0.5  # the center of beam 0 is at 0
    k_i = (r - near) / (far - near) * sonar.bins - 0.5
    around = np.arange(-int(np.ceil(FAR * spread)), int(np.ceil(FAR * spread)) + 1)
    b, k = np.rint(b_i)[:, None] + around, np.rint(k_i)[:, None] + around  # (n, cells), the cells an echo reaches
    in_beam, in_bin = _bell(b - b_i[:, None], spread), _bell(k - k_i[:, None], spread)
    in_beam[(b < 0) | (b >= sonar.beams)] = 0.0
    in_bin[(k < 0) | (k >= sonar.bins)] = 0.0
    cell = (b % sonar.beams)[:, :, None] * sonar.bins + (k % sonar.bins)[:, None, :]
    np.add.at(out.ravel(), cell.astype(np.intp), peak[:, None, None] * in_beam[:, :, None] * in_bin[:, None, :])
    return out


def _bell(d: Array, spread: float) -> Array:
    return np.asarray(np.exp(-0.5 * (d / spread) ** 2))


def _check_speckle(speckle: str, nu: float | None) -> None:
    if speckle not in ("rayleigh", "k"):
        raise OptionError("speckle", speckle, "'rayleigh' or 'k'")
    if speckle == "k":
        if nu is None:
            raise OptionError("nu", nu, "a number above 0, the shape of the texture of K-distributed speckle")
        check_positive(nu=nu)
    elif nu is not None:
        raise OptionError("nu", nu, "None for Rayleigh speckle; take speckle='k'")


def _check_pose(p: Array | Scene, pose: npt.ArrayLike | None) -> None:
    if isinstance(p, Scene):
        if pose is None or np.shape(pose) != (3,):
            got = "none" if pose is None else f"one of shape {np.shape(pose)}"
            raise GraphError(f"sonar_image: a scene needs a pose (3,), x, y and yaw; got {got}")
    elif pose is not None:
        raise GraphError("sonar_image: points are in the frame of the sonar and have no pose; give a Scene with one")
