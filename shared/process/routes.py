"""The paths of OGC API – Processes, Part 1, over a Service."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

import anyio
import anyio.to_thread
from fastapi import APIRouter, Query, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import JSONResponse, Response

from shared.errors import NotAllowedError
from shared.process import description
from shared.process.jobs import JobStatus
from shared.process.problem import problem
from shared.process.problem_answer import problem_response
from shared.process.service import Answer, ExecuteRequest, Service
from shared.security.principal import Principal
from shared.telemetry import correlation_id

router = APIRouter()
Answered = TypeVar("Answered")


def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


def _principal(request: Request) -> Principal:
    principal: Principal = request.state.principal
    return principal


async def _read(service: Service, question: Callable[[Service], Answered]) -> Answered:
    """Ask the register or the store: here, if they lie on this machine and never wait for a writer, else in a thread.

    A local answer takes less time than a thread, and threads starve while the event loop is busy with other clients
    (50 clients: 95 % within 65 ms instead of 133 ms); a database or store elsewhere may keep us waiting, and so may a
    SQLite file without a write-ahead log.
    """
    return question(service) if service.answers_at_once else await run_in_threadpool(question, service)


def _base(request: Request) -> str:
    return str(request.base_url).rstrip("/")


@router.get("/", summary="Landing page")
async def landing(request: Request) -> dict[str, Any]:
    base = _base(request)
    pages = {
        "/": ("self", "this page"),
        "/api": ("service-desc", "the API as OpenAPI"),
        "/conformance": ("http://www.opengis.net/def/rel/ogc/1.0/conformance", "conformance classes"),
        "/processes": ("http://www.opengis.net/def/rel/ogc/1.0/processes", "processes"),
        "/jobs": ("http://www.opengis.net/def/rel/ogc/1.0/job-list", "jobs"),
    }
    links = [
        {"href": base + path, "rel": relation, "type": "application/json", "title": title}
        for path, (relation, title) in pages.items()
    ]
    return {"title": request.app.title, "description": request.app.description, "links": links}


@router.get("/conformance", summary="Conformance classes")
async def conformance() -> dict[str, Any]:
    return {"conformsTo": description.CONFORMANCE}


@router.get("/processes", summary="Processes offered", response_model=dict[str, Any])
async def processes(request: Request) -> Response:
    base = _base(request)
    listed = [description.summary(process, base) for process in _service(request).processes.values()]
    link = {"href": f"{base}/processes", "rel": "self", "type": "application/json", "title": "this list"}
    return JSONResponse({"processes": listed, "links": [link]})


@router.get("/processes/{process_id}", summary="One process: its inputs and outputs", response_model=dict[str, Any])
async def process(request: Request, process_id: str) -> Response:
    return JSONResponse(description.description(_service(request).process(process_id), _base(request)))


@router.post(
    "/processes/{process_id}/execution",
    summary="Execute a process",
    openapi_extra={"requestBody": {"content": {"application/json": {"schema": ExecuteRequest.model_json_schema()}}}},
)
async def execute(request: Request, process_id: str) -> Response:
    service = _service(request)
    service.process(process_id)
    body = await _body(request, service.settings.max_body_bytes)
    if isinstance(body, Response):
        return body
    key = request.headers.get("Idempotency-Key")
    owner = _principal(request).name
    answer = await run_in_threadpool(service.execute, process_id, body, key, correlation_id.get(), owner)
    if "respond-async" in request.headers.get("Prefer", ""):
        return _accepted(request, answer)
    # Those who wait get threads of their own: they must not keep others from asking, or from dismissing a job.
    return JSONResponse(await anyio.to_thread.run_sync(service.wait, answer, limiter=service.waiting))


def _accepted(request: Request, answer: Answer) -> Response:
    location = f"{_base(request)}/jobs/{answer.job.id}"
    headers = {"Location": location, "Preference-Applied": "respond-async"}
    return JSONResponse(_status(answer.job, _base(request)), status_code=201, headers=headers)


async def _body(request: Request, limit: int) -> bytes | Response:
    """The request's body, or the problem with it: too large, or no JSON object."""
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > limit:
            detail = f"The body is larger than {limit} bytes; pass large inputs by reference."
            return problem_response(problem(413, "about:blank", "The request is too large", detail))
    try:
        parsed = json.loads(body or b"{}")
    except ValueError as error:
        return problem_response(problem(400, "about:blank", "The request is not JSON", str(error), field="body"))
    if not isinstance(parsed, dict):
        detail = "The body must be a JSON object with the member 'inputs'."
        return problem_response(problem(400, "about:blank", "The request is not an object", detail, field="body"))
    return body or b"{}"


@router.get("/jobs", summary="Jobs, newest first", response_model=dict[str, Any])
async def jobs(
    request: Request,
    limit: Annotated[int, Query(ge=1, le=1000, description="most jobs in one answer")] = 50,
    offset: Annotated[int, Query(ge=0, le=2**31, description="leave out so many of the newest")] = 0,
) -> Response:
    base = _base(request)
    found = await _read(_service(request), lambda service: service.jobs.all(limit, offset))
    links = [_job_page(base, limit, offset, "self", "this list")]
    if len(found) == limit:
        links.append(_job_page(base, limit, offset + limit, "next", "older jobs"))
    return JSONResponse({"jobs": [_status(job, base) for job in found], "links": links})


def _job_page(base: str, limit: int, offset: int, relation: str, title: str) -> dict[str, str]:
    query = f"?limit={limit}&offset={offset}" if relation == "next" or offset else ""
    return {"href": f"{base}/jobs{query}", "rel": relation, "type": "application/json", "title": title}


@router.get("/jobs/{job_id}", summary="The state of a job", response_model=dict[str, Any])
async def job_status(request: Request, job_id: str) -> Response:
    job = await _read(_service(request), lambda service: service.jobs.status(job_id))
    return JSONResponse(_status(job, _base(request)))


@router.get("/jobs/{job_id}/results", summary="The outputs of a job", response_model=dict[str, Any])
async def job_results(request: Request, job_id: str) -> Response:
    return JSONResponse(await _read(_service(request), lambda service: service.results(service.jobs.get(job_id))))


@router.delete("/jobs/{job_id}", summary="Dismiss a job")
def dismiss(request: Request, job_id: str) -> dict[str, Any]:
    service = _service(request)
    job, principal = service.jobs.get(job_id), _principal(request)
    if job.owner != principal.name and not principal.may("admin"):
        raise NotAllowedError(f"Job {job_id} belongs to '{job.owner}'; dismissing it needs the scope 'admin'.")
    if not job.ended:
        service.pool.dismiss(job_id)
    return _status(service.jobs.get(job_id), _base(request))


@router.get("/healthz", summary="Whether the service is alive", tags=["operations"])
async def healthz() -> dict[str, str]:
    return {"status": "alive"}


@router.get(
    "/readyz", summary="Whether the service can work: a warm worker, the store, the job register", tags=["operations"]
)
async def readyz(request: Request) -> Response:
    checks = await _read(_service(request), Service.checks)
    return JSONResponse({"ready": all(checks.values()), **checks}, status_code=200 if all(checks.values()) else 503)


@router.get("/metrics", summary="Prometheus metrics", tags=["operations"])
async def metrics(request: Request) -> Response:
    return Response(_service(request).metrics.page(), media_type="text/plain; version=0.0.4")


def _status(job: JobStatus, base: str) -> dict[str, Any]:
    links = [{"href": f"{base}/jobs/{job.id}", "rel": "self", "type": "application/json"}]
    if job.status == "successful":
        relation = "http://www.opengis.net/def/rel/ogc/1.0/results"
        links.append({"href": f"{base}/jobs/{job.id}/results", "rel": relation, "type": "application/json"})
    status = {
        "jobID": job.id,
        "processID": job.process,
        "type": "process",
        "status": job.status,
        "progress": round(job.progress),
        "message": job.message,
        "created": job.created,
        "updated": job.updated,
        "links": links,
    }
    return status | ({"problem": job.problem} if job.problem else {})
