"""What a satellite can store, downlink and power: the spacecraft document."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, model_validator


class UnavailableWindow(BaseModel):
    """A half-open span in which a satellite takes no command."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    start: AwareDatetime
    end: AwareDatetime

    @model_validator(mode="after")
    def _lasts(self) -> UnavailableWindow:
        if self.end <= self.start:
            raise ValueError(f"an unavailable window must end after it starts: {self.start} to {self.end}")
        return self


class SatelliteState(BaseModel):
    """What differs from satellite to satellite at the start of the horizon."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    stored_images_initial: int | None = Field(default=None, ge=0, description="images in storage at horizon_start")
    battery_initial_wh: float | None = Field(default=None, ge=0, description="battery charge at horizon_start, Wh")
    unavailable: tuple[UnavailableWindow, ...] = ()
    uplink_margin_s: int | None = Field(
        default=None, ge=0, description="from the end of a contact to the first new command, s"
    )
    pointing_initial: str | None = Field(default=None, description="pointing at horizon_start; null: any")


class Spacecraft(BaseModel):
    """The fleet's common model, with per-satellite exceptions under ``satellites``."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    storage_images: int = Field(ge=1, description="images that storage holds")
    downlink_s_per_image: int = Field(ge=1, description="contact seconds that one image takes")
    battery_capacity_wh: float = Field(gt=0, description="Wh")
    battery_min_wh: float = Field(ge=0, description="floor that the charge never goes below, Wh")
    battery_initial_wh: float = Field(ge=0, description="charge at horizon_start, Wh")
    generation_w: float = Field(ge=0, description="solar power outside umbra, W")
    nominal_w: float = Field(ge=0, description="power always drawn, W")
    collect_w: float = Field(ge=0, description="power on top while collecting, W")
    downlink_w: float = Field(ge=0, description="power on top while downlinking, W")
    horizon_start: AwareDatetime
    horizon_s: int = Field(ge=0, description="length of the horizon, s")
    uplink_margin_s: int = Field(0, ge=0, description="from the end of a contact to the first new command, s")
    slew: dict[str, dict[str, Annotated[int, Field(ge=0)]]] | None = Field(
        None, description="seconds to turn from one pointing (outer key) to another; needed where opportunities differ"
    )
    satellites: dict[str, SatelliteState] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _without_product(cls, values: Any) -> Any:
        """A document that a step wrote also says what made it; that is no part of the spacecraft."""
        return (
            {name: value for name, value in values.items() if name != "product"} if isinstance(values, dict) else values
        )

    @model_validator(mode="after")
    def _charge_fits(self) -> Spacecraft:
        if not self.battery_min_wh <= self.battery_initial_wh <= self.battery_capacity_wh:
            raise ValueError(
                f"battery_initial_wh {self.battery_initial_wh} must lie between battery_min_wh {self.battery_min_wh} "
                f"and battery_capacity_wh {self.battery_capacity_wh}"
            )
        return self

    def for_satellite(self, satellite: str) -> SatelliteState:
        """The state of one satellite, the fleet's values filled in where it has none of its own."""
        own = self.satellites.get(satellite, SatelliteState())
        return SatelliteState(
            stored_images_initial=own.stored_images_initial or 0,
            battery_initial_wh=self.battery_initial_wh if own.battery_initial_wh is None else own.battery_initial_wh,
            unavailable=own.unavailable,
            uplink_margin_s=self.uplink_margin_s if own.uplink_margin_s is None else own.uplink_margin_s,
            pointing_initial=own.pointing_initial,
        )

    def at_horizon(self, changes: dict[str, Any]) -> Spacecraft:
        """A checked copy with some fields replaced."""
        return Spacecraft.model_validate({**self.model_dump(), **changes})
