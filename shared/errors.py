"""Domain errors: what was wrong, where, and what would be right. They know no HTTP."""

from __future__ import annotations

from typing import Any


class SmokeglintError(Exception):
    """Base of every error that this product raises on purpose."""


class DomainError(SmokeglintError):
    """An input that cannot be used: names the field, the offending value and what is accepted.

    ``field`` is the input or column at fault, ``value`` what stood there, ``accepted`` what would be right.
    """

    def __init__(self, message: str, *, field: str = "", value: Any = None, accepted: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.field = field
        self.value = value
        self.accepted = accepted

    def details(self) -> dict[str, str]:
        """The parts of the error as short texts, empty parts left out."""
        parts = {"field": self.field, "accepted": self.accepted}
        if self.value is not None:
            parts["value"] = str(self.value)[:200]
        return {name: text for name, text in parts.items() if text}


class ContractError(DomainError):
    """A table, grid or document that breaks its contract."""


class ForbiddenReferenceError(DomainError):
    """A reference that leads outside the configured roots."""


class MissingArtifactError(DomainError):
    """A reference to something that is not there."""


class TamperedArtifactError(DomainError):
    """A file whose content is not what its reference or manifest says."""


class NotFoundError(SmokeglintError):
    """No such process, job or result. ``kind`` is ``process``, ``job`` or ``result``."""

    def __init__(self, kind: str, identifier: str, message: str = "") -> None:
        super().__init__(message or f"There is no {kind} '{identifier}' here.")
        self.kind = kind
        self.identifier = identifier


class ConflictError(SmokeglintError):
    """The request contradicts an earlier one, e.g. an idempotency key used for another body."""


class NotAllowedError(SmokeglintError):
    """Somebody known asks for what is not his."""


class TooManyJobsError(SmokeglintError):
    """Somebody has as many jobs waiting or running as he may."""


class UnavailableError(SmokeglintError):
    """Something that we stand on cannot be reached just now (the job register); trying again helps."""


class JobFailedError(SmokeglintError):
    """A job that ended without a result; ``problem`` is its problem document."""

    def __init__(self, message: str, problem: dict[str, Any] | None = None) -> None:
        super().__init__(message)
        self.problem = problem or {}
