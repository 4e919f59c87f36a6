"""Colours that stay apart: each next one as far as can be from all before it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# From OKLab (Ottosson 2020) to linear sRGB: rows of the two matrices of its definition.
_TO_CONES = np.array(
    ((1, 0.3963377774, 0.2158037573),
     (1, -0.1055613458, -0.0638541728),
     (1, -0.0894841775, -1.2914855480))
)  # fmt: skip
_TO_LINEAR = np.array(
    ((4.0767416621, -3.3077115913, 0.2309699292),
     (-1.2684380046, 2.6097574011, -0.3413193965),
     (-0.0041960863, -0.7034186147, 1.7076147010))
)  # fmt: skip


def distinct_colours(count: int) -> NDArray[np.uint8]:
    """Colours for `count` regions; the first of them do not depend on `count`.

    Parameters
    ----------
    count : int
        How many; beyond those of `palette` they come again, in the same order.

    Returns
    -------
    ndarray of uint8, shape (count, 3)
        Red, green, blue. Neither very dark nor very light, so that shading shows on them.
    """
    return np.resize(palette(), (count, 3))


@lru_cache(maxsize=1)
def palette() -> NDArray[np.uint8]:
    """All colours there are, each once: red, green, blue, not to be written to."""
    lab, rgb = _candidates()
    chosen = [int(np.argmin(np.linalg.norm(lab - (0.62, -0.05, -0.13), axis=1)))]  # blue
    apart = np.full(len(lab), np.inf)
    while len(chosen) < len(lab):
        apart = np.minimum(apart, np.linalg.norm(lab - lab[chosen[-1]], axis=1))
        chosen.append(int(apart.argmax()))
    out = rgb[chosen]
    out.setflags(write=False)
    return out


def _candidates() -> tuple[Array, NDArray[np.uint8]]:
    """Colours of three lightnesses and two strengths around the circle of hues, in OKLab."""
    light, chroma, hue = np.meshgrid(
        (0.55, 0.68, 0.80), (0.10, 0.17), np.radians(np.arange(0, 360, 12)), indexing="ij"
    )
    lab = np.stack((light, chroma * np.cos(hue), chroma * np.sin(hue)), axis=-1).reshape(-1, 3)
    linear = ((lab @ _TO_CONES.T) ** 3) @ _TO_LINEAR.T
    inside = ((linear >= 0) & (linear <= 1)).all(axis=1)
    lab, linear = lab[inside], linear[inside]
    rgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return lab, np.round(255 * rgb).astype(np.uint8)
