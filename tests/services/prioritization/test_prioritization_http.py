"""Over HTTP: a quiet day is answered, bad input gets a problem that names the field; never a fault of the service."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from fastapi.testclient import TestClient

from services.prioritization.processes import PROCESSES
from shared.contracts import grids, schema, tables
from shared.process.app import create_app
from shared.settings import ServiceSettings


class Caller:
    """Writes inputs below a service's artifact root and asks its processes."""

    def __init__(self, client: TestClient, root: Path) -> None:
        self.client, self.root, self.count = client, root, 0

    def file(self, content: bytes | xr.Dataset | pd.DataFrame, contract: str = "") -> dict[str, str]:
        """A reference to bytes, a netCDF of a dataset or a Parquet of a table (of a contract where one is named)."""
        self.count += 1
        path = self.root / f"input_{self.count}"
        if isinstance(content, bytes):
            path.write_bytes(content)
        elif isinstance(content, xr.Dataset):
            grids.write_netcdf(path, content)
        elif contract:
            schema.write_table(path, content, tables.ALL[contract])
        else:
            content.to_parquet(path)
        return {"href": path.name}

    def ask(self, process: str, **inputs: Any) -> tuple[int, dict[str, Any]]:
        inputs = {name: str(value) if isinstance(value, pd.Timestamp) else value for name, value in inputs.items()}
        answer = self.client.post(f"/processes/{process}/execution", json={"inputs": inputs})
        return answer.status_code, answer.json()

    def ratings(self, **inputs: Any) -> pd.DataFrame:
        status, out = self.ask("rate-active-fires", **inputs)
        assert status == 200, out
        return schema.read_table(Path(out["ratings"]["href"].removeprefix("file://")), tables.RATINGS)

    def danger(self, **inputs: Any) -> xr.Dataset:
        status, out = self.ask("rate-prefire-danger", **inputs)
        assert status == 200, out
        return grids.read_netcdf(Path(out["danger"]["href"].removeprefix("file://")), grids.DANGER)


@pytest.fixture(scope="module")
def caller(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Caller]:
    root = tmp_path_factory.mktemp("http")
    settings = ServiceSettings(artifact_root=str(root))
    app = create_app("prioritization", "Prioritization", PROCESSES, settings=settings)
    with TestClient(app, raise_server_exceptions=False) as client:
        yield Caller(client, root)


@pytest.fixture
def region(caller: Caller, make: dict[str, Callable[..., Any]], time: pd.Timestamp) -> dict[str, Any]:
    """Incidents, two days of weather, fuels and the time, as a rating asks for them."""
    return {
        "incidents": caller.file(make["incidents"](), "INCIDENTS"),
        "weather": caller.file(make["weather"](hours=48)),
        "fuels": caller.file(make["fuels"]()),
        "time": time,
    }


def _prefire(region: dict[str, Any], **changed: Any) -> dict[str, Any]:
    return {name: value for name, value in (region | changed).items() if name != "incidents"}


def test_a_day_without_fires_is_rated_and_targeted(caller, make, region, area):
    nothing = caller.file(make["incidents"]().iloc[:0], "INCIDENTS")
    ratings = caller.ratings(**(region | {"incidents": nothing}))
    assert ratings.empty
    danger = caller.file(caller.danger(**_prefire(region)))
    unrated = caller.file(ratings, "RATINGS")
    body = {"ratings": unrated, "danger": danger, "area": area, "time": region["time"]}
    status, out = caller.ask("build-targets", incidents=nothing, **body)
    assert (status, out.get("active_count")) == (200, 0) and out["prefire_count"] > 100
    status, out = caller.ask("build-targets", incidents=region["incidents"], **body)
    assert status == 200 and out["active_count"] > 0  # fires that nobody has rated yet are looked at all the same


def test_longitudes_from_0_to_360_give_what_signed_ones_give(caller, make, region):
    def east(grid: xr.Dataset) -> dict[str, str]:
        return caller.file(grid.assign_coords(longitude=grid["longitude"] + 360))

    turned = region | {"weather": east(make["weather"](hours=48)), "fuels": east(make["fuels"]())}
    pd.testing.assert_frame_equal(caller.ratings(**turned), caller.ratings(**region))
    a, b = caller.danger(**_prefire(turned)), caller.danger(**_prefire(region))
    np.testing.assert_array_equal(a["wfpi"], b["wfpi"])
    np.testing.assert_allclose(a["longitude"], b["longitude"], atol=1e-9)


def test_hours_given_twice_count_once(caller, make, region):
    wet = make["weather"](hours=48)
    wet["rain_mm"] += 0.1
    twice = caller.file(xr.concat([wet, wet.isel(time=slice(24, 60))], "time"))
    a, b = (caller.danger(**_prefire(region, weather=grid)) for grid in (twice, caller.file(wet)))
    np.testing.assert_array_equal(a["wfpi"], b["wfpi"])


def test_targets_take_the_lead_days_of_their_own_time(caller, make, region, area, time):
    danger = caller.danger(**_prefire(region, weather=caller.file(make["weather"]())))
    danger["wfsp_x"][0] = 0.0
    danger["wlfp_x"][0] = 0.0
    ratings = caller.file(make["ratings"](), "RATINGS")
    body = {"incidents": region["incidents"], "ratings": ratings, "danger": caller.file(danger), "area": area}
    status, first = caller.ask("build-targets", time=time, **body)
    assert (status, first["prefire_count"]) == (200, 0)
    status, next_day = caller.ask("build-targets", time=time + pd.Timedelta(days=1), **body)
    assert status == 200 and next_day["prefire_count"] > 100
    for wrong in (time - pd.Timedelta(hours=3), time + pd.Timedelta(days=30)):
        status, problem = caller.ask("build-targets", time=wrong, **body)
        assert (status, problem["field"]) == (422, "danger")


OBSERVED = pd.DataFrame(
    {
        "time": ["2022-06-10T12:00:00Z"],
        "longitude_deg": [-108.0],
        "latitude_deg": [33.0],
        "fuel_moisture_10h_pct": [8.0],
    }
)


@pytest.mark.parametrize(
    "content",
    [
        b"abc",
        OBSERVED.assign(fuel_moisture_10h_pct="wet"),
        OBSERVED.assign(time="yesterday"),
        OBSERVED.assign(longitude_deg="west"),
        OBSERVED.assign(fuel_moisture_sd_pct=-1.0),
        OBSERVED.drop(columns="latitude_deg"),
    ],
)
def test_moisture_observations_that_are_none_are_named(caller, region, content):
    body = {"weather": region["weather"], "time": region["time"], "observations": caller.file(content)}
    status, problem = caller.ask("forecast-fuel-moisture", **body)
    assert (status, problem["field"]) == (422, "observations")


@pytest.mark.parametrize(
    "content",
    [OBSERVED.assign(time="x"), OBSERVED.assign(time=None), OBSERVED.assign(longitude_deg="x")],
)
def test_good_observations_that_are_none_are_named(caller, make, region, area, content):
    danger = make["fuels"]()[["mask_code"]].expand_dims(lead_day=1)
    danger["mask_code"] = danger["mask_code"].isel(lead_day=0, drop=True)
    for name in ("wfpi", "wlfp", "wfsp"):
        danger[name] = danger[name + "_x"] = (xr.ones_like(danger["mask_code"]) * 10.0).expand_dims(lead_day=1)
    body = {
        "incidents": region["incidents"],
        "ratings": caller.file(make["ratings"](), "RATINGS"),
        "danger": caller.file(danger),
        "area": area,
        "time": region["time"],
    }
    status, problem = caller.ask("build-targets", observed=caller.file(content), **body)
    assert (status, problem["field"]) == (422, "observed")
    assert caller.ask("build-targets", observed=caller.file(OBSERVED), **body)[0] == 200


@pytest.mark.parametrize("process", ["rate-active-fires", "rate-prefire-danger"])
def test_fuels_on_other_dimensions_are_named(caller, make, region, process):
    fuels = make["fuels"]()
    for changed in (fuels.expand_dims(band=1), fuels.drop_vars("latitude")):
        body = region | {"fuels": caller.file(changed)}
        status, problem = caller.ask(process, **(body if process == "rate-active-fires" else _prefire(body)))
        assert status == 422 and problem["field"] in ("kbdi", "ndvi")


FIRES = pd.DataFrame(
    {
        "season": [f"20{year}-{year + 1}" for year in range(10, 16) for _ in range(20)],
        "temperature_c": 30.0,
        "relative_humidity_pct": 20.0,
        "wind_speed_m_s": 5.0,
        "kbdi_mm": 80.0,
        "large": 0,
    }
)


@pytest.mark.parametrize(
    ("table", "field"),
    [
        (FIRES.assign(temperature_c=["hot"] * len(FIRES)), "temperature_c"),
        (FIRES.assign(kbdi_mm=800.0), "kbdi_mm"),  # hundredths of an inch
        (FIRES.assign(large="no"), "label"),
        (FIRES, "table"),  # no large fire
        (FIRES.assign(relative_humidity_pct=0.2), "relative_humidity_pct"),  # a fraction
        (FIRES.assign(large=np.arange(len(FIRES)) < 12), "table"),  # large ones only where nothing is scored
        (FIRES.assign(large=np.arange(len(FIRES)) % 80 < 12), "first_test_season"),  # none in the seasons of the test
    ],
)
def test_training_tables_that_cannot_teach_are_named(caller, table, field):
    reference = caller.file(table.to_csv(index=False).encode())
    body = {"table": reference, "label": "large", "first_test_season": "2015-16"}
    status, problem = caller.ask("train-large-fire-model", **body)
    assert (status, problem["field"]) == (422, field)


def test_a_training_table_cut_short_is_named(caller):
    import gzip

    cut = gzip.compress(FIRES.to_csv(index=False).encode())[:-40]
    status, problem = caller.ask("train-large-fire-model", table=caller.file(cut), label="large")
    assert (status, problem["field"]) == (422, "table")


@pytest.mark.parametrize(("column", "value"), [("wfpi", "dry"), ("large", "yes"), ("time", "June")])
def test_fire_histories_with_text_for_numbers_are_named(caller, column, value):
    fires = pd.DataFrame(
        {"longitude_deg": [-110.0], "latitude_deg": [40.0], "time": ["2020-07-01"], "wfpi": [50.0], "large": [1]}
    ).assign(**{column: value})
    tables_given = {"fires": caller.file(fires), "voxels": caller.file(fires)}
    status, problem = caller.ask("fit-fire-probability", source="test", **tables_given)
    assert (status, problem["field"]) == (422, column)


def test_arrival_maps_in_per_cent_are_named(caller, make, region, area):
    arrival = make["arrival"]()
    arrival["burned_probability"] = arrival["burned_probability"] * 100
    body = {
        "incidents": region["incidents"],
        "ratings": caller.file(make["ratings"](), "RATINGS"),
        "danger": caller.file(caller.danger(**_prefire(region))),
        "fire_arrival": [caller.file(arrival)],
    }
    status, problem = caller.ask("build-targets", area=area, time=region["time"], **body)
    assert (status, problem["field"]) == (422, "burned_probability")
