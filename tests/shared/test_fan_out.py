"""One function over many tasks: the same results however it is spread, and what a killed worker costs."""

import numpy as np
import pytest

from shared.errors import SmokeglintError
from shared.fan_out import VARIABLE, fan_out, fan_out_in_turn
from tests.shared.fan_out_tasks import die, die_once, noise, refuse

TASKS = [(seed, 1000) for seed in range(9)]


@pytest.fixture(scope="module")
def cluster():
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, processes=True, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.parametrize("kind", ["processes:1", "processes:3", "dask"])
def test_results_are_the_same_bit_for_bit_and_in_order(monkeypatch, request, kind):
    expected = [noise(*task) for task in TASKS]
    monkeypatch.setenv(VARIABLE, "dask:" + request.getfixturevalue("cluster") if kind == "dask" else kind)
    spread = fan_out(noise, TASKS)
    assert len(spread) == len(TASKS)
    assert all(np.array_equal(a, b) for a, b in zip(spread, expected, strict=True))


@pytest.mark.parametrize("kind", ["processes:2", "dask"])
def test_a_killed_worker_costs_a_retry_only(monkeypatch, request, tmp_path, kind):
    monkeypatch.setenv(VARIABLE, "dask:" + request.getfixturevalue("cluster") if kind == "dask" else kind)
    mark = str(tmp_path / "killed")
    assert fan_out(die_once, [(index, mark) for index in range(6)]) == list(range(6))
    assert (tmp_path / "killed").exists()


def test_a_cluster_without_workers_is_not_waited_for(monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("shared.fan_out._LOOK_S", 0.1)
    monkeypatch.setattr("shared.fan_out._LONELY_S", 0.3)
    with distributed.LocalCluster(n_workers=0, dashboard_address=None, processes=False, silence_logs=50) as empty:
        monkeypatch.setenv(VARIABLE, "dask:" + empty.scheduler_address)
        with pytest.raises(SmokeglintError, match="lost all of its workers"):
            fan_out(noise, TASKS)


def test_a_task_that_always_kills_ends_in_an_error(monkeypatch):
    monkeypatch.setenv(VARIABLE, "processes:1")
    with pytest.raises(SmokeglintError, match=r"Task 1 of 1 .* 3 times"):
        fan_out(die, [(0,)])


@pytest.mark.parametrize("kind", ["", "processes:1"])
def test_what_the_function_raises_is_raised_here(monkeypatch, kind):
    monkeypatch.setenv(VARIABLE, kind)
    with pytest.raises(ValueError, match="task 4"):
        fan_out(refuse, [(4,)])


def test_without_a_setting_a_task_runs_only_when_its_result_is_asked_for(monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    seen = []
    results = fan_out_in_turn(seen.append, [(1,), (2,)])
    assert seen == []
    next(results)
    assert seen == [1]


@pytest.mark.parametrize("value", ["processes:0", "processes:x", "threads:2", "dask:", "dask"])
def test_a_bad_setting_is_named(monkeypatch, value):
    monkeypatch.setenv(VARIABLE, value)
    with pytest.raises(SmokeglintError, match=VARIABLE):
        fan_out(noise, TASKS)
