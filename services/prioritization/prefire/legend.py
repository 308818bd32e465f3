"""The legend of the danger maps: the five classes of the National Fire Danger Rating System in their colours.

Limits are even steps of 35 below the USGS's top class (141-247): an index of ours, since the USGS publishes no classes
with names for WFPI. Masked ground keeps muted colours of its own.
"""

from __future__ import annotations

from services.prioritization.prefire.fire_potential import LARGEST_VALUE, MASK_CODES

CLASS_EDGES = (0, 36, 71, 106, 141, 248)
CLASS_NAMES = ("low", "moderate", "high", "very high", "extreme")
CLASS_COLOURS = ("#2e8b3d", "#3f7fd0", "#f5e04a", "#f08a24", "#c8102e")
MASK_COLOURS = {
    248: "#ffffff",
    249: "#ffffff",
    250: "#eaf6ff",
    251: "#e3dcc0",
    252: "#cfcfcf",
    253: "#a9cdbb",
    254: "#b9d3ea",
    255: "#8c8c8c",
}


def class_label(index: int) -> str:
    """Name and limits of a class, such as "high 71-105"."""
    return f"{CLASS_NAMES[index]} {CLASS_EDGES[index]}–{CLASS_EDGES[index + 1] - 1}"


def colormap() -> dict[int, tuple[int, int, int]]:
    """Red, green and blue of every byte of a WFPI raster."""
    colours = {}
    for low, high, colour in zip(CLASS_EDGES[:-1], CLASS_EDGES[1:], CLASS_COLOURS, strict=True):
        colours |= dict.fromkeys(range(low, min(high, int(LARGEST_VALUE) + 1)), _rgb(colour))
    return colours | {code: _rgb(colour) for code, colour in MASK_COLOURS.items()}


def mask_text(factor: int = 1) -> str:
    """The mask codes of a raster in words, codes times ``factor``."""
    return ", ".join(f"{code * factor} {meaning}" for code, meaning in MASK_CODES.items())


def _rgb(colour: str) -> tuple[int, int, int]:
    red, green, blue = (int(colour[first : first + 2], 16) for first in (1, 3, 5))
    return red, green, blue
