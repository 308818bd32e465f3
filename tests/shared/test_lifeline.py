"""Children that end with their parent, however it ends."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from shared.lifeline import end_with_parent

REPOSITORY = Path(__file__).parents[2]

# The child says its id when its lifeline is on, then sleeps far longer than the test waits.
CHILD = """
import os, sys, time
from shared.lifeline import end_with_parent
end_with_parent({watched})
print(os.getpid(), flush=True)
time.sleep(30)
"""
PARENT = """
import os, subprocess, sys, time
code = sys.argv[1].replace("PARENT", str(os.getpid()))
subprocess.Popen([sys.executable, "-c", code])
time.sleep(30)
"""


@contextmanager
def family(watched: str) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """A parent and the id of its child. Both hold the pipe ``parent.stdout``, which ends when both have gone."""
    code = CHILD.format(watched=watched)
    parent = subprocess.Popen([sys.executable, "-c", PARENT, code], stdout=subprocess.PIPE, cwd=REPOSITORY)
    assert parent.stdout is not None
    child = 0
    try:
        child = int(parent.stdout.readline())
        yield parent, child
    finally:
        parent.kill()
        parent.wait()
        if child and not pipe_ends(parent, 0):
            os.kill(child, signal.SIGKILL)  # it still holds the pipe, so the id is still its own
        parent.stdout.close()


def pipe_ends(parent: subprocess.Popen[bytes], limit_s: float) -> bool:
    """Whether the last holder of the pipe goes within the limit. A zombie that nobody reaps holds no pipe."""
    assert parent.stdout is not None
    ready, _, _ = select.select([parent.stdout], [], [], limit_s)
    return bool(ready) and parent.stdout.read() == b""


@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGTERM])
def test_a_child_ends_within_three_seconds_of_its_parent(ending: signal.Signals) -> None:
    with family("PARENT") as (parent, _):
        assert not pipe_ends(parent, 0.6), "both run on while the parent lives"
        began = time.monotonic()
        parent.send_signal(ending)
        parent.wait()
        assert pipe_ends(parent, 3.0)
        assert time.monotonic() - began < 3.0


def test_a_child_without_a_lifeline_outlives_its_parent() -> None:
    """The control: it is the lifeline, and not the pipe or the shell, that ends the child above."""
    with family("0") as (parent, child):
        parent.kill()
        parent.wait()
        assert not pipe_ends(parent, 1.0)
        os.kill(child, 0)


def test_a_parent_gone_before_the_lifeline_is_noticed() -> None:
    code = CHILD.format(watched=2**30)  # never the id of its parent
    began = time.monotonic()
    ended = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, timeout=20)
    assert ended.returncode == 1
    assert time.monotonic() - began < 10


def test_zero_is_no_parent() -> None:
    import threading

    before = threading.active_count()
    end_with_parent(0)
    assert threading.active_count() == before
