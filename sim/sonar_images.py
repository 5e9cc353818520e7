r"""A plain synthetic sonar image, beams by range bins, and the contacts in it.

Every point in view adds an echo spread over neighboring beams and bins; speckle and background are those of a sum of
many small echoes of random phase:

    A(b, k) = sum_i a exp(-((b - b_i)^2 + (k - k_i)^2) / (2 s^2)),     I = |A + w (n_1 + j n_2)|,  n_1, n_2 ~ N(0, 1)

where b_i and k_i are the place of point i in beams and bins, not rounded. Without a point that is a Rayleigh variable
of scale w (mean 1.25 w, above 4 w once in 3,000 cells); with a strong one it is a + w n. No shadows, no losses on the
way: sonars make up for those with gain. Which elevation an echo came from, the image does not show.

Source: J. Goodman, Speckle Phenomena in Optics, 2007, sections 2.2 (background) and 2.3 (a constant plus speckle).
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array
from models.errors import GraphError
from models.sensors import ImagingSonar, range_azimuth
from sim.checks import check_not_negative, check_positive, check_rng

__all__ = ["contacts", "sonar_image"]

FAR = 4.0  # standard deviations of an echo beyond which it is less than 0.0004 of its peak


def sonar_image(
    p: Array,
    sonar: ImagingSonar,
    rng: np.random.Generator,
    echo: float = 1.0,
    background: float = 0.05,
    spread: float = 1.0,
) -> Array:
    """Image of points, amplitude by beam (from port to starboard) and range bin (from near to far).

    Parameters
    ----------
    p : (n, 3) points in the frame of the sonar, m; those it does not see leave no echo.
    sonar : its beams, bins, fan, aperture and window.
    rng : source of the speckle.
    echo : amplitude a of a point.
    background : scale w of the speckle.
    spread : standard deviation s of an echo, in beams and in bins.

    Returns
    -------
    (beams, bins) array, at least 0.

    Raises
    ------
    OptionError
        An amplitude below 0, a spread that is not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from models.sensors import DIDSON_HIGH
    >>> image = sonar_image(np.array([[4.0, 0.5, 0.2]]), DIDSON_HIGH, np.random.default_rng(0))
    >>> image.shape, bool(image.max() > 10 * np.median(image))
    ((96, 512), True)
    """
    check_rng(rng)
    check_not_negative(echo=echo, background=background)
    check_positive(spread=spread)
    p = np.asarray(p, dtype=float).reshape(-1, 3)
    p = p[sonar.sees(p)]
    A = np.zeros((sonar.beams, sonar.bins))
    if len(p):
        r, azimuth = range_azimuth(p)[0].T
        near, far = sonar.window
        b_i = (azimuth / sonar.fan + 0.5) * sonar.beams - 0.5  # the center of beam 0 is at 0
        k_i = (r - near) / (far - near) * sonar.bins - 0.5
        around = np.arange(-int(np.ceil(FAR * spread)), int(np.ceil(FAR * spread)) + 1)
        b, k = np.rint(b_i)[:, None] + around, np.rint(k_i)[:, None] + around  # (n, cells), the cells an echo reaches
        in_beam, in_bin = _bell(b - b_i[:, None], spread), _bell(k - k_i[:, None], spread)
        in_beam[(b < 0) | (b >= sonar.beams)] = 0.0
        in_bin[(k < 0) | (k >= sonar.bins)] = 0.0
        cell = (b % sonar.beams)[:, :, None] * sonar.bins + (k % sonar.bins)[:, None, :]
        np.add.at(A.ravel(), cell.astype(np.intp), echo * in_beam[:, :, None] * in_bin[:, None, :])
    n_1, n_2 = rng.standard_normal((2, *A.shape))
    return np.asarray(np.hypot(A + background * n_1, background * n_2))


def contacts(image: Array, sonar: ImagingSonar, threshold: float) -> Array:
    """Contacts in an image: cells above the threshold that no cell within two beams and bins exceeds.

    Two points closer than that are one contact.

    Parameters
    ----------
    image : (beams, bins) array.
    sonar : that made it.
    threshold : least amplitude of a contact, in the unit of the image.

    Returns
    -------
    (n, 2) range, m, and azimuth, rad, of the centers of these cells, by beam, then by bin: off by a cell at most while
    the echo stands well above the background.

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


def _bell(d: Array, spread: float) -> Array:
    return np.asarray(np.exp(-0.5 * (d / spread) ** 2))
