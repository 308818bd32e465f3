"""What every figure shares: the line that says what it rests on, and a file without a clock."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def footer(attributes: Mapping[str, Any]) -> str:
    """What a picture rests on, in a line: simulated or not, oldest input, code and model version."""
    share = float(attributes.get("simulated_share") or 0.0)
    simulated = f"SIMULATED input ({100 * share:.0f} %)" if attributes.get("simulated") else "no simulated input"
    parts = [
        simulated,
        f"oldest input {attributes.get('oldest_input') or 'not stated'}",
        f"code {attributes.get('code_version', '')}",
    ]
    if attributes.get("model_version"):
        parts.append(f"model {attributes['model_version']}")
    return " · ".join(parts)


def save(figure: Figure, path: str | Path, attributes: Mapping[str, Any], *, dpi: int = 110) -> None:
    """Write the figure as PNG under its footer line; a simulated one also carries the word across its corner.

    Counts of what was left out (``screening``) travel in the file as text. The same figure gives the same bytes: no
    software name and no time in the file.
    """
    figure.text(0.008, 0.008, footer(attributes), fontsize=7, color="0.35", ha="left", va="bottom")
    if attributes.get("simulated"):
        figure.text(0.992, 0.992, "SIMULATED", fontsize=9, color="#b30000", weight="bold", ha="right", va="top")
    counts = {"screening": str(attributes["screening"])} if "screening" in attributes else {}
    figure.savefig(path, format="png", dpi=dpi, metadata={"Software": None, **counts})
