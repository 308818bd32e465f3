"""The cycle as a Prefect flow: Prefect orders, retries and logs; the artifact store alone says what is done."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from prefect import flow, task
from prefect.cache_policies import NO_CACHE
from prefect.client.orchestration import get_client
from prefect.client.schemas.filters import (
    FlowFilter,
    FlowFilterName,
    FlowRunFilter,
    FlowRunFilterState,
    FlowRunFilterStateType,
)
from prefect.client.schemas.objects import StateType
from prefect.states import Crashed

from flows.runner import DirectRunner, Runner
from shared.client import is_transient
from shared.errors import JobFailedError
from shared.process import Process

_RETRIES = 2
_UNFINISHED = [StateType.RUNNING, StateType.PENDING]
CYCLE = "cycle"


class PrefectRunner:
    """Runs each step of another runner as a Prefect task, named by its process."""

    def __init__(self, inner: Runner) -> None:
        self._inner = inner

    def service(self, service: str, process: str, inputs: Mapping[str, Any]) -> dict[str, Any]:
        return _as_task(process, lambda: self._inner.service(service, process, inputs))

    def local(self, process: Process, inputs: Mapping[str, Any]) -> dict[str, Any]:
        return _as_task(process.id, lambda: self._inner.local(process, inputs))


class PrefectConductor:
    """Runs each part of a case as one flow run, and its steps as tasks."""

    def close_stale_runs(self) -> int:
        return close_stale_runs()

    def run(self, name: str, runner: DirectRunner, work: Callable[[Runner], Any]) -> Any:
        part = flow(name=CYCLE, flow_run_name=name, persist_result=False, validate_parameters=False)
        return part(lambda: work(PrefectRunner(runner)))()


def _as_task(name: str, run: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    # Prefect's own cache stays off: what is done is told by the manifests, and by nothing else.
    step = task(
        name=name,
        task_run_name=name,
        cache_policy=NO_CACHE,
        persist_result=False,
        retries=_RETRIES,
        retry_delay_seconds=[1, 5],
        retry_condition_fn=_worth_retrying,
    )(run)
    return step()


def _worth_retrying(_: Any, __: Any, state: Any) -> bool:
    """Retry a lost worker or a restarted service, never an input that the service refused."""
    try:
        state.result()
    except JobFailedError as error:
        return int(error.problem.get("status", 500)) >= 500
    except Exception as error:
        return is_transient(error)
    return False


def close_stale_runs(flows: Sequence[str] = (CYCLE,)) -> int:
    """Mark as crashed every run of these flows that a killed predecessor left unfinished; how many there were.

    Only one loop works on an artifact root at a time (it holds the root's lock), so none of them can be alive. Runs
    that are merely scheduled are left alone.
    """
    states = FlowRunFilterState(type=FlowRunFilterStateType(any_=_UNFINISHED))
    named = FlowFilter(name=FlowFilterName(any_=list(flows)))
    with get_client(sync_client=True) as client:
        runs = client.read_flow_runs(flow_filter=named, flow_run_filter=FlowRunFilter(state=states))
        for run in runs:
            message = "The process of this run was killed; its finished steps are in the store."
            client.set_flow_run_state(run.id, Crashed(message=message), force=True)
    return len(runs)
