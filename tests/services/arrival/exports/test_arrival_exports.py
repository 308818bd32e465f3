"""GeoTIFF, KML, wrfxweb and ONNX of a map with a known shape."""

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
import rasterio
import torch
from PIL import Image

from services.arrival.exports.geotiff import NODATA, write_arrival_geotiff, write_sight_geotiff
from services.arrival.exports.isochrones import isochrone_features
from services.arrival.exports.kml import NAMESPACE, isochrone_kml
from services.arrival.exports.onnx_model import export_network, onnx_bytes, session
from services.arrival.exports.wrfxweb import domain_entries, manifest
from services.arrival.network import PaperNetwork
from services.arrival.paper_method import PaperField
from services.arrival.sight import BURNING, CLEAR, HIDDEN, NO_PASS, Passes, sight_of
from shared.errors import SmokeglintError
from tests.services.arrival.exports.made_maps import REFERENCE, round_fire

KML = {"k": NAMESPACE}


def test_geotiff_bands_lie_where_the_map_says(tmp_path: Path) -> None:
    made = round_fire()
    front = np.where(np.isfinite(made.arrival_h), 0.0, 0.25)
    write_arrival_geotiff(tmp_path / "a.tif", made, front, {"reference_time": "2022-06-01T18:00:00Z"})
    lon, lat = made.grid.degrees(made.grid.x_m[30], made.grid.y_m[50])
    with rasterio.open(tmp_path / "a.tif") as opened:
        assert opened.crs.to_epsg() == made.grid.epsg and opened.nodata == NODATA
        assert "front24_probability" in opened.descriptions and opened.tags()["reference_time"].endswith("Z")
        value = next(opened.sample([(made.grid.x_m[30], made.grid.y_m[50])]))
        assert value[0] == pytest.approx(made.arrival_h[50, 30] * 3600, abs=1)
        outside = next(opened.sample([(made.grid.x_m[0], made.grid.y_m[0])]))
        assert outside[0] == NODATA and outside[list(opened.descriptions).index("front24_probability")] == 0.25
    assert abs(float(lon) + 106) < 0.2 and abs(float(lat) - 33.5) < 0.2


def test_sight_tells_no_pass_cloud_no_fire_and_fire_apart(tmp_path: Path) -> None:
    made = round_fire()
    x, _ = made.grid.cell_centres_km()
    hidden = np.where(x > 9.0, 20.0, np.nan)
    sight = sight_of(made, Passes(np.full(x.shape, np.nan), hidden))
    assert set(np.unique(sight.state)) == {NO_PASS, HIDDEN, CLEAR, BURNING}
    assert (sight.state[x > 9.0] == HIDDEN).all() and (sight.state[(x > 8.0) & (x < 8.9)] == NO_PASS).all()
    assert np.nanmin(sight.age_h(24.0)) == pytest.approx(3.0)
    seen = sight_of(made, Passes(np.where(x > 8.0, 22.0, np.nan), hidden))
    assert (seen.state[x > 8.0] == CLEAR).all(), "a place seen once is not hidden by a later cloud"
    write_sight_geotiff(tmp_path / "s.tif", sight, made.grid, {})
    with rasterio.open(tmp_path / "s.tif") as opened:
        np.testing.assert_array_equal(opened.read(1)[::-1], sight.state)
        assert opened.colormap(1)[BURNING][:3] == (214, 84, 46)


def test_kml_spans_follow_one_another() -> None:
    features = isochrone_features(round_fire(), REFERENCE, "a")
    text = isochrone_kml(features, {"a": "Round & round"}, {"simulated": True})
    assert text == isochrone_kml(features, {"a": "Round & round"}, {"simulated": True})
    root = ElementTree.fromstring(text)
    places = root.findall(".//k:Placemark", KML)
    begins = [pd.Timestamp(p.findtext(".//k:begin", namespaces=KML)) for p in places]
    ends = [p.findtext(".//k:end", namespaces=KML) for p in places]
    assert len(places) == len(features) > 5 and begins == sorted(begins)
    assert [pd.Timestamp(e) for e in ends[:-1]] == begins[1:] and ends[-1] is None
    lon, lat = map(float, places[0].findtext(".//k:coordinates", namespaces=KML).split()[0].split(","))
    assert abs(lon + 106) < 0.2 and abs(lat - 33.5) < 0.2
    assert root.findtext(".//k:Folder/k:name", namespaces=KML) == "Round & round"


def test_wrfxweb_manifest_names_pictures_that_lie_where_it_says(tmp_path: Path) -> None:
    made = round_fire()
    entries = domain_entries(made, REFERENCE, "x", lambda name: tmp_path / name, {"kml": "a.kml", "tiff": "a.tif"})
    domains = json.loads(json.dumps(manifest([entries, entries])))
    assert list(domains) == ["1", "2"]
    areas = []
    for time, variables in domains["1"].items():
        assert pd.Timestamp(time).tzinfo is not None and time.endswith("Z")
        entry = variables["FIRE_AREA"]
        with Image.open(tmp_path / entry["raster"]) as picture:
            shown = np.asarray(picture) > 0
        areas.append(shown.sum())
        lon, lat = np.array(entry["coords"]).T
        row, column = np.argwhere(shown).mean(axis=0)
        assert lon[0] + (lon[1] - lon[0]) * column / shown.shape[1] == pytest.approx(-106.0, abs=0.01)
        assert lat[0] + (lat[3] - lat[0]) * row / shown.shape[0] == pytest.approx(33.5, abs=0.01)
        assert (tmp_path / entry["colorbar"]).read_bytes()[:4] == b"\x89PNG"
    assert areas == sorted(areas) and areas[-1] > 2 * areas[0]
    last = domains["1"][max(domains["1"])]["TIGN_G"]
    assert last["kml"] == "a.kml" and last["tiff"] == "a.tif"


def _fitted() -> PaperField:
    """A network of the paper whose batch norms have seen data, so that export must carry them."""
    network = PaperNetwork(3)
    network.train()
    for _ in range(20):
        network(torch.randn(64, 6))
    network.eval()
    return PaperField(network, np.array([-8.0, -6.0]), np.array([9.0, 7.0]), 2.0, 100.0, 0, 1.5)


def test_onnx_gives_what_the_network_gives(tmp_path: Path) -> None:
    fitted = _fitted()
    export_network(tmp_path / "n.onnx", fitted)
    assert (tmp_path / "n.onnx").stat().st_size < 80_000
    assert (tmp_path / "n.onnx").read_bytes() == onnx_bytes(fitted), "the same network gives the same bytes"
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-6, 6, (2, 257))
    place = np.column_stack([x, y]).astype(np.float32)
    source = np.zeros((257, 4), np.float32)
    source[:, 0] = 1.0
    hours, probability = session(tmp_path / "n.onnx").run(None, {"place_km": place, "source": source})
    expected = fitted.at(x, y)
    np.testing.assert_allclose(hours, expected[0][0], atol=1e-3)
    np.testing.assert_allclose(probability, expected[1][0], atol=1e-5)


def test_an_export_that_differs_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from services.arrival.exports import onnx_model

    other = onnx_bytes(PaperField(PaperNetwork(4), np.zeros(2) - 5, np.zeros(2) + 5, 0.0, 50.0, 0, 0.0))
    monkeypatch.setattr(onnx_model, "onnx_bytes", lambda fitted: other)
    with pytest.raises(SmokeglintError):
        export_network(tmp_path / "n.onnx", _fitted())
    assert not (tmp_path / "n.onnx").exists()
