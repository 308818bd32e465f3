"""The tables that services exchange: columns that others rely on. More may be added, none renamed."""

from __future__ import annotations

from shared.contracts.schema import Column, TableSchema

GEOMETRY = Column("geometry", "geometry")

STATIONS = TableSchema(
    "stations",
    (
        Column("station", "string"),
        Column("latitude_deg", "float64", minimum=-90, maximum=90),
        Column("longitude_deg", "float64", minimum=-180, maximum=360),
        Column("height_m", "float64", minimum=-500, maximum=20000),
        Column("mask_deg", "float64", minimum=0, maximum=90),
        Column("datum", "string", values=("geodetic", "spherical")),
        Column("up", "string", required=False, nullable=True, values=("geodetic", "spherical")),
        Column("azimuth_mask", "string", required=False, nullable=True),
    ),
    unique=("station",),
)

INCIDENTS = TableSchema(
    "incidents",
    (
        Column("incident_id", "string"),
        Column("name", "string"),
        Column("start", "time"),
        GEOMETRY,
        Column("area_km2", "float64", nullable=True, minimum=0),
        Column("known_at", "time"),
    ),
    unique=("incident_id",),
)

WEATHER = TableSchema(
    "weather",
    (
        Column("time", "time"),
        GEOMETRY,
        Column("temperature_c", "float64", nullable=True, minimum=-90, maximum=65),
        Column("relative_humidity_pct", "float64", nullable=True, minimum=0, maximum=101),
        Column("wind_speed_m_s", "float64", nullable=True, minimum=0, maximum=120),
        Column("wind_direction_deg", "float64", nullable=True, minimum=0, maximum=360),
        Column("rain_mm", "float64", nullable=True, minimum=0, maximum=1000),
        Column("valid_at", "time"),
        Column("issued_at", "time"),
    ),
)

RATINGS = TableSchema(
    "ratings",
    (
        Column("incident_id", "string"),
        Column("time", "time"),
        Column("probability", "float64", minimum=0, maximum=1),
        Column("probability_low", "float64", minimum=0, maximum=1),
        Column("probability_high", "float64", minimum=0, maximum=1),
        Column("percentile", "float64", minimum=0, maximum=100),
        Column("drivers", "string"),
        Column("out_of_domain", "bool"),
        Column("imputed", "string"),
    ),
    unique=("incident_id", "time"),
)

TARGETS = TableSchema(
    "targets",
    (
        Column("target_id", "int64"),
        Column("kind", "string", values=("active", "prefire")),
        Column("priority", "float64", minimum=0),
        Column("priority_low", "float64", required=False, minimum=0),
        Column("priority_high", "float64", required=False, minimum=0),
        Column("source", "string", required=False),
        GEOMETRY,
    ),
    unique=("target_id",),
)

SPECULAR_POINTS = TableSchema(
    "specular_points",
    (
        Column("satellite", "string"),
        Column("transmitter", "string"),
        Column("time", "time"),
        GEOMETRY,
        Column("incidence_deg", "float64", minimum=0, maximum=90),
        Column("rx_gain_dbi", "float64", minimum=-200, maximum=60),
        Column("rx_range_m", "float64", minimum=0),
        Column("tx_range_m", "float64", minimum=0),
    ),
)

OPPORTUNITIES = TableSchema(
    "opportunities",
    (
        Column("image_id", "int32", minimum=0),
        Column("satellite", "string"),
        Column("time", "time"),
        Column("target_id", "int64"),
        Column("transmitter", "string", required=False),
        Column("incidence_deg", "float64", required=False, minimum=0, maximum=90),
        Column("distance_km", "float64", required=False, minimum=0),
        Column("rx_gain_dbi", "float64", required=False, minimum=-200, maximum=60),
        # still covered if the satellite runs ahead of or behind its prediction by the stated error; null: not computed
        Column("covered_ahead", "bool", required=False, nullable=True),
        Column("covered_behind", "bool", required=False, nullable=True),
        Column("along_track_error_km", "float64", required=False, nullable=True, minimum=0),
        Column("pointing", "string", required=False, nullable=True),
    ),
    unique=("image_id", "target_id"),
)

CONTACTS = TableSchema(
    "contacts",
    (
        Column("satellite", "string"),
        Column("station", "string"),
        Column("start", "time"),
        Column("end", "time"),
        Column("max_elevation_deg", "float64", required=False, minimum=-90, maximum=90),
    ),
)

ECLIPSES = TableSchema(
    "eclipses",
    (
        Column("satellite", "string"),
        Column("start", "time"),
        Column("end", "time"),
        Column("kind", "string", required=False, values=("umbra", "penumbra")),
    ),
)

SCHEDULE = TableSchema(
    "schedule",
    (
        Column("satellite", "string"),
        Column("start", "time"),
        Column("end", "time"),
        Column("command", "string", values=("collect", "downlink")),
        Column("image_id", "int32", nullable=True),
        Column("station", "string", nullable=True),
        Column("cycle", "int32", minimum=0),
        Column("uplink_contact", "time", nullable=True),
        Column("pointing", "string", required=False, nullable=True),
    ),
)

AS_RUN = TableSchema(
    "as_run",
    (
        Column("satellite", "string"),
        Column("start", "time"),
        Column("end", "time"),
        Column("image_id", "int32"),
        Column("status", "string", values=("collected", "downlinked", "lost")),
        Column("downlinked_at", "time", nullable=True),
        Column("station", "string", nullable=True),
    ),
)

DETECTIONS = TableSchema(
    "detections",
    (
        Column("time", "time"),
        Column("delivered_at", "time"),
        GEOMETRY,
        Column("satellite", "string"),
        Column("instrument", "string"),
        Column("confidence", "float64", nullable=True, minimum=0, maximum=100),
        Column("frp_mw", "float64", nullable=True, minimum=0),
        Column("fire", "bool"),
        Column("along_m", "float64", minimum=0),
        Column("across_m", "float64", minimum=0),
    ),
)

BURNED_AREA = TableSchema(
    "burned_area",
    (
        Column("time", "time"),
        GEOMETRY,
        Column("along_m", "float64", minimum=0),
        Column("across_m", "float64", minimum=0),
        Column("burned_probability", "float64", minimum=0, maximum=1),
        Column("burned", "bool"),
        Column("confidence", "float64", minimum=0, maximum=100),
        Column("mode", "string", values=("nominal", "raw-if")),
    ),
)

SOIL_MOISTURE = TableSchema(
    "soil_moisture",
    (
        Column("time", "time"),
        Column("row", "int32", minimum=0),
        Column("column", "int32", minimum=0),
        Column("soil_moisture", "float64", minimum=0, maximum=1),
        Column("soil_moisture_sd", "float64", minimum=0, maximum=1),
        Column("count", "int32", minimum=0),
        Column("mode", "string", values=("nominal", "raw-if")),
    ),
)

PERIMETERS = TableSchema(
    "perimeters",
    (
        Column("incident_id", "string"),
        Column("time", "time"),
        Column("known_at", "time"),
        GEOMETRY,
    ),
)

ALL: dict[str, TableSchema] = {name: value for name, value in globals().items() if isinstance(value, TableSchema)}
