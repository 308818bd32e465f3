"""The gate before a service: who asks, whether he may, and nobody from elsewhere while no keys are set."""

from __future__ import annotations

import ipaddress

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from shared.process.problem import problem
from shared.process.problem_answer import problem_response
from shared.security.api_keys import KeyRing
from shared.security.bearer import TokenVerifier, looks_like_token
from shared.security.principal import Principal, needed_scope
from shared.settings import ServiceSettings

LOCAL = Principal("loopback", frozenset({"admin"}))


class Authenticator:
    """Credentials of this service: API keys, tokens of an issuer, both or (on loopback only) neither."""

    def __init__(self, settings: ServiceSettings) -> None:
        self._keys = KeyRing(settings.api_keys) if settings.api_keys else None
        self._tokens = TokenVerifier(settings.oidc_issuer, settings.oidc_audience) if settings.oidc_issuer else None

    @property
    def configured(self) -> bool:
        return self._keys is not None or self._tokens is not None

    def holder(self, presented: str) -> Principal | None:
        """Who presents this credential; None if it is not valid here."""
        if looks_like_token(presented):
            return self._tokens.holder(presented) if self._tokens else None
        return self._keys.holder(presented) if self._keys else None


class GateMiddleware:
    """Answers 401 to who is not known, 403 to who may not, and hands the Principal on in the request's state."""

    def __init__(self, app: ASGIApp, authenticator: Authenticator) -> None:
        self._app = app
        self._authenticator = authenticator

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        found = await self._admit(scope)
        if isinstance(found, Principal):
            scope.setdefault("state", {})["principal"] = found
            await self._app(scope, receive, send)
        else:
            await problem_response(found)(scope, receive, send)

    async def _admit(self, scope: Scope) -> Principal | dict[str, object]:
        needed = needed_scope(scope["method"], scope["path"])
        if needed is None:
            return Principal("anybody", frozenset())
        if not self._authenticator.configured:
            return LOCAL if is_loopback(scope.get("client")) else _closed()
        presented = credential(Headers(scope=scope))
        principal = await self._holder(presented) if presented else None
        if principal is None:
            return _unknown(bool(presented))
        return principal if principal.may(needed) else _not_allowed(principal, needed)

    async def _holder(self, presented: str) -> Principal | None:
        """Who presents this. A key is looked up at once; for a token, its issuer may have to be asked."""
        if looks_like_token(presented):
            return await run_in_threadpool(self._authenticator.holder, presented)
        return self._authenticator.holder(presented)


def credential(headers: Headers) -> str:
    """The key or token of a request: ``Authorization: Bearer …`` or ``X-API-Key: …``; empty if there is none."""
    scheme, _, value = headers.get("Authorization", "").partition(" ")
    return value.strip() if scheme.lower() == "bearer" else headers.get("X-API-Key", "").strip()


def is_loopback(client: tuple[str, int] | None) -> bool:
    """Whether a request comes from this machine (a Unix socket has no client address, a test client no IP address)."""
    if client is None or client[0] in ("", "testclient"):
        return True
    try:
        return ipaddress.ip_address(client[0]).is_loopback
    except ValueError:
        return client[0] == "localhost"


def _unknown(presented: bool) -> dict[str, object]:
    what = "The credential is not known here or has expired." if presented else "No credential was given."
    return problem(401, "about:blank", "Who are you?", f"{what} Send 'Authorization: Bearer KEY' or 'X-API-Key: KEY'.")


def _not_allowed(principal: Principal, needed: str) -> dict[str, object]:
    held = ", ".join(sorted(principal.scopes)) or "none"
    detail = f"'{principal.name}' holds the scopes: {held}; this needs '{needed}'."
    return problem(403, "about:blank", "Not allowed", detail)


def _closed() -> dict[str, object]:
    detail = "This service has no authentication set up and answers its own machine only; see docs/operations.md."
    return problem(403, "about:blank", "Closed beyond loopback", detail)
