"""Colours differ under red-green colour blindness, on light and dark pages; variants by line and marker."""

import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from bojax.report import style
from tests.report.synthetic import point_of

SEEN = {
    "normal": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
}
"""Matrices of linear sRGB of Machado, Oliveira and Fernandes (IEEE TVCG 15, 2009), severity 1."""

XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
WHITE = XYZ.sum(axis=1)
DISTINCT = (
    13.0  # CIE 1976 colour difference; about 2.3 is just noticeable between patches, more between lines
)
PAGES = {
    "light": ("#FFFFFF", style.PALETTE),
    "dark": (style._CARD, [style._GREYS.get(ink, ink) for ink in style.PALETTE]),
}


def linear(inks):
    values = np.array([to_rgb(ink) for ink in inks])
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def lab(values):
    """CIE L*a*b* of linear sRGB values `[N, 3]`, under D65."""
    shares = np.clip(values, 0.0, 1.0) @ XYZ.T / WHITE
    f = np.where(shares > 216 / 24389, np.cbrt(shares), (24389 / 27 * shares + 16) / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


@pytest.mark.parametrize("page", PAGES)
@pytest.mark.parametrize("seen", SEEN)
def test_every_two_colours_differ(seen, page):
    values = lab(linear(PAGES[page][1]) @ np.array(SEEN[seen]).T)
    for first, second in itertools.combinations(range(len(values)), 2):
        distance = np.linalg.norm(values[first] - values[second])
        assert distance >= DISTINCT, (style.PALETTE[first], style.PALETTE[second], distance)


@pytest.mark.parametrize("page", PAGES)
def test_every_colour_stands_out_from_the_page(page):
    ground, inks = PAGES[page]
    low, high = np.sort([linear(inks) @ XYZ[1], np.repeat(linear([ground]) @ XYZ[1], len(inks))], axis=0)
    assert ((high + 0.05) / (low + 0.05)).min() > 2.9


def test_two_settings_of_a_planner_differ_in_line_and_marker():
    looks = style.looks([point_of(number, "kcbts", f"kcbts-{number}") for number in range(5)])
    for first, second in itertools.combinations(looks, 2):
        assert first["linestyle"] != second["linestyle"] and first["marker"] != second["marker"]
    many = style.looks([point_of(number, "kcbts", f"kcbts-{number}") for number in range(25)])
    assert len({(str(look["linestyle"]), look["marker"]) for look in many}) == len(many)
