"""Whether the positions and velocities that a vehicle sends agree with each other, and whether it is believed at all.

The problem. Each packet alone may be plausible, and all of them together not: true positions with a velocity of 12 m/s to and
fro, or a position that jumps by 3 m each second. The law and the separation filter extrapolate by these numbers, so either one
moves the vehicles around.

The model. What is left of a step of the position after the mean of both velocities is summed up, forgotten within FORGOTTEN_S:
where the position has gone without a velocity. A constant error of the velocity of 1.5 m/s reaches OFF_M. What is left of a
change of the velocity after what a vehicle can accelerate is summed up likewise, without direction. Both sums are bounded, so
that one jump, as of an estimator that corrects itself, is forgotten within 0.35 s. A vehicle that is off for IN_DOUBT_S in all
contradicts itself; one second in which it agrees makes good for RECOVERS seconds.

In formation a vehicle says which acceleration it commands, and laws feed it forward. What is left of a change of the velocity
after this acceleration, with the lag of the attitude, is summed up with its direction and forgotten within UNFLOWN_S: 4.5
m/s^2 that are not flown are off after 1.4 s, and 3 m/s^2 never.

Honest vehicles stay below. A real PX4 that evaded a vehicle in hold flew 2.3 m/s less than it commanded, in gusts with the
noise of a stock EKF2 or with a wrong mass it was 1.3 m/s. The velocity is off by 0.4 m/s, agents smooth the jumps of their own
position (`estimation/corrections.py`), and steps are taken over the times of the positions, so delays and lost packets do not
count.

What one packet says may be refused by itself: a follower that leads, a sequence that does not rise, a leader without a
signature. One such packet is a defect of the network; of one that sends little else the operator is told.
"""

from __future__ import annotations

from math import sqrt

from msgspec import Struct

from companion.core.autopilot import LAG_S
from companion.geometry.vectors import scaled
from companion.types.values import ZERO3, Vector3

FORGOTTEN_S = 0.5
OFF_M, OFF_M_S = 0.75, 1.5  # sums from which on position or velocity are off
MOST_M, MOST_M_S = 2.0 * OFF_M, 2.0 * OFF_M_S  # each sum is at most that large
NOISE_M_S = 0.3  # a velocity may change by so much at any time
BEND_M_S2 = 5.0  # two velocities may misjudge the distance between them by this times the time squared
LONGEST_STEP_S = 0.5  # the motion in a longer one is unknown
COUNTS_S = 0.1  # one state is off for so long at most: one jump over a gap is no contradiction either
COMPARED_EVERY_S, UNFLOWN_S = 0.05, 1.0
UNFLOWN_M_S = 3.3  # sum from which on the acceleration is off
IN_DOUBT_S, MOST_DOUBT_S, TRUSTED_S = 0.45, 0.65, 0.2
RECOVERS = 0.2


class Unflown(Struct, frozen=True, gc=False):
    """What was found of the accelerations: the change of velocity that they do not explain (`off_enu_m_s`).

    `flown_enu_m_s2`: what the vehicle flies by its commands up to now.
    """

    measured_s: float
    velocity_enu_m_s: Vector3
    flown_enu_m_s2: Vector3
    off_enu_m_s: Vector3 = ZERO3
    is_off: bool = False


class Coherence(Struct, frozen=True, gc=False):
    """What was found of one sender up to a state: position and velocity as sent, measured at `measured_s`.

    `off_enu_m`: where the position has gone without a velocity; `off_m_s`: changes of velocity that nothing flies. `doubt_s`:
    for how long it was off, less what it made good. `gone_enu_m`: the sum of the steps of the position, which fades within
    FORGOTTEN_S.
    """

    measured_s: float
    position_enu_m: Vector3
    velocity_enu_m_s: Vector3
    gone_enu_m: Vector3
    off_enu_m: Vector3 = ZERO3
    off_m_s: float = 0.0
    doubt_s: float = 0.0
    contradicts: bool = False
    unflown: Unflown | None = None

    @property
    def moves_enu_m_s(self) -> Vector3:
        """Velocity by the positions alone."""
        return scaled(self.gone_enu_m, 1.0 / FORGOTTEN_S)


def coherent(
    before: Coherence | None,
    measured_s: float,
    position_enu_m: Vector3,
    velocity_enu_m_s: Vector3,
    commanded_enu_m_s2: Vector3 | None,
    most_m_s2: float,
) -> Coherence:
    """What is known after a state. `most_m_s2`: the largest acceleration of this fleet.

    `commanded_enu_m_s2` is None where the vehicle flies by no command of its agent.
    """
    if before is None or measured_s - before.measured_s > LONGEST_STEP_S:
        return Coherence(measured_s, position_enu_m, velocity_enu_m_s, scaled(velocity_enu_m_s, FORGOTTEN_S))
    step_s = measured_s - before.measured_s
    if step_s < 0.0:
        step_s = 0.0
    (x, y, z), (vx, vy, vz) = position_enu_m, velocity_enu_m_s
    (x0, y0, z0), (vx0, vy0, vz0) = before.position_enu_m, before.velocity_enu_m_s
    (ox, oy, oz), half_s, left = before.off_enu_m, 0.5 * step_s, FORGOTTEN_S / (FORGOTTEN_S + step_s)
    dx, dy, dz = x - x0, y - y0, z - z0
    ox = (ox + dx - (vx + vx0) * half_s) * left
    oy = (oy + dy - (vy + vy0) * half_s) * left
    oz = (oz + dz - (vz + vz0) * half_s) * left
    off_m, limit_m = sqrt(ox * ox + oy * oy + oz * oz), OFF_M + BEND_M_S2 * step_s * step_s
    if off_m > MOST_M:
        scale = MOST_M / off_m
        ox, oy, oz = ox * scale, oy * scale, oz * scale
    ax, ay, az = vx - vx0, vy - vy0, vz - vz0
    off_m_s = before.off_m_s + sqrt(ax * ax + ay * ay + az * az) - most_m_s2 * step_s - NOISE_M_S
    off_m_s = off_m_s * left if off_m_s > 0.0 else 0.0
    if off_m_s > MOST_M_S:
        off_m_s = MOST_M_S
    unflown = None
    if commanded_enu_m_s2 is not None:
        unflown = before.unflown
        if unflown is None or measured_s - unflown.measured_s >= COMPARED_EVERY_S:
            unflown = _unflown(unflown, measured_s, velocity_enu_m_s, commanded_enu_m_s2)
    doubt_s, contradicts = before.doubt_s, False
    if off_m > limit_m or off_m_s > OFF_M_S or (unflown is not None and unflown.is_off):
        doubt_s += step_s if step_s < COUNTS_S else COUNTS_S
        if doubt_s > MOST_DOUBT_S:
            doubt_s = MOST_DOUBT_S
    elif doubt_s > 0.0:
        doubt_s = doubt_s - RECOVERS * step_s if doubt_s > RECOVERS * step_s else 0.0
    if doubt_s > TRUSTED_S:
        contradicts = before.contradicts or doubt_s > IN_DOUBT_S
    gx, gy, gz = before.gone_enu_m
    gone, off = ((gx + dx) * left, (gy + dy) * left, (gz + dz) * left), (ox, oy, oz)
    return Coherence(
        measured_s, position_enu_m, velocity_enu_m_s, gone, off, off_m_s, doubt_s, contradicts, unflown=unflown
    )


def _unflown(
    before: Unflown | None, measured_s: float, velocity_enu_m_s: Vector3, commanded_enu_m_s2: Vector3
) -> Unflown:
    """After the acceleration commanded now was flown since `before`."""
    if before is None:
        return Unflown(measured_s, velocity_enu_m_s, commanded_enu_m_s2)
    step_s = measured_s - before.measured_s
    share, left = step_s / (LAG_S + step_s), UNFLOWN_S / (UNFLOWN_S + step_s)
    (vx, vy, vz), (wx, wy, wz) = velocity_enu_m_s, before.velocity_enu_m_s
    (ax, ay, az), (ux, uy, uz), (ox, oy, oz) = before.flown_enu_m_s2, commanded_enu_m_s2, before.off_enu_m_s
    ax, ay, az = ax + share * (ux - ax), ay + share * (uy - ay), az + share * (uz - az)
    ox, oy, oz = ox + vx - wx - ax * step_s, oy + vy - wy - ay * step_s, oz + vz - wz - az * step_s
    off_m_s = sqrt(ox * ox + oy * oy + oz * oz)
    if off_m_s > 2.0 * UNFLOWN_M_S:
        left *= 2.0 * UNFLOWN_M_S / off_m_s
    off_enu_m_s, is_off = (ox * left, oy * left, oz * left), off_m_s > UNFLOWN_M_S
    return Unflown(measured_s, velocity_enu_m_s, (ax, ay, az), off_enu_m_s, is_off)


# A new leader's signature arrives and is verified sooner; followers that hear no leader leave the formation later.
LASTING_S, MOST_S = IN_DOUBT_S, 1.0


class Disbelief:
    """For how long each peer has sent what is not believed, less for how long it was. `sums` is empty while all are."""

    def __init__(self) -> None:
        self.sums: dict[int, tuple[float, float]] = {}  # and when its last packet came

    def more(self, vehicle_id: int, received_s: float) -> None:
        """A packet that is not believed."""
        sum_s, last_s = self.sums.get(vehicle_id, (0.0, received_s))
        self.sums[vehicle_id] = (min(sum_s + min(received_s - last_s, COUNTS_S), MOST_S), received_s)

    def less(self, vehicle_id: int, received_s: float) -> None:
        """A packet that is."""
        before = self.sums.get(vehicle_id)
        if before is None:
            return
        sum_s = before[0] - min(received_s - before[1], COUNTS_S)
        if sum_s > 0.0:
            self.sums[vehicle_id] = (sum_s, received_s)
        else:
            del self.sums[vehicle_id]

    def lasting(self, now_s: float, max_age_s: float) -> tuple[int, ...]:
        """The peers that were not believed for LASTING_S, and still send."""
        sums = self.sums.items()
        return tuple([i for i, (sum_s, last_s) in sums if sum_s > LASTING_S and now_s - last_s <= max_age_s])
