"""Who asks, and what for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Scope = Literal["read", "execute", "admin"]
SCOPES: tuple[Scope, ...] = get_args(Scope)


@dataclass(frozen=True)
class Principal:
    """Somebody known by name. Each scope holds those before it: read, execute, admin."""

    name: str
    scopes: frozenset[str]

    def may(self, scope: Scope) -> bool:
        return any(held in self.scopes for held in SCOPES[SCOPES.index(scope) :])


def needed_scope(method: str, path: str) -> Scope | None:
    """The scope that a request needs; None: open to everybody (probes of a container's health)."""
    if path in ("/healthz", "/readyz"):
        return None
    return "read" if method in ("GET", "HEAD", "OPTIONS") else "execute"
