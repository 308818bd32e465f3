"""The FastAPI application of a service, from its name and its list of processes."""

from __future__ import annotations

import asyncio
import contextlib
import traceback
from collections.abc import AsyncIterator

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from shared.errors import SmokeglintError
from shared.lifeline import end_with_parent
from shared.process.declaration import Process
from shared.process.problem import problem, problem_of, validation_errors
from shared.process.problem_answer import problem_response
from shared.process.routes import router
from shared.process.service import Service
from shared.security.exposure import refuse_exposure
from shared.security.gate import Authenticator, GateMiddleware
from shared.settings import ServiceSettings, service_settings
from shared.telemetry import CORRELATION_HEADER, accept_correlation_id, configure_logging, correlation_id, logger
from shared.tracing import configure_tracing, mark_request
from shared.versions import RELEASE


class CorrelationMiddleware:
    """Takes the correlation id of a request (or makes one), binds it to the log and sends it back."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        identifier = accept_correlation_id(Headers(scope=scope).get(CORRELATION_HEADER))
        correlation_id.set(identifier)
        mark_request()

        async def send_with_id(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message)[CORRELATION_HEADER] = identifier
            await send(message)

        await self._app(scope, receive, send_with_id)


def create_app(
    name: str, title: str, processes: list[Process], *, module: str = "", settings: ServiceSettings | None = None
) -> FastAPI:
    """An OGC API – Processes service. ``module`` holds ``PROCESSES``; ``services.<name>.processes`` by default."""
    chosen = settings or service_settings(name)
    authenticator = Authenticator(chosen)

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        configure_logging(name, chosen.log_level)
        configure_tracing(name)
        end_with_parent(chosen.parent_pid)
        service = Service(name, processes, module or f"services.{name}.processes", chosen)
        service.start()
        app.state.service = service
        watch = None if authenticator.configured else asyncio.create_task(refuse_exposure())
        try:
            yield
        finally:
            if watch:
                watch.cancel()
            service.stop()

    description = "Part of Smokeglint: " + "; ".join(process.title for process in processes) + "."
    app = FastAPI(
        title=title,
        description=description,
        version=RELEASE,
        lifespan=lifespan,
        openapi_url="/api",
        docs_url=None,
        redoc_url=None,
    )
    app.include_router(router)
    app.add_middleware(GateMiddleware, authenticator=authenticator)
    app.add_middleware(CorrelationMiddleware)  # added last, met first: a refusal bears its correlation id, too
    add_error_answers(app)
    return app


def add_error_answers(app: FastAPI) -> None:
    """Let every error of an application be answered by its problem document."""

    async def known(_: Request, error: Exception) -> Response:
        return problem_response(problem_of(error))

    async def unknown(request: Request, error: Exception) -> Response:
        trace = "".join(traceback.format_exception(error))
        logger().error("request failed", path=request.url.path, trace=trace)
        return problem_response(problem_of(error))

    async def misfit(_: Request, error: Exception) -> Response:
        assert isinstance(error, RequestValidationError)
        found = validation_errors(error.errors())
        detail = "; ".join(item["detail"] for item in found)
        return problem_response(problem(422, "about:blank", "The request does not fit", detail, errors=found))

    async def http(_: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        return problem_response(problem(error.status_code, "about:blank", str(error.detail), str(error.detail)))

    for kind in (SmokeglintError, ValidationError):
        app.add_exception_handler(kind, known)
    app.add_exception_handler(RequestValidationError, misfit)
    app.add_exception_handler(HTTPException, http)
    app.add_exception_handler(Exception, unknown)
