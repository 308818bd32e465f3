"""Inputs of the retrieval's processes as looks, tables and rasters; tables that are no contract as files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from services.retrieval import process_models as models
from shared.process import ArtifactRef, JobContext

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

    from services.retrieval.ancillary.burned_rasters import BurnedRaster
    from services.retrieval.looks.features import Observations


def looks_with_ancillary(inputs: models.AncillaryInputs, context: JobContext) -> Observations:
    """Usable looks with what other sensors and maps know about their places."""
    from dataclasses import replace

    import pandas as pd

    from services.retrieval.ancillary.layers import Layers, with_ancillary
    from services.retrieval.ancillary.smap import read_smap

    seen = read_looks(inputs, context)
    context.progress(50, "ancillary layers")
    given = [
        read_smap(context.path(ref), ref.name, resolution_km=inputs.soil_moisture_km) for ref in inputs.soil_moisture
    ]
    rasters = (None if ref is None else context.path(ref) for ref in (inputs.elevation, inputs.land_cover))
    moisture = pd.concat(given, ignore_index=True) if given else None
    layers = Layers(moisture, inputs.soil_moisture_km, *rasters)
    return replace(seen, looks=with_ancillary(seen.looks, layers))


def observed_images(
    inputs: models.SimulateObservationsInputs, context: JobContext
) -> tuple[pd.DataFrame | None, dict[str, int]]:
    """The images whose maps are wanted (not lost and, where asked, on the ground in time; None without any wanted), and
    how many were left out why.
    """
    if not inputs.raw_if or inputs.images is None:
        return None, {}
    images = context.read_table(inputs.images, "AS_RUN")
    kept = images[images["status"] != "lost"]
    counts = {"read": len(images), "lost": len(images) - len(kept)}
    if inputs.downlinked_by is None:
        return kept, counts
    down = kept[kept["downlinked_at"] <= inputs.downlinked_by]
    return down, counts | {"not_downlinked": len(kept) - len(down)}


def read_looks(inputs: models.ObservedInputs, context: JobContext) -> Observations:
    """All usable looks of the input files within the input's times; marks the step simulated where a file is."""
    from services.retrieval.level1.reader import is_simulated
    from services.retrieval.looks.features import read_observations

    paths = [context.path(reference) for reference in inputs.observations]
    if not context.product.simulated and any(is_simulated(path) for path in paths):
        context.mark_simulated(share=sum(map(is_simulated, paths)) / len(paths))
    context.progress(10, "reading level-1 maps")
    return read_observations(paths, time_from=naive_utc(inputs.time_from), time_to=naive_utc(inputs.time_to))


def looks_product(
    inputs: models.ObservedInputs, context: JobContext, further: Sequence[ArtifactRef] = ()
) -> dict[str, Any]:
    """The product attributes of a file made from the observations and ``further`` inputs alone: theirs, and what the
    observation files say themselves.
    """
    from services.retrieval.level1.reader import is_simulated

    attributes = context.product_attributes([*inputs.observations, *further])
    share = sum(is_simulated(context.path(reference)) for reference in inputs.observations) / len(inputs.observations)
    share = round(max(share, attributes["simulated_share"]), 4)
    return attributes | {"simulated": share > 0.0, "simulated_share": share}


def read_soil_moisture(inputs: models.TrainSoilMoistureInputs, context: JobContext) -> pd.DataFrame:
    """The soil moisture to learn from, on the cells of the regression: tables or SMAP level-3 files, one or several."""
    import pandas as pd

    from services.retrieval.ancillary.smap import read_smap
    from services.retrieval.soil_moisture.regression import on_grid

    given = inputs.soil_moisture if isinstance(inputs.soil_moisture, list) else [inputs.soil_moisture]
    source_km = inputs.soil_moisture_km or inputs.resolution_km
    tables = [read_smap(context.path(ref), ref.name, resolution_km=source_km) for ref in given]
    table = pd.concat(tables, ignore_index=True)
    if source_km < inputs.resolution_km:
        return on_grid(table, inputs.resolution_km)
    if source_km > inputs.resolution_km:  # each fine cell takes the value of the coarse one around it
        part = pd.DataFrame({"down": range(16)})
        fine = table.merge(part, how="cross")
        row, column = 4 * fine["row"] + fine["down"] // 4, 4 * fine["column"] + fine["down"] % 4
        return fine.assign(row=row, column=column).drop(columns="down")
    return table


def write_plain(name: str, table: pd.DataFrame, context: JobContext, attributes: dict[str, Any]) -> None:
    """Parquet of a table that is no contract between services, with its product attributes in the file's metadata."""
    import json

    import pyarrow as pa
    import pyarrow.parquet as pq

    from shared.contracts.schema import PRODUCT_KEY

    path = new_file(name, context, attributes)
    document = {"table": name.removesuffix(".parquet"), **attributes}
    content = pa.Table.from_pandas(table, preserve_index=False)
    content = content.replace_schema_metadata({PRODUCT_KEY: json.dumps(document, sort_keys=True).encode()})
    pq.write_table(content, str(path), compression="zstd")


def new_file(name: str, context: JobContext, attributes: dict[str, Any]) -> Path:
    """A path for a file of such product attributes: where they differ from the step's, the manifest says so, too."""
    path = context.new_file(name)
    own = {key: attributes[key] for key in ("simulated", "simulated_share", "oldest_input")}
    if not own.items() <= context.product_attributes().items():
        context.describe(name, **own)
    return path


def burned_area_product(inputs: models.RetrieveBurnedAreaInputs, context: JobContext) -> dict[str, Any]:
    """The product attributes of burned area: of all inputs but the perimeters, which are only drawn."""
    if inputs.perimeters is None:
        return context.product_attributes()
    maps = (inputs.baseline, inputs.model, inputs.elevation, inputs.land_cover)
    return looks_product(inputs, context, [*inputs.soil_moisture, *(given for given in maps if given is not None)])


def naive_utc(time: Any) -> np.datetime64 | None:
    import pandas as pd

    return None if time is None else pd.Timestamp(time).tz_convert("UTC").tz_localize(None).to_datetime64()


def read_plain(reference: ArtifactRef, context: JobContext) -> pd.DataFrame:
    """A Parquet table that is no contract between services; its reader checks the columns it needs."""
    import pandas as pd
    import pyarrow as pa

    from shared.errors import DomainError

    try:
        return pd.read_parquet(context.path(reference))
    except (pa.ArrowInvalid, OSError) as error:
        raise DomainError(f"'{reference.name}' is no Parquet table: {error}", field=reference.name) from error


def read_burned_raster(given: models.BurnedRasterInput, context: JobContext) -> BurnedRaster:
    from services.retrieval.ancillary.burned_rasters import BurnedRaster

    coding = "class" if given.product in ("landsat", "class") else "day-of-year"
    times = (naive_utc(time) for time in (given.burned_on, given.observed_from, given.observed_to))
    burned_on, observed_from, observed_to = times
    path = context.path(given.raster)
    return BurnedRaster(path, coding, given.year, burned_on, given.min_value, observed_from, observed_to)
