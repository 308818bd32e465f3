"""JSON Web Tokens of an OpenID Connect issuer: signature, issuer, audience and times checked, scopes read."""

from __future__ import annotations

from typing import Any

import httpx
import jwt

from shared.security.principal import SCOPES, Principal
from shared.telemetry import logger

_ALGORITHMS = ("RS256", "RS384", "RS512", "ES256", "ES384", "PS256", "EdDSA")  # never a shared secret, never "none"
_LEEWAY_S = 30
_TIMEOUT_S = 5


class TokenVerifier:
    """Verifies tokens of one issuer for one audience.

    The issuer's keys are found through its discovery document and kept; an unknown key id asks for them again, so the
    issuer may rotate them. Scopes are those of the claim ``scope`` that are ours: ``smokeglint:read`` or ``read``.
    """

    def __init__(self, issuer: str, audience: str, keys: jwt.PyJWKClient | None = None) -> None:
        self._issuer = issuer.rstrip("/")
        self._audience = audience
        self._keys = keys

    def holder(self, token: str) -> Principal | None:
        """Whom the token speaks of; None if it is not valid here or the issuer cannot be asked."""
        try:
            claims: dict[str, Any] = jwt.decode(
                token,
                self._signing_keys().get_signing_key_from_jwt(token).key,
                algorithms=list(_ALGORITHMS),
                issuer=[self._issuer, self._issuer + "/"],
                audience=self._audience,
                leeway=_LEEWAY_S,
                options={"require": ["exp", "iss", "aud", "sub"]},
            )
        except (httpx.HTTPError, OSError, KeyError, TypeError) as error:
            logger().error("the token issuer cannot be asked", issuer=self._issuer, error=str(error))
            return None
        except (jwt.PyJWTError, ValueError):
            return None
        granted = claims.get("scope", "")
        named = granted.split() if isinstance(granted, str) else [str(item) for item in granted]
        scopes = frozenset(item.removeprefix("smokeglint:") for item in named) & frozenset(SCOPES)
        return Principal(str(claims["sub"]), scopes)

    def _signing_keys(self) -> jwt.PyJWKClient:
        if self._keys is None:
            answer = httpx.get(f"{self._issuer}/.well-known/openid-configuration", timeout=_TIMEOUT_S)
            self._keys = jwt.PyJWKClient(answer.raise_for_status().json()["jwks_uri"], timeout=_TIMEOUT_S)
        return self._keys


def looks_like_token(presented: str) -> bool:
    """Whether a credential is a JSON Web Token rather than an API key: three parts with dots between."""
    return presented.count(".") == 2
