"""What of a plan reaches which satellite, and when: the record of the uplink."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import AwareDatetime, Field

from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs

if TYPE_CHECKING:
    import pandas as pd


class UplinkInputs(ProcessInputs):
    schedule: ArtifactRef = Field(description="schedule to bring up")
    contacts: ArtifactRef = Field(description="station contacts")
    release: AwareDatetime = Field(description="when the plan is ready to go")
    approved_by: str = Field(min_length=1, description="who approved the plan; 'setting' where nobody had to")
    approved_at: AwareDatetime = Field(description="when it was approved")


class UplinkOutputs(ProcessOutputs):
    uplinks: ArtifactRef
    satellites_reached: int
    new_commands: int
    commands_still_in_force: int


def uplink(inputs: UplinkInputs, context: JobContext) -> UplinkOutputs:
    """Each satellite's first contact after release, and how many of its commands are new or still the old plan's."""
    schedule = context.read_table(inputs.schedule, "SCHEDULE")
    contacts = context.read_table(inputs.contacts, "CONTACTS")
    records = uplink_records(schedule, contacts, inputs.release)
    reached = [record for record in records if record["contact_start"]]
    return UplinkOutputs(
        uplinks=context.write_json("uplinks.json", {**_decided(inputs), "satellites": records}),
        satellites_reached=len(reached),
        new_commands=sum(record["new_commands"] for record in records),
        commands_still_in_force=sum(record["commands_still_in_force"] for record in records),
    )


def _decided(inputs: UplinkInputs) -> dict[str, str]:
    times = {"release": inputs.release.isoformat(), "approved_at": inputs.approved_at.isoformat()}
    return {**times, "approved_by": inputs.approved_by}


def uplink_records(schedule: pd.DataFrame, contacts: pd.DataFrame, release: Any) -> list[dict[str, Any]]:
    """One record a satellite: its first contact that starts after release, and its commands before and from then on."""
    import pandas as pd

    records = []
    for satellite in sorted(set(schedule["satellite"]) | set(contacts["satellite"])):
        passes = contacts[(contacts["satellite"] == satellite) & (contacts["start"] >= pd.Timestamp(release))]
        first = passes.sort_values("start").iloc[0] if len(passes) else None
        own = schedule[schedule["satellite"] == satellite]
        new = own["uplink_contact"] >= pd.Timestamp(release)
        records.append(
            {
                "satellite": satellite,
                "station": first["station"] if first is not None else None,
                "contact_start": first["start"].isoformat() if first is not None else None,
                "new_commands": int(new.sum()),
                "commands_still_in_force": int((~new).sum()),
            }
        )
    return records


UPLINK = Process(
    "uplink", "Uplink the plan", "Records what reaches which satellite.", UplinkInputs, UplinkOutputs, uplink
)
