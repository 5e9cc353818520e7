"""Animations: the frames in order, one still for who cannot play, a bound on the bytes, nothing over the network."""

from __future__ import annotations

import re
from io import BytesIO

import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image

from models.errors import OptionError
from nls.plot import animation
from nls.plot.player import Animation, image


def moving(**options: object) -> Animation:
    figure, axes = plt.subplots(figsize=(2, 1))
    axes.set_axis_off()

    def draw(shade: float) -> None:
        figure.set_facecolor(str(shade))

    return animation(figure, draw, [0.0, 0.5, 1.0], **({"alt": 'From <black> to "white".'} | options))  # type: ignore[arg-type]


def test_the_frames_are_in_order_and_the_last_one_is_the_still() -> None:
    made = moving()
    shades = [np.asarray(Image.open(BytesIO(frame))).mean() for frame in made.frames]
    assert np.allclose(shades, [0, 127, 255], atol=3)
    assert np.asarray(Image.open(BytesIO(made._repr_png_()))).mean() == 255
    assert len(plt.get_fignums()) == 0, "the cell would show the figure a second time"


def test_the_page_of_an_animation_stands_alone() -> None:
    made = moving(seconds=0.5)
    html = made._repr_html_()
    still = re.search(r'<img src="data:image/webp;base64,([^"]+)" alt="([^"]+)"', html)
    assert still is not None
    assert still[2] == "From &lt;black&gt; to &quot;white&quot;."
    assert f'"{still[1]}"]' in html, "what stands there before anything plays is the last frame"
    assert "seconds = [0.5, 0.5, 0.5];" in html
    assert "http" not in html
    assert "$" not in html
    assert html.index("<div hidden>") < html.index("controls.hidden = false"), "without scripts there are no controls"
    assert moving().html.split('id="')[1][:15] == html.split('id="')[1][:15], "the same frames give the same bytes"


def test_a_frame_is_the_whole_figure_on_white() -> None:
    figure = plt.figure(figsize=(4.33, 3.17))
    figure.set_facecolor((0, 0, 0, 0.5))
    plain = np.asarray(image(figure))
    assert plain.shape == (253, 346, 3)
    assert np.allclose(plain, 127, atol=1), "half transparent black on white"
    with plt.rc_context({"savefig.bbox": "tight"}):
        assert np.array_equal(np.asarray(image(figure)), plain)
    plt.close(figure)


def test_what_is_refused() -> None:
    figure = plt.figure()
    with pytest.raises(OptionError, match=r"frames.* expected at least one"):
        animation(figure, print, [], alt="Nothing.")
    for seconds in (0, float("inf"), [0.1, 0.2], [0.1, 0.1, -1]):
        with pytest.raises(OptionError, match=r"seconds.* above 0 for all frames, or one for each"):
            moving(seconds=seconds)
    assert "seconds = [1.0, 2.0, 3.0];" in moving(seconds=[1, 2, 3]).html
    noise = np.random.default_rng(0)
    figure, axes = plt.subplots(figsize=(8, 8))
    with pytest.raises(OptionError, match=r"frames.* at most 1,000,000 bytes"):
        animation(figure, lambda _: axes.imshow(noise.random((600, 600, 3))), range(6), alt="Noise.")
    plt.close("all")
