"""The spacecraft document in the two forms this service needs: solver limits, and plain fields for the replay."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import pandas as pd
from pydantic import ValidationError

from services.planning.problem import SatelliteLimits
from shared.contracts.spacecraft import Spacecraft
from shared.errors import DomainError


def read_spacecraft(document: dict[str, Any]) -> Spacecraft:
    """The checked document; `DomainError` names the first field at fault."""
    content = {key: value for key, value in document.items() if key != "product"}
    try:
        return Spacecraft.model_validate_json(json.dumps(content))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(["spacecraft", *map(str, first["loc"])])
        value = first.get("input") if first["loc"] else None
        raise DomainError(f"the spacecraft document is unusable: {first['msg']}", field=place, value=value) from error


def satellite_fields(spacecraft: Spacecraft, names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Per satellite: all fields of the contract, its own state filled in, ``unavailable`` in seconds from the start."""
    common = spacecraft.model_dump(exclude={"satellites", "horizon_start", "horizon_s"})
    origin = pd.Timestamp(spacecraft.horizon_start)
    fields = {}
    for name in names:
        state = spacecraft.for_satellite(name)
        windows = tuple(
            ((w.start - origin).total_seconds(), (w.end - origin).total_seconds()) for w in state.unavailable
        )
        own = state.model_dump(exclude={"unavailable"})
        fields[name] = {**common, **own, "unavailable": windows}
    return fields


def satellite_limits(spacecraft: Spacecraft, names: Iterable[str]) -> dict[str, SatelliteLimits]:
    """Per satellite: the limits the solver works with."""
    return {name: SatelliteLimits(name=name, **fields) for name, fields in satellite_fields(spacecraft, names).items()}
