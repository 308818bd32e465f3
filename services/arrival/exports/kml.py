"""Isochrones as KML 2.2 with time spans, so that a globe's time slider plays the fire."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree as XML

import pandas as pd

NAMESPACE = "http://www.opengis.net/kml/2.2"
# From the first isochrone (dark red) to the last (yellow), as KML writes colours: alpha, blue, green, red.
FIRST_RGB, LAST_RGB = (128, 0, 38), (255, 220, 80)


def _colour(share: float) -> str:
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(FIRST_RGB, LAST_RGB, strict=True))
    return f"ff{blue:02x}{green:02x}{red:02x}"


def _add(parent: XML.Element, tag: str, text: str | None = None) -> XML.Element:
    child = XML.SubElement(parent, tag)
    child.text = text
    return child


def _placemark(folder: XML.Element, feature: Mapping[str, Any], ends: str, share: float) -> None:
    properties = feature["properties"]
    placemark = _add(folder, "Placemark")
    _add(placemark, "name", properties["time"])
    _add(placemark, "description", f"{properties['area_km2']:g} km² burned by then")
    span = _add(placemark, "TimeSpan")
    _add(span, "begin", properties["time"])
    if ends:
        _add(span, "end", ends)
    line = _add(_add(placemark, "Style"), "LineStyle")
    _add(line, "color", _colour(share))
    _add(line, "width", "2")
    several = _add(placemark, "MultiGeometry")
    for part in feature["geometry"]["coordinates"]:
        string = _add(several, "LineString")
        _add(string, "tessellate", "1")
        _add(string, "coordinates", " ".join(f"{lon:.6f},{lat:.6f}" for lon, lat in part))


def isochrone_kml(
    features: Sequence[Mapping[str, Any]], names: Mapping[str, str], attributes: Mapping[str, Any]
) -> str:
    """KML text of isochrone features (properties `incident_id`, `time`, `area_km2`), a folder per incident.

    Each isochrone is shown from its time until the next one; the last has no end. `names` gives incidents' titles.
    """
    root = XML.Element("kml", xmlns=NAMESPACE)
    document = _add(root, "Document")
    _add(document, "name", "Fire arrival time")
    _add(document, "description", "; ".join(f"{key}: {attributes[key]}" for key in sorted(attributes)))
    incidents = list(dict.fromkeys(feature["properties"]["incident_id"] for feature in features))
    for incident in incidents:
        own = [feature for feature in features if feature["properties"]["incident_id"] == incident]
        own.sort(key=lambda feature: pd.Timestamp(feature["properties"]["time"]))
        folder = _add(document, "Folder")
        _add(folder, "name", names.get(incident, incident))
        for index, feature in enumerate(own):
            ends = own[index + 1]["properties"]["time"] if index + 1 < len(own) else ""
            _placemark(folder, feature, ends, index / max(len(own) - 1, 1))
    XML.indent(root, " ")
    return XML.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
