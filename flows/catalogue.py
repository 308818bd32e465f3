"""The static STAC catalogue of a case: an item for each finished step, linked along its lineage."""

from __future__ import annotations

import json
import posixpath
import shutil
from collections.abc import Iterable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import pystac

from flows.root import ArtifactRoot, named_root, work_folder
from shared.artifacts.manifest import Manifest
from shared.artifacts.roots import is_local, open_root
from shared.artifacts.store import ArtifactStore

PROCESSING = "https://stac-extensions.github.io/processing/v1.2.0/schema.json"
FILE = "https://stac-extensions.github.io/file/v2.1.0/schema.json"
FOLDER, CATALOGUE = "catalogue", "catalog.json"


def write_catalogue(
    store: ArtifactStore,
    root: ArtifactRoot,
    case: str,
    title: str,
    region: tuple[float, float, float, float],
    times: Mapping[str, datetime],
    made: Iterable[Mapping[str, Any]],
) -> str:
    """Write ``{root}/{case}/catalogue/catalog.json`` over the steps whose outputs are in ``made``; where that is.

    ``times`` gives each cycle's time (UTC). Links are relative; a folder is replaced as a whole.
    """
    wanted = _folders(made)
    manifests = {_folder(m): m for m in store.manifests(case) if _folder(m) in wanted}
    catalogue = pystac.Catalog(id=case, description=f"{title}. Every product of the loop, with its lineage.")
    items = {folder: _item(manifest, region, times) for folder, manifest in manifests.items()}
    for folder, item in items.items():
        _link_lineage(item, manifests[folder], items)
    for cycle in sorted({manifest.cycle for manifest in manifests.values()}):
        part = pystac.Catalog(id=f"{case}-{cycle}", description=f"Products of {cycle}.")
        part.add_items(items[folder] for folder in sorted(items) if manifests[folder].cycle == cycle)
        catalogue.add_child(part)
    here = work_folder(root)  # links are relative, so it can be written here for a root that lies elsewhere
    final, fresh = here / case / FOLDER, here / case / f".{FOLDER}"
    shutil.rmtree(fresh, ignore_errors=True)
    catalogue.normalize_hrefs(str(final))
    _add_assets(items, manifests, here)
    catalogue.save(pystac.CatalogType.SELF_CONTAINED, dest_href=str(fresh))
    if not is_local(named_root(root)):
        return _upload(fresh, f"{named_root(root)}/{case}/{FOLDER}")
    shutil.rmtree(final, ignore_errors=True)
    fresh.rename(final)
    return str(final / CATALOGUE)


def _upload(folder: Path, url: str) -> str:
    """Put a catalogue in the place of another on a remote store, its first page last; then remove what is left over."""
    fs, base = open_root(url)
    before = set(fs.find(base))
    pages = sorted((path for path in folder.rglob("*.json")), key=lambda path: path == folder / CATALOGUE)
    placed = {f"{base}/{path.relative_to(folder).as_posix()}": path for path in pages}
    for target, path in placed.items():
        fs.pipe_file(target, path.read_bytes())
    if left_over := sorted(before - set(placed)):
        fs.rm(left_over)
    shutil.rmtree(folder)
    return f"{url}/{CATALOGUE}"


def _folders(made: Iterable[Mapping[str, Any]]) -> set[str]:
    """The ``case/cycle/step/key`` folders of every reference among outputs."""
    found: set[str] = set()

    def visit(value: Any) -> None:
        if isinstance(value, Mapping):
            if "href" in value and "sha256" in value:
                found.add("/".join(str(value["href"]).split("/")[-5:-1]))
            else:
                for item in value.values():
                    visit(item)
        elif isinstance(value, list | tuple):
            for item in value:
                visit(item)

    visit(list(made))
    return found


def _folder(manifest: Manifest) -> str:
    return posixpath.join(manifest.case, manifest.cycle, manifest.product.process, manifest.key)


def _item(manifest: Manifest, region: tuple[float, float, float, float], times: Mapping[str, datetime]) -> pystac.Item:
    west, south, east, north = region
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    product = manifest.product
    return pystac.Item(
        id=f"{manifest.cycle}-{product.process}-{manifest.key[:8]}",
        geometry={"type": "Polygon", "coordinates": [ring]},
        bbox=list(region),
        datetime=times[manifest.cycle],
        properties={
            "title": f"{product.process}, {manifest.cycle}",
            "processing:software": {"smokeglint": product.code_version},
            "processing:lineage": f"{product.process} with {json.dumps(manifest.parameters, sort_keys=True)}",
            "smokeglint:simulated": product.simulated,
            "smokeglint:simulated_share": product.simulated_share,
            "smokeglint:oldest_input": product.oldest_input,
            "smokeglint:model_version": product.model_version,
            "smokeglint:key": manifest.key,
        },
        stac_extensions=[PROCESSING, FILE],
    )


def _link_lineage(item: pystac.Item, manifest: Manifest, items: Mapping[str, pystac.Item]) -> None:
    """A ``derived_from`` link to the item of each input."""
    sources = {posixpath.dirname(entry.href) for entry in manifest.inputs}
    for folder in sorted(sources):
        if folder in items:
            item.add_link(pystac.Link(pystac.RelType.DERIVED_FROM, items[folder], "application/geo+json"))


def _add_assets(items: Mapping[str, pystac.Item], manifests: Mapping[str, Manifest], root: Path) -> None:
    """Each file as an asset, relative to where the item lies."""
    for folder, item in items.items():
        for name, entry in manifests[folder].files.items():
            role = "thumbnail" if name.endswith(".png") else "metadata" if name.endswith(".json") else "data"
            extra = {"file:size": entry.size, "file:checksum": "1220" + entry.sha256}  # multihash: sha2-256, 32 bytes
            if entry.source:
                extra["description"] = entry.source
            href = str(root / folder / name)
            asset = pystac.Asset(href=href, media_type=entry.type, roles=[role], extra_fields=extra)
            item.add_asset(name, asset)
        item.make_asset_hrefs_relative()
