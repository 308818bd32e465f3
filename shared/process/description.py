"""Process descriptions as OGC API – Processes wants them, made from the pydantic models."""

from __future__ import annotations

import functools
from typing import Any

from pydantic import BaseModel

from shared.process.declaration import Process
from shared.versions import RELEASE

CONFORMANCE = [
    "http://www.opengis.net/spec/ogcapi-processes-1/1.0/conf/core",
    "http://www.opengis.net/spec/ogcapi-processes-1/1.0/conf/ogc-process-description",
    "http://www.opengis.net/spec/ogcapi-processes-1/1.0/conf/json",
    "http://www.opengis.net/spec/ogcapi-processes-1/1.0/conf/oas30",
    "http://www.opengis.net/spec/ogcapi-processes-1/1.0/conf/job-list",
    "http://www.opengis.net/spec/ogcapi-processes-1/1.0/conf/dismiss",
]


def summary(process: Process, base: str) -> dict[str, Any]:
    """The entry of a process in the list of processes."""
    return {
        "id": process.id,
        "title": process.title,
        "description": process.description,
        "version": RELEASE,
        "jobControlOptions": ["sync-execute", "async-execute", "dismiss"],
        "outputTransmission": ["value", "reference"],
        "links": [_link(f"{base}/processes/{process.id}", "self", "application/json", "process description")],
    }


def description(process: Process, base: str) -> dict[str, Any]:
    """The whole description: the summary, and a schema for each input and output."""
    execute = f"{base}/processes/{process.id}/execution"
    entry = summary(process, base)
    relation = "http://www.opengis.net/def/rel/ogc/1.0/execute"
    entry["links"].append(_link(execute, relation, "application/json", "execution"))
    entry["inputs"] = _members(process.inputs, is_input=True)
    entry["outputs"] = _members(process.outputs, is_input=False)
    return entry


@functools.cache
def _members(model: type[BaseModel], *, is_input: bool) -> dict[str, Any]:
    schema = model.model_json_schema(mode="validation" if is_input else "serialization")
    definitions = schema.get("$defs", {})
    required = set(schema.get("required", []))
    members = {}
    for name, member in schema.get("properties", {}).items():
        resolved = _inline(member, definitions)
        entry = {"title": resolved.pop("title", name), "schema": resolved}
        if "description" in resolved:
            entry["description"] = resolved.pop("description")
        if is_input:
            entry["minOccurs"] = 1 if name in required else 0
            entry["maxOccurs"] = 1
        members[name] = entry
    return members


def _inline(schema: Any, definitions: dict[str, Any]) -> Any:
    """The schema with its ``$ref`` replaced by what they point to: clients read each member by itself."""
    if isinstance(schema, list):
        return [_inline(item, definitions) for item in schema]
    if not isinstance(schema, dict):
        return schema
    if "$ref" in schema:
        target = definitions[schema["$ref"].rsplit("/", 1)[-1]]
        own = {key: value for key, value in schema.items() if key != "$ref"}
        return _inline({**target, **own}, definitions)
    return {key: _inline(value, definitions) for key, value in schema.items()}


def _link(href: str, rel: str, media: str, title: str) -> dict[str, str]:
    return {"href": href, "rel": rel, "type": media, "title": title}
