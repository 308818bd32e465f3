"""The settings table of docs/operations.md against the settings."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from shared.settings import ServiceSettings

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "operations.md").read_text()
SECTION = PAGE.split("\n## Settings\n")[1].split("\n## ")[0]
ROWS = dict(re.findall(r"^\| `([A-Z_]+)` \| (\S+) \|", SECTION, re.MULTILINE))


def shown(default: Any) -> str:
    """A default as an operator would write it."""
    if default == "":
        return "empty"
    return f"`{json.dumps(list(default)) if isinstance(default, tuple) else default}`"


def test_the_table_lists_every_setting_and_no_other() -> None:
    assert list(ROWS) == [name.upper() for name in ServiceSettings.model_fields]


@pytest.mark.parametrize("name", ServiceSettings.model_fields)
def test_a_row_states_the_default(name: str) -> None:
    assert ROWS[name.upper()] == shown(ServiceSettings.model_fields[name].default)
