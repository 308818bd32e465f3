"""Inputs and outputs of the retrieval service's processes."""

from __future__ import annotations

from typing import Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from shared.process import ArtifactRef, ProcessInputs, ProcessOutputs

OBSERVATIONS = "level-1 netCDF files (CYGNSS v3 variable names), nominal 17 x 11 or raw-IF 69 x 111 maps"


class SimulateObservationsInputs(ProcessInputs):
    """Where and when the satellites look, and the surface as nature has it."""

    specular_points: ArtifactRef = Field(description="specular_points table; a column `nominal` marks tracked channels")
    surface: ArtifactRef = Field(description="surface netCDF: daily soil moisture, vegetation, roughness, burn times")
    images: ArtifactRef | None = Field(None, description="as_run table: the raw-IF seconds that were collected")
    seed: int = Field(0, ge=0, description="seed of noise and speckle")
    nominal: bool = Field(True, description="simulate the nominal 17 x 11 maps")
    raw_if: bool = Field(True, description="simulate the 69 x 111 maps of the raw-IF seconds")
    downlinked_by: AwareDatetime | None = Field(
        None, description="only images on the ground by this time (null: every image that was not lost)"
    )


class SimulateObservationsOutputs(ProcessOutputs):
    nominal: ArtifactRef | None = Field(None, description="level-1 netCDF of 17 x 11 maps")
    raw_if: ArtifactRef | None = Field(None, description="level-1 netCDF of 69 x 111 maps; null without images")
    report: ArtifactRef
    nominal_count: int
    raw_if_count: int


class ObservedInputs(ProcessInputs):
    """What was seen, and between which times it counts."""

    observations: list[ArtifactRef] = Field(min_length=1, description=OBSERVATIONS)
    time_from: AwareDatetime | None = Field(None, description="only looks from this time on")
    time_to: AwareDatetime | None = Field(None, description="only looks before this time, e.g. a cut-off")


class AncillaryInputs(ObservedInputs):
    """What was seen, and what other sensors and maps know about the places."""

    soil_moisture: list[ArtifactRef] = Field(
        default_factory=list,
        description="SMAP level-3 files (HDF5, day in the name) or Parquet time, row, column, soil_moisture",
    )
    soil_moisture_km: Literal[9, 36] = Field(9, description="EASE-Grid 2.0 resolution of the soil moisture")
    elevation: ArtifactRef | None = Field(
        None,
        description="heights in metres, raster of any CRS (SRTM or another); null: level-1 srtm_dem_alt, srtm_slope",
    )
    land_cover: ArtifactRef | None = Field(
        None, description="raster of land-cover codes, any CRS; null: level-1 modis_land_cover"
    )


class RetrieveBurnedAreaInputs(AncillaryInputs):
    """What was seen, how the places looked before, and what to judge with."""

    baseline: ArtifactRef | None = Field(
        None, description="pre-fire reflectivity per EASE cell, from train-soil-moisture; null: judged without change"
    )
    model: ArtifactRef | None = Field(None, description="model from train-burned-area (UBJ); null: the shipped one")
    perimeters: ArtifactRef | None = Field(
        None, description="fire perimeters (GeoParquet or GeoJSON) to draw under the looks; they enter no product"
    )


class RetrieveBurnedAreaOutputs(ProcessOutputs):
    burned_area: ArtifactRef
    report: ArtifactRef
    map: ArtifactRef = Field(description="picture of the looks (PNG), over the perimeters where given")
    grid: ArtifactRef = Field(description="EASE-Grid 2.0 3 km map with counts, CF netCDF")
    cog: ArtifactRef = Field(description="the same as Cloud-Optimised GeoTIFF")
    geojson: ArtifactRef = Field(description="looks as GeoJSON points, at most 5,000")
    look_count: int
    burned_count: int


class RetrieveSoilMoistureInputs(ObservedInputs):
    """What was seen, and what each cell's reflectivity means there."""

    reference: ArtifactRef = Field(
        description="Parquet per EASE-Grid cell, 9 km or that of its column resolution_km: row, column, "
        "soil_moisture_mean (m3/m3), reflectivity_mean_db, slope (m3/m3 per dB), sd (m3/m3), from train-soil-moisture"
    )
    raw_if_model: ArtifactRef | None = Field(
        None, description="quantile model of raw-IF looks from train-soil-moisture; null: by the regression"
    )


class RetrieveSoilMoistureOutputs(ProcessOutputs):
    soil_moisture: ArtifactRef
    grid: ArtifactRef = Field(description="level-3 netCDF on EASE-Grid 2.0: SM_daily, SIGMA_daily, count")
    cog: ArtifactRef = Field(description="the same as Cloud-Optimised GeoTIFF, EPSG:6933")
    report: ArtifactRef
    cell_count: int


class BurnedRasterInput(BaseModel):
    """One burned-area raster of any CRS, and what its values mean."""

    model_config = ConfigDict(extra="forbid")
    raster: ArtifactRef = Field(description="GeoTIFF or the like; MCD64A1 also as HDF4 tile")
    product: Literal["mcd64a1", "firecci51", "landsat", "day-of-year", "class"] = Field(
        description="mcd64a1, firecci51, day-of-year: 1..366 day of burning, 0 unburned, else not observed; landsat, "
        "class: min_value and more burned, below unburned, negative not observed"
    )
    year: int | None = Field(None, ge=1980, le=2100, description="year of the days")
    burned_on: AwareDatetime | None = Field(None, description="time by which the burned class had burned")
    min_value: float = Field(1.0, gt=0, description="least value of the burned class")
    observed_from: AwareDatetime | None = Field(None, description="what is 0 counts as unburned from this time on")
    observed_to: AwareDatetime | None = Field(None, description="... and before this time; null: without bound")


class TrainBurnedAreaInputs(AncillaryInputs):
    """Looks with known fate: by places, by burned-area rasters, or by the union of both."""

    labels: ArtifactRef | None = Field(
        None, description="Parquet longitude_deg, latitude_deg, burn_time (null: unburned), or netCDF grid of burn_time"
    )
    burned_rasters: list[BurnedRasterInput] = Field(
        default_factory=list, description="burned-area products; a place has burned where any of them says so"
    )
    baseline: ArtifactRef | None = Field(None, description="pre-fire reflectivity per EASE cell")
    calibration_share: float = Field(0.25, gt=0.05, lt=0.6, description="share of 1 degree blocks kept for calibration")


class TrainBurnedAreaOutputs(ProcessOutputs):
    model: ArtifactRef
    report: ArtifactRef
    look_count: int
    auc: float | None = Field(description="area under the ROC curve on the calibration blocks; null if undefined")


class TrainSoilMoistureInputs(ObservedInputs):
    """Looks of the weeks before, with soil moisture of another sensor for the same days."""

    soil_moisture: ArtifactRef | list[ArtifactRef] = Field(
        description="SMAP: Parquet on EASE-Grid cells (time, row, column, soil_moisture in m3/m3), or level-3 files "
        "(HDF5: SPL3SMP_E on 9 km, SPL3SMP on 36 km)"
    )
    resolution_km: Literal[9, 36] = Field(9, description="EASE-Grid 2.0 of the regression")
    soil_moisture_km: Literal[9, 36] | None = Field(
        None, description="EASE-Grid 2.0 of the soil moisture given; null: that of the regression"
    )
    raw_if_method: Literal["cqr", "ngboost", "none"] = Field(
        "cqr",
        description="model of raw-IF looks, where there are enough: quantiles by XGBoost made conformal by site, or "
        "NGBoost likewise",
    )


class TrainSoilMoistureOutputs(ProcessOutputs):
    reference: ArtifactRef = Field(description="per cell: what retrieve-soil-moisture needs")
    raw_if_model: ArtifactRef | None = Field(None, description="null with too few raw-IF looks")
    figure: ArtifactRef = Field(description="held-out estimates against soil moisture, and both over time (PNG)")
    baseline: ArtifactRef = Field(description="pre-fire reflectivity per cell: what retrieve-burned-area compares with")
    report: ArtifactRef
    cell_count: int


class ComputeDdmInputs(ProcessInputs):
    """A raw-IF recording and the reflection to look for in it."""

    recording: ArtifactRef = Field(description="raw-IF recording (.bin): DRT0 header, two-bit samples")
    prn: int = Field(ge=1, le=32, description="GPS PRN of the transmitter")
    channel: int = Field(1, ge=0, le=3, description="0 zenith, 1 starboard, 2 port")
    doppler_hz: float = Field(
        ge=-5e4, le=5e4, description="expected Doppler of the reflection, Hz (level-1 sp_ddmi_dopp)"
    )
    search_hz: float = Field(1000.0, ge=0, le=5000, description="half width of the Doppler search, Hz")
    milliseconds: int = Field(1000, ge=1, le=60_000, description="incoherent sum, ms")
    noise_temperature_k: float = Field(
        550.0, gt=0, description="system noise temperature, K: turns noise units into watts, for want of calibration"
    )
    look: dict[str, float] = Field(
        default_factory=dict,
        description="geometry of the look where known: latitude_deg, longitude_deg, incidence_deg, rx_gain_dbi, "
        "rx_range_m, tx_range_m, eirp_w",
    )


class ComputeDdmOutputs(ProcessOutputs):
    ddm: ArtifactRef
    report: ArtifactRef
    peak_to_mean: float = Field(description="acquisition peak over the mean of the search")
