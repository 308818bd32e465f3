"""The two Prefect flows that run by themselves, and the process that serves them.

``prefect.yaml`` deploys the same flows to a work pool, for workers on any number of machines.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

from prefect import flow, serve
from prefect.client.schemas.objects import ConcurrencyLimitConfig, ConcurrencyLimitStrategy

from flows.clock import now_utc
from flows.cycle import close_stale_runs
from flows.root import named_root
from flows.serving.live import LiveSettings, rate_now, run_due_cycles
from shared.telemetry import configure_logging, logger
from shared.tracing import configure_tracing

DAILY, HOURLY = "daily-cycle", "hourly-ratings"
# A run that comes while another is at work has nothing to add: the next one catches up.
_ONE_AT_A_TIME = ConcurrencyLimitConfig(limit=1, collision_strategy=ConcurrencyLimitStrategy.CANCEL_NEW)


@flow(name=DAILY, persist_result=False, validate_parameters=True)
def daily_cycle(
    case: str,
    root: str,
    services: str = "",
    approve: bool = True,
    missed: str = "catch-up",
    cycle_hours: int = 24,
) -> str:
    """What is due of the daily cycles."""
    configure_logging("flow", "INFO")
    configure_tracing("flow")
    settings = LiveSettings(case, named_root(root), services, approve, _missed(missed), cycle_hours)
    said = run_due_cycles(settings, now_utc())
    logger().info("turn ended", flow=DAILY, said=said)
    return said


@flow(name=HOURLY, persist_result=False, validate_parameters=True)
def hourly_ratings(case: str, root: str, services: str = "") -> str:
    """The ratings of the hour."""
    configure_logging("flow", "INFO")
    configure_tracing("flow")
    said = rate_now(LiveSettings(case, named_root(root), services), now_utc())
    logger().info("turn ended", flow=HOURLY, said=said)
    return said


def _missed(value: str) -> Any:
    if value not in ("catch-up", "skip"):
        raise ValueError(f"missed is '{value}'; accepted: catch-up, skip")
    return value


def serve_for_ever(settings: LiveSettings, cutoff: datetime) -> None:
    """Serve both flows on their schedules until this process is ended; what a killed one left open is closed first.

    Ending it does not pause the schedules: the next one goes on with them.
    """
    closed = close_stale_runs((DAILY, HOURLY))
    logger().info("serving", case=settings.case, closed_stale_runs=closed)
    common = {"case": settings.case, "root": settings.root, "services": settings.services}
    chosen = {"approve": settings.approve, "missed": settings.missed, "cycle_hours": settings.cycle_hours}
    daily = daily_cycle.to_deployment(
        name="serve",
        cron=daily_cron(cutoff, settings.cycle_hours),
        parameters=common | chosen,
        concurrency_limit=_ONE_AT_A_TIME,
    )
    hourly = hourly_ratings.to_deployment(
        name="serve", cron="20 * * * *", parameters=common, concurrency_limit=_ONE_AT_A_TIME
    )
    serve(daily, hourly, pause_on_shutdown=False, limit=2)


def daily_cron(cutoff: datetime, cycle_hours: int) -> str:
    """Cron (UTC) of the cut-offs, five minutes after each: what was delivered just before them is there by then."""
    hours = sorted({(cutoff + timedelta(hours=step)).hour for step in range(0, 24, cycle_hours)})
    minute = cutoff + timedelta(minutes=5)
    return f"{minute.minute} {','.join(map(str, hours))} * * *"
