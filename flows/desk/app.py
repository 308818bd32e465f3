"""The desk over HTTP: pages for people, plans and decisions for programs. ``uvicorn flows.desk.app:app``.

It reads what the loop made under the artifact root and adds decisions; it starts nothing. Reading needs the scope
``read``, deciding ``execute``; without keys it answers its own machine only, like every service.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Annotated, Any, Literal

import pandas as pd
from fastapi import Depends, FastAPI, Request
from fastapi.responses import FileResponse, HTMLResponse, Response
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from pydantic import BaseModel, ConfigDict, Field

from flows.desk.briefing import briefing
from flows.desk.decisions import Decision, DecisionLog, keep
from flows.desk.standing import case_folder, newest_steps, plan_standings, undecided_plan
from flows.root import exists, fetched, named_root, store_of
from shared.artifacts.reference import ArtifactRef, media_type
from shared.errors import DomainError, NotFoundError
from shared.process.app import CorrelationMiddleware, add_error_answers
from shared.security.exposure import refuse_exposure
from shared.security.gate import Authenticator, GateMiddleware
from shared.security.principal import Principal
from shared.settings import ServiceSettings, service_settings
from shared.telemetry import configure_logging
from shared.versions import RELEASE

_PAGES = Environment(
    loader=FileSystemLoader(Path(__file__).parent / "templates"), autoescape=True, undefined=StrictUndefined
)


def _utc(moment: str) -> str:
    """A moment as people read it: 2025-09-02 13:03 UTC."""
    return f"{pd.Timestamp(moment).tz_convert('UTC'):%Y-%m-%d %H:%M} UTC" if moment else ""


_PAGES.filters["utc"] = _utc


class DecisionBody(BaseModel):
    """A decision as it is sent. ``who`` counts only where nobody is authenticated, on this very machine."""

    model_config = ConfigDict(extra="forbid")
    action: Literal["approve", "reject", "add", "pin", "exclude", "reweight", "release"]
    why: str
    cycle: str = Field(description="cut-off of the first cycle it holds for, e.g. 20250902T1200Z")
    until: str | None = None
    who: str = ""
    target_id: int | str | None = Field(None, description="as text where a program cannot hold 64-bit integers")
    priority: float | None = None
    kind: Literal["active", "prefire"] | None = None
    longitude_deg: float | None = None
    latitude_deg: float | None = None


def create_desk(settings: ServiceSettings | None = None) -> FastAPI:
    """The application over the artifact root of ``settings`` (``SMOKEGLINT_DESK_…``)."""
    chosen = settings or service_settings("desk")
    authenticator = Authenticator(chosen)

    @contextlib.asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        configure_logging("desk", chosen.log_level)
        watch = None if authenticator.configured else asyncio.create_task(refuse_exposure())
        yield
        if watch:
            watch.cancel()

    app = FastAPI(title="Smokeglint desk", version=RELEASE, lifespan=lifespan, openapi_url="/api", docs_url=None)
    app.state.root = named_root(chosen.artifact_root)
    app.add_middleware(GateMiddleware, authenticator=authenticator)
    app.add_middleware(CorrelationMiddleware)
    add_error_answers(app)
    _add_pages(app)
    _add_documents(app)
    return app


def _root(request: Request) -> str:
    root: str = request.app.state.root
    return root


def _case(request: Request, case: str) -> str:
    try:
        return case_folder(_root(request), case)
    except DomainError as error:
        raise NotFoundError("page", case, str(error)) from error


RootFolder = Annotated[str, Depends(_root)]
CaseFolder = Annotated[str, Depends(_case)]


def _page(template: str, request: Request, **values: Any) -> HTMLResponse:
    base = str(request.base_url).rstrip("/")
    return HTMLResponse(_PAGES.get_template(template).render(base=base, **values))


def _add_pages(app: FastAPI) -> None:
    @app.get("/", summary="Cases and their cycles", response_class=HTMLResponse)
    def cases(request: Request, root: RootFolder) -> Response:
        listed = []
        for case in _cases(root):
            standings = {plan.cycle: plan for plan in plan_standings(root, case, DecisionLog(root, case).all())}
            cycles = sorted(newest_steps(root, case), reverse=True)
            listed.append((case, [(cycle, standings.get(cycle)) for cycle in cycles]))
        return _page("cases.html", request, cases=listed)

    @app.get("/cases/{case}/cycles/{cycle}", summary="A cycle on one page", response_class=HTMLResponse)
    def cycle_page(request: Request, root: RootFolder, case: CaseFolder, cycle: str) -> Response:
        try:
            facts = briefing(root, case, cycle)
        except DomainError as error:
            raise NotFoundError("page", cycle, str(error)) from error
        return _page("cycle.html", request, facts=facts)

    @app.get("/files/{path:path}", summary="A file of a finished step")
    def file(root: RootFolder, path: str) -> Response:
        if any(part.startswith(".") for part in path.split("/")):
            raise NotFoundError("page", path)  # decisions, databases and keys are nobody's to fetch
        try:
            found = fetched(store_of(root), ArtifactRef(href=path))
        except DomainError as error:
            raise NotFoundError("page", path) from error
        return FileResponse(found, media_type=media_type(found.name))

    @app.get("/healthz", summary="Whether the desk is alive")
    async def healthz() -> dict[str, str]:
        return {"status": "alive"}


def _add_documents(app: FastAPI) -> None:
    @app.get("/cases/{case}/plans", summary="Where each plan stands, who decided, and when")
    def plans(root: RootFolder, case: CaseFolder) -> list[dict[str, Any]]:
        standings = plan_standings(root, case, DecisionLog(root, case).all())
        return [
            {
                "cycle": plan.cycle,
                "schedule_sha256": plan.schedule_sha256,
                "state": plan.state,
                "history": [{"state": state, "who": who, "at": at} for state, who, at in plan.history],
            }
            for plan in standings
        ]

    @app.get("/cases/{case}/decisions", summary="Every decision, oldest first")
    def decisions(root: RootFolder, case: CaseFolder) -> list[Decision]:
        return DecisionLog(root, case).all()

    @app.post("/cases/{case}/decisions", summary="Decide", status_code=201)
    def decide(request: Request, root: RootFolder, case: CaseFolder, body: DecisionBody) -> Decision:
        principal: Principal = request.state.principal
        who = (body.who if principal.name == "loopback" else principal.name) or "loopback"
        decided = body.model_dump(exclude_none=True) | {"who": who}
        if body.action in ("approve", "reject"):
            decided["schedule_sha256"] = undecided_plan(root, case, body.cycle).schedule_sha256
        return keep(root, case, **decided)


def _cases(root: str) -> list[str]:
    return [case for case in store_of(root).cases() if newest_steps(root, case)] if exists(root) else []


app = create_desk()
