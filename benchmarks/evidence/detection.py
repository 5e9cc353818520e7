"""Detections in sonar images: are false alarms as frequent as stated, and from which echo on is one detected?

    python benchmarks/evidence/detection.py [--images 40] [--out DIR]

Every image has the size of an Oculus M750d, 512 beams of 1,000 bins; seeds 0, 1, 2, ...
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.stats import ncx2
from script import make_page, markdown

import sim
from models.algebra import Array, Mask
from models.sensors import ARIS_3000, DIDSON_HIGH, OCULUS_M750D, ImagingSonar
from nls.missions.sonar import detect

DETECTORS = ("ca", "soca", "goca", "os")
RATES = (1e-2, 1e-3, 1e-4)
SHAPES = (4.0, 1.0, 0.5)
TRAIN, GUARD = 20, 5
REACH = TRAIN + GUARD
SONAR = OCULUS_M750D
SIGNALS = (0, 3, 6, 9, 12, 15, 18, 21, 24, 30)  # dB
STEADY = 6  # of them: a steady echo is always detected from there on
APART, CLOSE = 100, 12  # bins between echoes: no window has two; bins to a stronger one in the window
STRONG = 30  # dB
RANGE = 5.0  # m, within which cells of a raster are counted


def mask(image: Array, detector: str, false_alarms: float) -> Mask:
    """Detections as an image."""
    detections = detect(image, SONAR, detector, false_alarms, TRAIN, GUARD)
    out = np.zeros(image.shape, dtype=bool)
    out[SONAR.beam(detections.azimuth), SONAR.bin(detections.range)] = True
    return out


def noise(seed: int, nu: float | None = None) -> Array:
    """An image without an echo."""
    speckle = "rayleigh" if nu is None else "k"
    return sim.sonar_image(np.zeros((0, 3)), SONAR, np.random.default_rng(seed), 0.0, speckle=speckle, nu=nu)


def rates(images: int, nu: float | None) -> dict[tuple[str, float], tuple[float, float]]:
    """Measured rate where the window is whole, and in the first and last bins where it is cut."""
    counts = {(detector, rate): np.zeros(2) for detector in DETECTORS for rate in RATES}
    for seed in range(images):
        image = noise(seed, nu)
        for key, count in counts.items():
            hits = mask(image, *key)
            inner = hits[:, REACH:-REACH].sum()
            count += [inner, hits.sum() - inner]
    cells = images * SONAR.beams * np.array([SONAR.bins - 2 * REACH, 2 * REACH])
    return {key: tuple(count / cells) for key, count in counts.items()}


def share(false_alarms: float, draw: Callable[[np.random.Generator], tuple[Array, Array]], detector: str) -> float:
    """Share of marked cells that are detected, over 5 images; `draw` makes an image and the mask of these cells."""
    hits = marked = 0
    for seed in range(5):
        image, cells = draw(np.random.default_rng(seed))
        hits, marked = hits + (mask(image, detector, false_alarms) & cells).sum(), marked + cells.sum()
    return float(hits / marked)


def echoes(signal: float, fluctuating: bool, neighbor: float | None = None) -> Callable[..., tuple[Array, Array]]:
    """Noise with an echo every 100 bins of each beam, `signal` dB above the mean power of the noise."""

    def draw(rng: np.random.Generator) -> tuple[Array, Array]:
        z = rng.standard_normal((2, SONAR.beams, SONAR.bins))
        cells = np.zeros(z[0].shape, dtype=bool)
        cells[:, APART // 2 :: APART] = True
        amplitude = np.sqrt(2 * 10 ** (signal / 10))
        if fluctuating:
            z[:, cells] *= np.sqrt(1 + amplitude**2 / 2)
        else:
            z[0, cells] += amplitude
        if neighbor is not None:
            z[0, :, APART // 2 + CLOSE :: APART] += np.sqrt(2 * 10 ** (neighbor / 10))
        return np.hypot(*z), cells

    return draw


def step(rng: np.random.Generator) -> tuple[Array, Array]:
    """Noise that falls by 10.5 dB in the middle of each beam, and the loud cells whose window reaches beyond."""
    middle = SONAR.bins // 2
    image = rng.rayleigh(1.0, (SONAR.beams, SONAR.bins))
    image[:, middle:] *= 0.3
    cells = np.zeros(image.shape, dtype=bool)
    cells[:, middle - REACH : middle] = True
    return image, cells


def lost(sonar: ImagingSonar, edge: float) -> float:
    """Share of the polar cells within 5 m that no square of a Cartesian raster takes its value from."""
    x, y = np.meshgrid(*(np.arange(low, RANGE, edge) + edge / 2 for low in (0.0, -RANGE)))
    bin, beam = sonar.bin(np.hypot(x, y)).ravel(), sonar.beam(np.arctan2(y, x)).ravel()
    last = int(sonar.bin(min(RANGE, sonar.window[1])))
    taken = (bin >= 0) & (bin < last) & (beam >= 0) & (beam < sonar.beams)
    return 1 - len(np.unique(beam[taken] * sonar.bins + bin[taken])) / (sonar.beams * last)


def page(images: int) -> list[str]:
    """All but the head."""
    cells = images * SONAR.beams * SONAR.bins
    rayleigh = rates(images, None)
    ratios = [
        [detector, *(f"{rayleigh[detector, rate][cut] / rate:.3f}" for cut in (0, 1) for rate in RATES)]
        for detector in DETECTORS
    ]
    columns = [f"{rate:g}{where}" for where in ("", ", cut") for rate in RATES]
    lines = [
        "## False alarms in Rayleigh noise, measured over nominal",
        *markdown(["detector", *columns], ratios),
        f"{cells / 1e6:.1f} million cells; {TRAIN} training and {GUARD} guard cells a side. *Cut*: the first and last "
        f"{REACH} bins, where one side of the window decides; there 1e-4 are {cells * 0.05 * 1e-4:.0f} false alarms, "
        f"known to {100 / np.sqrt(cells * 0.05 * 1e-4):.0f} % at best, as neighboring cells share their window.",
        "## False alarms in K-distributed noise",
    ]
    spiky = []
    for nu in SHAPES:
        measured = rates(max(1, images // 4), nu)
        spiky += [[f"{nu:g}", d, *(f"{measured[d, rate][0]:.1e}" for rate in RATES)] for d in DETECTORS]
    lines += markdown(["nu", "detector", *(f"nominal {rate:g}" for rate in RATES)], spiky)
    lines += ["Rates, not ratios. Thresholds are set for Rayleigh noise; neighboring cells share no texture."]
    for fluctuating, title in ((False, "steady echo"), (True, "fluctuating echo (Rayleigh, as of a rough wall)")):
        rows = []
        for signal in SIGNALS if fluctuating else SIGNALS[:STEADY]:
            power = 10 ** (signal / 10)
            known = 1e-3 ** (1 / (1 + power)) if fluctuating else ncx2.sf(-2 * np.log(1e-3), 2, 2 * power)
            measured = [f"{share(1e-3, echoes(signal, fluctuating), d):.3f}" for d in DETECTORS]
            rows.append([f"{signal}", *measured, f"{known:.3f}"])
        lines += [f"## Detected at 1e-3: {title}"]
        lines += markdown(["signal to noise, dB", *DETECTORS, "noise level known"], rows)
    strong = echoes(15, False, STRONG)
    uneven = [[d, f"{share(1e-3, strong, d):.3f}", f"{share(1e-3, step, d):.1e}"] for d in DETECTORS]
    titles = ["detector", f"15 dB detected {CLOSE} bins from {STRONG} dB", "false alarms before a shadow"]
    lines += [
        f"One cell an echo, {5 * SONAR.beams * SONAR.bins // APART:,} echoes a row.",
        "## Uneven noise, at 1e-3",
        *markdown(titles, uneven),
        f"Before a shadow: the {REACH} bins before the noise falls by 10.5 dB.",
        f"## Cells within {RANGE:g} m that a Cartesian raster loses",
    ]
    rows = []
    for sonar in [*(replace(SONAR, window=(0.5, far)) for far in (10.5, 20.5, 40.5)), ARIS_3000, DIDSON_HIGH]:
        length = (sonar.window[1] - sonar.window[0]) / sonar.bins
        shares = [f"{100 * lost(sonar, edge):.0f} %" for edge in (length, 0.1, 0.2)]
        rows.append([f"{sonar.name}, {sonar.window[0]:g}-{sonar.window[1]:g} m", f"{100 * length:.1f}", *shares])
    lines += markdown(["sonar", "bin, cm", "squares of one bin", "squares of 0.1 m", "squares of 0.2 m"], rows)
    return [*lines, "Every square shows the cell at its center; other cells are lost."]


if __name__ == "__main__":
    make_page("Detections in sonar images", page, images=(40, "images of Rayleigh noise"))
