"""Which acceleration a phase wants: eq. 14 in formation, braking and keeping the altitude on the way out of it."""

from __future__ import annotations

from collections.abc import Sequence

from companion.core.formation import FormationLaw, Gains, Place, feedback, formation_acceleration, place
from companion.types import FlownSlot, Vector3, VehicleState


class FormationControl:
    """One vehicle's. Where `law_flies_altitude` is False it holds its own altitude, the one it came into formation with."""

    def __init__(self, law: FormationLaw, law_flies_altitude: bool, altitude_hold_gains: Gains) -> None:
        self._law = law
        self._law_flies_altitude = law_flies_altitude
        self._altitude_hold_gains = altitude_hold_gains
        self._hold_altitude_m = 0.0

    def stand_by(self, vehicle: VehicleState) -> None:
        """Formation is about to begin: the altitude held is where the vehicle is now."""
        self._hold_altitude_m = vehicle.position_enu_m[2]

    def in_formation(
        self,
        vehicle: VehicleState,
        neighbours: Sequence[tuple[int, Place]],
        slot: FlownSlot,
        reference: Place | None,
    ) -> Vector3:
        """Eq. 14 about a slot that may move, or on z the vehicle's own altitude hold; m/s^2 in ENU.

        `neighbours` are (PrC, place); `reference` is R where this vehicle leads.
        """
        own = place(vehicle.position_enu_m, vehicle.velocity_enu_m_s, slot)
        x, y, z = formation_acceleration(self._law, own, neighbours, reference)
        dx, dy, dz = slot.acceleration_enu_m_s2
        wanted = (x + dx, y + dy, z + dz)
        if self._law_flies_altitude:
            self._hold_altitude_m = vehicle.position_enu_m[2]  # where a hand-over begins
            return wanted
        return (wanted[0], wanted[1], self.braking(vehicle)[2])

    def level(self, vehicle: VehicleState) -> Vector3:
        """No acceleration over ground, and back to the altitude held; m/s^2 in ENU."""
        return (0.0, 0.0, self.braking(vehicle)[2])

    def braking(self, vehicle: VehicleState) -> Vector3:
        """Against the velocity, and back to the altitude held; m/s^2 in ENU."""
        climb_m = vehicle.position_enu_m[2] - self._hold_altitude_m
        return feedback(self._altitude_hold_gains, (0.0, 0.0, climb_m), vehicle.velocity_enu_m_s)
