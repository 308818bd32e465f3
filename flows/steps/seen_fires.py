"""The incidents that satellites have seen burn: the only ones of which an arrival map can say something."""

from __future__ import annotations

from pydantic import Field

from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs

REACH_KM = 15.0


class SeenFiresInputs(ProcessInputs):
    incidents: ArtifactRef = Field(description="incidents table")
    detections: ArtifactRef = Field(description="detections known at the same time")


class SeenFiresOutputs(ProcessOutputs):
    incidents: ArtifactRef
    seen: int
    unseen: int


def seen_fires(inputs: SeenFiresInputs, context: JobContext) -> SeenFiresOutputs:
    """Incidents with a fire detection within 15 km."""
    import numpy as np
    from scipy.spatial import cKDTree

    from flows.cases.nature.fields import on_sphere_km

    incidents = context.read_table(inputs.incidents, "INCIDENTS")
    looks = context.read_table(inputs.detections, "DETECTIONS")
    fires = looks[looks["fire"]].geometry.representative_point()
    places = incidents.geometry.representative_point()

    near = np.zeros(len(incidents), dtype=bool)
    if len(fires) and len(incidents):
        near = cKDTree(on_sphere_km(fires.x, fires.y)).query(on_sphere_km(places.x, places.y))[0] <= REACH_KM
    kept = incidents[near].reset_index(drop=True)
    return SeenFiresOutputs(
        incidents=context.write_table("incidents.parquet", kept, "INCIDENTS"),
        seen=int(near.sum()),
        unseen=int((~near).sum()),
    )


SEEN_FIRES = Process(
    "seen-fires",
    "Fires that satellites have seen",
    "Leaves out incidents without a fire detection nearby, where there are too many for a map of each.",
    SeenFiresInputs,
    SeenFiresOutputs,
    seen_fires,
)
