"""A service without authentication does not listen beyond this machine."""

from __future__ import annotations

import asyncio
import os
import signal

import psutil

from shared.security.gate import is_loopback
from shared.telemetry import logger

_LOOKS = 40
_PAUSE_S = 0.25


def open_addresses() -> list[str]:
    """The addresses beyond loopback that this process listens on."""
    listening = [c for c in psutil.Process().net_connections("inet") if c.status == psutil.CONN_LISTEN]
    return sorted({f"{c.laddr.ip}:{c.laddr.port}" for c in listening if not is_loopback((c.laddr.ip, c.laddr.port))})


async def refuse_exposure() -> None:
    """Watch the first seconds after the start, when the sockets appear, and end this process if one is open to others.

    A service cannot know its sockets before they are bound; until it is ended here, the gate refuses every request that
    comes from elsewhere.
    """
    for _ in range(_LOOKS):
        if found := open_addresses():
            logger().critical(
                "refusing to listen beyond loopback without authentication", addresses=found, see="docs/operations.md"
            )
            os.kill(os.getpid(), signal.SIGTERM)
            return
        await asyncio.sleep(_PAUSE_S)
