"""Errors as RFC 9457 problem documents with the exception types of OGC API – Processes. One table maps them."""

from __future__ import annotations

import errno
from collections.abc import Sequence
from typing import Any

from pydantic import ValidationError

from shared import errors

MEDIA_TYPE = "application/problem+json"
_OGC = "http://www.opengis.net/def/exceptions/ogcapi-processes-1/1.0/"

# exception: (status, type, title); the first match along the exception's ancestry holds.
STATUS: dict[type[BaseException], tuple[int, str, str]] = {
    errors.DomainError: (422, "about:blank", "The input cannot be used"),
    errors.ForbiddenReferenceError: (422, "about:blank", "The reference is not allowed"),
    errors.MissingArtifactError: (422, "about:blank", "The referenced file does not exist"),
    errors.TamperedArtifactError: (422, "about:blank", "The referenced file has changed"),
    errors.ConflictError: (409, "about:blank", "The request contradicts an earlier one"),
    errors.NotAllowedError: (403, "about:blank", "Not allowed"),
    errors.TooManyJobsError: (429, "about:blank", "Too many jobs at once"),
    errors.UnavailableError: (503, "about:blank", "Not available just now"),
    ValidationError: (422, "about:blank", "The request does not fit the process description"),
}
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NOT_FOUND = {
    "process": (404, _OGC + "no-such-process", "No such process"),
    "job": (404, _OGC + "no-such-job", "No such job"),
    "result": (404, _OGC + "result-not-ready", "The result is not ready"),
    "page": (404, "about:blank", "No such page"),
}


def problem(status: int, kind: str, title: str, detail: str, **extra: Any) -> dict[str, Any]:
    """A problem document; empty members are left out."""
    document = {"type": kind, "title": title, "status": status, "detail": detail, **extra}
    return {name: value for name, value in document.items() if value not in (None, "", [])}


def problem_of(error: BaseException) -> dict[str, Any]:
    """The problem document of an exception. What is not on the table is a fault of ours: 500, without its text."""
    if isinstance(error, errors.NotFoundError):
        status, kind, title = _NOT_FOUND[error.kind]
        return problem(status, kind, title, str(error))
    if isinstance(error, errors.JobFailedError) and error.problem:
        return error.problem
    for ancestor in type(error).__mro__:
        if ancestor in STATUS:
            status, kind, title = STATUS[ancestor]
            return _mapped(status, kind, title, error)
    if isinstance(error, OSError) and error.errno in _NO_ROOM:
        detail = "The disk of the artifacts is full; nothing of this job remains. Make room and submit it again."
        return problem(507, "about:blank", "No room for the products", detail)
    detail = "The fault is logged under the correlation id of this request."
    return problem(500, "about:blank", "The service failed", detail)


def _mapped(status: int, kind: str, title: str, error: BaseException) -> dict[str, Any]:
    if isinstance(error, ValidationError):
        found = validation_errors(error.errors(include_url=False))
        return problem(status, kind, title, "; ".join(item["detail"] for item in found), errors=found)
    extra = error.details() if isinstance(error, errors.DomainError) else {}
    return problem(status, kind, title, str(error), **extra)


def validation_errors(found: Sequence[Any]) -> list[dict[str, str]]:
    """Pydantic's findings as ``field``, ``detail`` and ``value``."""
    listed = []
    for item in found:
        field = ".".join(str(part) for part in item["loc"]) or "inputs"
        entry = {"field": field, "detail": f"{field}: {item['msg']}"}
        if item["type"] != "missing":
            entry["value"] = repr(item.get("input"))[:200]
        listed.append(entry)
    return listed
