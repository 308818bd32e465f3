"""What all tests share: where the real data lie, and what a skipped test means."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# Before numpy and torch are imported: tests run in parallel, so a test must not take every core for itself.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("MPLBACKEND", "Agg")


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real data; tests that use it are skipped where SMOKEGLINT_DATA is not set."""
    folder = os.environ.get("SMOKEGLINT_DATA", "")
    if not folder:
        pytest.skip("SMOKEGLINT_DATA is not set: no real data here")
    return Path(folder)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]):  # type: ignore[no-untyped-def]
    """With SMOKEGLINT_STRICT=1 a skipped test fails: there, everything that tests need is present."""
    outcome = yield
    report = outcome.get_result()
    if report.skipped and not hasattr(report, "wasxfail") and os.environ.get("SMOKEGLINT_STRICT") == "1":
        report.outcome = "failed"
        report.longrepr = f"{item.nodeid} was skipped, and SMOKEGLINT_STRICT is set: {report.longrepr}"
