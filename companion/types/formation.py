"""Slots, headings, references and leader beacons as vehicles exchange them."""

from __future__ import annotations

from dataclasses import dataclass

from msgspec import Struct

from companion.types.values import (
    ZERO3,
    ChangeDuration,
    Finite,
    FiniteVector,
    MissionTime,
    Number,
    SlotsOfAll,
    Vector3,
    VehicleId,
    VehicleIds,
)

# (epoch, minus the rank of the claim). The larger term is the newer leadership; a commanded leadership
# is above a claimed one of the same epoch.
Term = tuple[int, int]


class Heading(Struct, frozen=True, gc=False):
    """Direction of the formation frame's x axis, from -pi to pi (0 east, pi/2 north), and its rotation."""

    angle_rad: Finite = 0.0
    rate_rad_s: Finite = 0.0
    acceleration_rad_s2: Finite = 0.0


EAST = Heading()


class LeaderBeacon(Struct, frozen=True, gc=False):
    """Newest state of the leader that a vehicle has received, relayed hop by hop with the PrC.

    Only the leader increments `stamp` (milliseconds of its own clock), so a relayed beacon never
    becomes younger. `epoch` counts the changes of the leader. `reference_s` is the mission time at
    the time of the packet, 0 if the leader does not fly the reference; `heading` is the heading of
    the formation at that time. `claim` is 0 for a commanded or configured leader, and the rank, from
    1, of a successor that replaced a lost leader.
    """

    leader_id: VehicleId
    epoch: Number
    stamp: Number
    reference_s: Finite = 0.0
    claim: Number = 0
    heading: Heading = EAST

    @property
    def term(self) -> Term:
        return (self.epoch, -self.claim)


class FlownSlot(Struct, frozen=True, gc=False):
    """A vehicle's slot d_i0 relative to the RFT at present, and its motion.

    `formation` is the number of the commanded formation, 0 for the configured one. `waiting` is the
    number of the pending formation, or the same number. `moves_for_s` is how long a formation change,
    an entry into formation or gap filling still lasts; a rotation of the formation does not count.
    The motion until then is the quintic that ends at rest in the slot of the formation.
    """

    position_enu_m: FiniteVector
    velocity_enu_m_s: FiniteVector = ZERO3
    acceleration_enu_m_s2: FiniteVector = ZERO3
    formation: Number = 0
    waiting: Number = 0
    moves_for_s: ChangeDuration = 0.0

    @property
    def moves(self) -> bool:
        """Whether the slot moves relative to the RFT, other than by a rotation."""
        return self.moves_for_s > 0.0


@dataclass(frozen=True, slots=True)
class Gains:
    """K = [k1, k2]: k1 on position [1/s^2], k2 on velocity [1/s]."""

    position_1_s2: float
    velocity_1_s: float


PAPER_GAINS = Gains(1.39, 1.2)  # K of section 5.1.1


class FormationState(Struct, frozen=True, gc=False):
    """State of a vehicle minus that of its slot: x - d_i0, velocity and last commanded acceleration, ENU.

    In perfect formation the formation states of all vehicles equal R of the RFT.
    """

    position_enu_m: Vector3
    velocity_enu_m_s: Vector3
    acceleration_enu_m_s2: Vector3 = ZERO3


class HeldReference(Struct, frozen=True, gc=False):
    """Numbers of the flown and the pending reference of a vehicle that may lead.

    The configured reference has number 0. `begun_s` is the mission time at which the flown reference
    began.
    """

    flown: Number = 0
    waiting: Number = 0  # the same as `flown` if none is pending
    begun_s: Finite = 0.0


class FormationChange(Struct, frozen=True, gc=False, tag=True):
    """New slots d_i0 for every vehicle of the fleet, from the mission time `begins_s` on.

    The slots of `absent` vehicles are empty, so their paths may cross the others'. The change begins
    only while these vehicles are absent.
    """

    number: Number
    slots_enu_m: SlotsOfAll
    begins_s: MissionTime
    lasts_s: ChangeDuration
    absent: VehicleIds = ()
