"""companion.core.agent in formation, for many vehicles: telemetry and packets of a group -> its attitude targets.

Its setpoint and output limits are here too: acceleration -> limited targets. Yaw stays at its initial value.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import radians, tan

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.types.values import GRAVITY_M_S2
from sitl.autopilots.autopilot import DT_S
from sitl.autopilots.types import hover_thrust_norm
from sitl.batch.bodies import quaternion_of_euler
from sitl.batch.columns import BoolArray, Columns, IntArray
from sitl.batch.filter import BatchFilter, KeptOffSlots
from sitl.batch.laws import BatchLaws, Known
from sitl.batch.observers import DisturbanceObservers, VelocityCorrections, limited
from sitl.batch.packets import (
    ACCELERATION,
    PRC,
    REDUCED_POSITION,
    SLOT,
    STATE,
    VALUES,
    VELOCITY,
    Candidates,
    Packets,
    ReceivedPackets,
)
from sitl.batch.references import References
from sitl.flight.lockstep import TELEMETRY_STEPS
from sitl.flight.scenario import Scenario


class Agents:
    """All agents of a batch. `telemetry` (9, k) holds position, velocity, roll, pitch, yaw of FLU in ENU."""

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        columns: Columns,
        laws: BatchLaws,
        slot_enu_m: FloatArray,
        references: References,
        candidates: Candidates,
        telemetry: FloatArray,
    ) -> None:
        self._columns = columns
        self._laws = laws
        self._references = references
        self._candidates = candidates
        self._observers = DisturbanceObservers(scenarios, columns)
        self._corrections = VelocityCorrections(scenarios, columns)
        self._commands = AttitudeCommands(scenarios, columns, DT_S * TELEMETRY_STEPS, self._observers.hover_norm)
        self._commands.open_at(telemetry[6:9])
        self._altitude = AltitudeHold(scenarios, columns, telemetry[2])
        self._commanded_enu_m_s2 = np.zeros((3, columns.count))
        self._slot_enu_m = slot_enu_m
        slots = slot_enu_m.T
        self._slots_apart_m = slots[candidates.sender] - slots[:, None, :] if candidates.by_range else np.zeros(0)
        packets = np.zeros((VALUES + 3 * laws.values, columns.count))
        packets[REDUCED_POSITION], packets[VELOCITY] = telemetry[:3] - slot_enu_m, telemetry[3:6]
        packets[SLOT] = slot_enu_m
        self._members = self._first_members(packets)
        packets[PRC] = self._first_prcs()
        self._packets = Packets(scenarios, columns, candidates, packets)
        if laws.values:
            self._publish_first(packets)
        self._filter = BatchFilter(scenarios, columns, slot_enu_m, telemetry)
        self._kept_off = KeptOffSlots(scenarios, columns)

    def targets(self, group: slice) -> FloatArray:
        """The last commanded targets: (5, G) quaternion and thrust."""
        return self._commands.targets(group)

    def decide(self, tick: int, phase: int, reference_s: float, telemetry: FloatArray) -> FloatArray:
        """One tick of the agents of this phase, at `reference_s` of the RFT: (5, G) quaternion and thrust."""
        group, laws = self._columns.groups[phase], self._laws
        self._corrections.follow(tick, group, telemetry)
        self._observers.update(tick, group, telemetry, self._commands.thrust_norm(group))
        own = telemetry[:6].copy()
        own[:3] -= self._slot_enu_m[:, group]
        used = self._from_neighbours(group, own[:3], self._packets.receive(tick, group))
        prcs = self._next_prcs(self._packets.prcs(used.indices), used.fresh, group)
        known = self._known(group, own, used, self._references.at(phase, reference_s))
        wanted = laws.accelerations(known)
        self._altitude.hold(wanted, telemetry, group)
        disturbance = self._observers.disturbance_enu_m_s2[:, group]
        acceleration = self._commands.possible(wanted, disturbance, group)
        changed = self._filter.step(tick, group, telemetry, wanted, acceleration, disturbance)
        if (places := changed.places).size:
            acceleration[:, places] = self._commands.possible(
                changed.acceleration_enu_m_s2, disturbance[:, places], group.start + places
            )
        self._commanded_enu_m_s2[:, group] = acceleration
        self._filter.send(tick, group, telemetry, acceleration)
        sent = np.empty((VALUES + 3 * laws.values, prcs.size))
        sent[:6], sent[ACCELERATION], sent[PRC], sent[SLOT] = own, acceleration, prcs, self._slot_enu_m[:, group]
        kept_off, rft = self._kept_off.published(tick, group, changed, own, lambda place: laws.target(known, place))
        sent[STATE, kept_off] = rft
        sent[VALUES:] = laws.published(known, sent[STATE])
        self._packets.send(tick, group, sent, own)
        acceleration[:2] -= disturbance
        return self._commands.admitted(acceleration, telemetry[6], telemetry[7], group)

    def commanded_m_s2(self) -> FloatArray:
        """Sizes (B n,) of the accelerations that the last commanded targets stand for."""
        return self._commands.accelerations_m_s2()

    def relation(self) -> BoolArray:
        """[b, i, j]: vehicle i uses vehicle j as a neighbour; (B, n, n), by rising ids."""
        columns, n = self._columns, self._columns.vehicles
        receiver, candidate = np.nonzero(self._members)
        sender = self._candidates.sender[receiver, candidate]
        relation = np.zeros((columns.count, n), dtype=np.bool_)
        relation[columns.order[receiver], columns.order[sender] % n] = True
        return relation.reshape(columns.formations, n, n)

    def _from_neighbours(self, group: slice, own_enu_m: FloatArray, received: ReceivedPackets) -> ReceivedPackets:
        """The packets from N_i of these vehicles. Stores N_i for the hysteresis."""
        if not self._candidates.by_range:
            self._members[group] = received.fresh
            return received
        members = self._in_range(group, own_enu_m, self._packets.reduced_positions_enu_m(received))
        members &= received.fresh
        self._members[group] = members
        return received.only(members)

    def _publish_first(self, packets: FloatArray) -> None:
        """What the laws publish after some time of hovering. `packets` (rows, B n) are those before."""
        every, fresh = slice(0, self._columns.count), self._members
        used = ReceivedPackets(self._candidates.sender, fresh, np.zeros(fresh.shape))
        references = [self._references.at(phase, 0.0) for phase in range(TELEMETRY_STEPS)]
        for _ in range(self._columns.vehicles):
            known = self._known(every, packets[:6], used, np.concatenate(references, axis=1))
            packets[VALUES:] = self._laws.published(known, packets[STATE])
            self._packets.start(packets)

    def _known(self, group: slice, own: FloatArray, used: ReceivedPackets, reference: FloatArray) -> Known:
        """What the laws of this group know; `own` (6, G) is a vehicle's position minus its slot, and its velocity."""
        if (used.fresh[:, 1:] & ~used.fresh[:, :-1]).any():
            used = used.only(used.fresh)
        state = np.concatenate([own, self._commanded_enu_m_s2[:, group]])
        return self._laws.known(group, state, used, self._packets, reference)

    def _next_prcs(self, neighbour_prcs: FloatArray, members: BoolArray, group: slice) -> FloatArray:
        """Algorithm 1: PrCs (G,) after one tick from `neighbour_prcs` and `members` (G, K)."""
        n = float(self._columns.vehicles)
        prcs = np.minimum(np.where(members, neighbour_prcs, n).min(axis=1) + 1.0, n)
        prcs[self._laws.is_leader[group]] = 1.0
        return np.asarray(prcs)

    def _in_range(self, group: slice, own_enu_m: FloatArray, others_enu_m: FloatArray) -> BoolArray:
        """`own_enu_m` (3, G), `others_enu_m` (G, K, 3): positions minus slots."""
        apart_m = others_enu_m - own_enu_m.T[:, None, :]
        apart_m += self._slots_apart_m[group]
        square_m2 = np.einsum("gkx,gkx->gk", apart_m, apart_m)
        candidates = self._candidates
        limit_m = np.where(self._members[group], candidates.leave_m[group, None], candidates.join_m[group, None])
        return np.asarray(square_m2 <= np.square(limit_m, out=limit_m))

    def _first_members(self, packets: FloatArray) -> BoolArray:
        """N_i (B n, K) after some time of hovering with fresh packets."""
        all_columns = slice(0, self._columns.count)
        self._members = np.zeros(self._candidates.valid.shape, dtype=np.bool_)
        if not self._candidates.by_range:
            return self._candidates.valid.copy()
        own = packets[REDUCED_POSITION]
        return np.asarray(self._in_range(all_columns, own, own.T[self._candidates.sender]) & self._candidates.valid)

    def _first_prcs(self) -> FloatArray:
        """PrCs (B n,) to which Algorithm 1 converges with the first neighbours."""
        all_columns, n = slice(0, self._columns.count), self._columns.vehicles
        prcs = np.full(self._columns.count, float(n))
        for _ in range(n):
            prcs = self._next_prcs(prcs[self._candidates.sender], self._members, all_columns)
        return prcs


class AltitudeHold:
    """The vehicles that hold their first altitude, whatever the law wants."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns, altitude_m: FloatArray) -> None:
        laws = [scenario.fleet.law for scenario in scenarios]
        self._altitude_m = altitude_m.copy()
        self._holds = columns.spread([float(law.altitude == "hold") for law in laws]) > 0.0
        self._k1 = columns.spread([law.altitude_hold_gains.position_1_s2 for law in laws])
        self._k2 = columns.spread([law.altitude_hold_gains.velocity_1_s for law in laws])

    def hold(self, acceleration: FloatArray, telemetry: FloatArray, group: slice) -> None:
        """`feedback` of companion.core.consensus.law on z of (3, G), in place."""
        holds = self._holds[group]
        if holds.any():
            climb_m = telemetry[2] - self._altitude_m[group]
            vertical = -self._k1[group] * climb_m - self._k2[group] * telemetry[5]
            np.copyto(acceleration[2], vertical, where=holds)


class AttitudeCommands:
    """The last admitted roll, pitch and thrust of all columns. Yaw stays at its initial value.

    The output limits see no gaps here: every vehicle ticks once in a period.
    """

    def __init__(
        self, scenarios: Sequence[Scenario], columns: Columns, period_s: float, hover_norm: FloatArray
    ) -> None:
        """`hover_norm` (B n,) are the estimates, which change in place."""
        envelopes = [scenario.fleet.envelope for scenario in scenarios]
        tilt_rad = columns.spread([radians(e.max_tilt_deg) for e in envelopes])
        self._least = columns.spread([e.min_thrust_ratio for e in envelopes])
        self._most = columns.spread([e.max_thrust_ratio for e in envelopes])
        self._hover_norm = hover_norm
        self._true_hover_norm = columns.spread([hover_thrust_norm(scenario.stand_in) for scenario in scenarios])
        self._max_tilt_rad = tilt_rad
        self._tan_tilt = columns.spread([tan(radians(e.max_tilt_deg)) for e in envelopes])
        self._least_lift, self._most_lift = self._least * GRAVITY_M_S2, self._most * GRAVITY_M_S2
        turn_rad = columns.spread([radians(e.max_tilt_rate_deg_s) * period_s for e in envelopes])
        self._most_turn_rad = np.stack([turn_rad, turn_rad])
        self._most_change = columns.spread([e.max_thrust_rate_1_s * period_s for e in envelopes])  # of the hover thrust
        self._yaw_rad = self._cos_yaw = self._sin_yaw = np.zeros(columns.count)
        self._last = np.zeros((3, columns.count))

    def open_at(self, euler_rad: FloatArray) -> None:
        """Start from the estimated attitudes (3, B n)."""
        self._yaw_rad = euler_rad[2].copy()
        self._cos_yaw, self._sin_yaw = np.cos(self._yaw_rad), np.sin(self._yaw_rad)
        share = np.maximum(0.5, np.cos(euler_rad[0]) * np.cos(euler_rad[1]))
        all_columns = slice(0, self._yaw_rad.size)
        self._last = self._within_limits(np.stack([euler_rad[0], euler_rad[1], self._hover_norm / share]), all_columns)

    def limit(self, acceleration: FloatArray, group: slice | IntArray) -> None:
        """limit_acceleration on (3, G), in place, of a group or of these columns."""
        lift = np.maximum(acceleration[2] + GRAVITY_M_S2, self._least_lift[group])
        np.minimum(lift, self._most_lift[group], out=lift)
        level = np.hypot(acceleration[0], acceleration[1])
        most = lift * self._tan_tilt[group]
        acceleration[:2] *= most / np.maximum(level, most)
        np.subtract(lift, GRAVITY_M_S2, out=acceleration[2])

    def possible(
        self, wanted_enu_m_s2: FloatArray, disturbance_enu_m_s2: FloatArray, group: slice | IntArray
    ) -> FloatArray:
        """What tilt and thrust allow of these accelerations (3, G) against the horizontal disturbances (2, G)."""
        acceleration = wanted_enu_m_s2.copy()
        acceleration[:2] -= disturbance_enu_m_s2
        self.limit(acceleration, group)
        acceleration[:2] += disturbance_enu_m_s2
        return acceleration

    def thrust_norm(self, group: slice) -> FloatArray:
        """The last admitted thrust (G,)."""
        return self._last[2, group]

    def admitted(
        self, acceleration: FloatArray, roll_rad: FloatArray, pitch_rad: FloatArray, group: slice
    ) -> FloatArray:
        """attitude_target and OutputLimiter.admit: (5, G) quaternion and thrust.

        Repeats the last targets of a vehicle that is tilted by more than 90 degrees.
        """
        lift = acceleration[2] + GRAVITY_M_S2
        vertical_share = np.cos(pitch_rad) * np.cos(roll_rad)
        flies = vertical_share > 0.0
        ax, ay = acceleration[:2] / lift
        cos_yaw, sin_yaw = self._cos_yaw[group], self._sin_yaw[group]
        wanted = np.empty((3, lift.size))
        np.arctan(ax * cos_yaw + ay * sin_yaw, out=wanted[1])
        np.arctan(np.cos(wanted[1]) * (ax * sin_yaw - ay * cos_yaw), out=wanted[0])
        np.divide(self._hover_norm[group] * lift, GRAVITY_M_S2 * np.where(flies, vertical_share, 1.0), out=wanted[2])
        last, most_rad = self._last[:, group], self._most_turn_rad[:, group]
        most_norm = self._most_change[group] * self._hover_norm[group]
        change = self._within_limits(wanted, group) - last
        limited(change[:2], most_rad)
        limited(change[2], most_norm)
        change *= flies
        last += change
        last[:] = self._within_limits(last, group)
        return self.targets(group)

    def targets(self, group: slice) -> FloatArray:
        """The last admitted targets: (5, G) quaternion (FLU to ENU) and thrust in 0..1."""
        roll, pitch, thrust = self._last[:, group]
        targets = np.empty((5, thrust.size))
        targets[:4], targets[4] = quaternion_of_euler(roll, pitch, self._yaw_rad[group]), thrust
        return targets

    def accelerations_m_s2(self) -> FloatArray:
        """Of the last admitted targets: the sizes (B n,) of thrust per mass and gravity together."""
        roll, pitch, thrust = self._last
        return commanded_m_s2(roll, pitch, thrust / self._true_hover_norm)

    def _within_limits(self, targets: FloatArray, group: slice) -> FloatArray:
        within, most, hover_norm = np.empty_like(targets), self._max_tilt_rad[group], self._hover_norm[group]
        tilt = np.maximum(np.hypot(targets[0], targets[1]), most)
        np.multiply(targets[:2], most / tilt, out=within[:2])
        np.maximum(targets[2], hover_norm * self._least[group], out=within[2])
        np.minimum(within[2], np.minimum(1.0, hover_norm * self._most[group]), out=within[2])
        return within


def commanded_m_s2(roll_rad: FloatArray, pitch_rad: FloatArray, thrust_ratio: FloatArray) -> FloatArray:
    """The size of the acceleration that an attitude and a thrust, relative to that of hovering, stand for."""
    upright = np.cos(roll_rad) * np.cos(pitch_rad)
    square = thrust_ratio * (thrust_ratio - 2.0 * upright) + 1.0
    return np.asarray(GRAVITY_M_S2 * np.sqrt(np.maximum(square, 0.0)))
