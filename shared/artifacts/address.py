"""Where a step's files lie below an artifact root."""

from __future__ import annotations

import posixpath
import re
from dataclasses import dataclass

from shared.errors import DomainError

_SEGMENT = re.compile(r"^[A-Za-z0-9][A-Za-z0-9._+-]{0,119}$")


@dataclass(frozen=True)
class StepAddress:
    """Where a step's files lie below the root."""

    case: str
    cycle: str
    step: str
    key: str

    def __post_init__(self) -> None:
        for name in ("case", "cycle", "step", "key"):
            value = getattr(self, name)
            if not _SEGMENT.fullmatch(value):  # match would let a closing newline pass
                raise DomainError(
                    f"'{value}' cannot be the name of a {name}.",
                    field=name,
                    value=value,
                    accepted="letters, digits, '.', '_', '+' and '-', not starting with a sign",
                )

    @property
    def path(self) -> str:
        return posixpath.join(self.case, self.cycle, self.step, self.key)
