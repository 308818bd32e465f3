"""Children that end with their parent, so that a killed flow or service leaves no process and no port behind."""

from __future__ import annotations

import os
import threading
import time

_POLL_S = 0.25


def end_with_parent(parent_pid: int) -> None:
    """Watch the parent from a daemon thread and leave at once when it is gone.

    Polling the parent's id works on every POSIX system and, unlike Linux's death signal, does not depend on which of
    the parent's threads started the child.
    """

    def watch() -> None:
        while os.getppid() == parent_pid:
            time.sleep(_POLL_S)
        os._exit(1)

    if parent_pid:
        threading.Thread(target=watch, name="lifeline", daemon=True).start()
