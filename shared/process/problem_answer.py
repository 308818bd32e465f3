"""A problem document as an HTTP answer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastapi.responses import JSONResponse, Response

from shared.process.problem import MEDIA_TYPE


def problem_response(document: Mapping[str, Any]) -> Response:
    """The answer, with the headers of its status (401: how to authenticate; 429, 503: when to come again)."""
    headers = {}
    if document["status"] == 401:
        headers["WWW-Authenticate"] = 'Bearer realm="smokeglint"'
    if document["status"] in (429, 503):
        headers["Retry-After"] = str(document.get("retry_after_s", 5 if document["status"] == 429 else 1))
    return JSONResponse(dict(document), status_code=document["status"], media_type=MEDIA_TYPE, headers=headers)
