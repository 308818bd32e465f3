"""Where a valid retrieval exists, and since when: what was not observed gains priority in the next cycle."""

from __future__ import annotations

import json

from pydantic import Field

from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs

LATTICE_DEG = 0.02  # about 2 km: finer than any footprint over land


class ObservedPlacesInputs(ProcessInputs):
    burned_area: ArtifactRef = Field(description="burned-area points of this cycle")
    before: ArtifactRef | None = Field(None, description="observed places of earlier cycles")


class ObservedPlacesOutputs(ProcessOutputs):
    observed: ArtifactRef
    places: int


def observed_places(inputs: ObservedPlacesInputs, context: JobContext) -> ObservedPlacesOutputs:
    """Longitude, latitude and time of the latest good raw-IF observation at each place of a fine lattice.

    Nominal observations are everywhere every day; what the planner spends storage on is raw IF, so that counts.
    """
    import pandas as pd
    import pyarrow as pa
    import pyarrow.parquet as pq

    from shared.contracts.schema import PRODUCT_KEY

    points = context.read_table(inputs.burned_area, "BURNED_AREA")
    points = points[points["mode"] == "raw-if"]
    places = pd.DataFrame(
        {"longitude_deg": points.geometry.x, "latitude_deg": points.geometry.y, "time": points["time"]}
    )
    if inputs.before is not None:
        places = pd.concat([pd.read_parquet(context.path(inputs.before)), places], ignore_index=True)
    for name in ("longitude_deg", "latitude_deg"):
        places[name] = ((places[name] / LATTICE_DEG).round() * LATTICE_DEG).round(6)
    places["time"] = places["time"].astype("datetime64[ms, UTC]")
    latest = places.groupby(["longitude_deg", "latitude_deg"], as_index=False)["time"].max()
    made_by = {PRODUCT_KEY: json.dumps(context.product_attributes(), sort_keys=True).encode()}
    table = pa.Table.from_pandas(latest, preserve_index=False).replace_schema_metadata(made_by)
    pq.write_table(table, context.new_file("observed.parquet"))
    return ObservedPlacesOutputs(observed=context.ref("observed.parquet"), places=len(latest))


OBSERVED_PLACES = Process(
    "observed-places",
    "Where observations exist",
    "The latest good raw-IF observation of each place.",
    ObservedPlacesInputs,
    ObservedPlacesOutputs,
    observed_places,
)
