"""The colors of the pictures differ for everyone: for normal sight and for the three kinds of color blindness."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from nls.plot.style import BEFORE, CLOSURE, ECHO, ESTIMATE, LANDMARK, REJECTED, SERIES, TRUE

SIGHT = {  # what is seen of linear red, green and blue: G. Machado et al., IEEE TVCG 15(6), 2009, severity 1
    "normal": np.eye(3),
    "no red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "no green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
    "no blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
LEAST = 12.0  # CIE 1976 distance; 2.3 is just noticeable for areas side by side, thin lines need several times that


def lab(color: str, sight: str) -> np.ndarray:
    c = np.array(to_rgb(color))
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    t = XYZ @ np.clip(np.asarray(SIGHT[sight]) @ linear, 0, 1) / XYZ.sum(axis=1)
    f = np.where(t > 0.008856, np.cbrt(t), 7.787 * t + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("sight", SIGHT)
def test_colors_that_meet_are_told_apart(sight: str) -> None:
    of_maps = (ESTIMATE, BEFORE, TRUE, CLOSURE, REJECTED, ECHO)
    for together in (SERIES, of_maps, (LANDMARK, ESTIMATE, TRUE)):
        near = [(a, b) for a, b in combinations(together, 2) if np.linalg.norm(lab(a, sight) - lab(b, sight)) < LEAST]
        assert near == []
