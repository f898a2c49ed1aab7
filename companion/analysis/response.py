"""The linear model of a vehicle's loop, and the graph of a formation: what all figures of a law start from."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from companion.core.autopilot import LAG_S
from companion.types.autopilot import AutopilotKind

TICK_S = 0.02
Graph = Mapping[int, Collection[int]]
"""Vehicle id -> ids of its neighbours."""


@dataclass(frozen=True, slots=True)
class LinearModel:
    """Lags and delays of the loop; the defaults are on the late side of PX4 and a local network, with a lag of first order.

    A commanded acceleration is flown by the share 1/(1 + T s + a s^2 + b s^3), with T of `attitude_lag_s`, and after `delay_s`:
    the delay of the whole loop, including the half tick of the zero-order hold. `neighbour_delay_s` is the age of a neighbour's
    position and velocity at their use, and `feedforward_delay_s` that of its acceleration command and of what it publishes.
    """

    attitude_lag_s: float = LAG_S
    delay_s: float = 0.05
    feedforward_delay_s: float = TICK_S
    neighbour_delay_s: float = 0.0
    attitude_a_s2: float = 0.0
    attitude_b_s3: float = 0.0
    drag_1_s: float = 0.0

    def flown_share(self, s: Any) -> Any:
        """The flown acceleration over the commanded one, without the delay. `s` is complex, or an array."""
        return 1.0 / (1.0 + s * (self.attitude_lag_s + s * (self.attitude_a_s2 + s * self.attitude_b_s3)))


@dataclass(frozen=True, slots=True)
class AttitudeLoop:
    """An autopilot's attitude control as measured, with motors of usual lag: gains on tilt and on rates, and the delay.

    It takes a stream of setpoints `engages_s` after the command to form.
    """

    tilt_gain_1_s: float
    rate_gain_1_s: float
    delay_s: float
    engages_s: float
    motor_lag_s: float = 0.05


class VehicleKind(NamedTuple):
    """What the model knows of a vehicle."""

    autopilot: AutopilotKind
    drag_1_s: float


# As measured for the stand-ins, which have the same figures. Where one of the two is stable with a law, PX4 is the later one.
ATTITUDE_LOOPS = {
    AutopilotKind.PX4: AttitudeLoop(6.5, 12.5, 0.028, 0.3),
    AutopilotKind.ARDUPILOT: AttitudeLoop(5.5, 28.0, 0.004, 0.0),
}
USUAL_DRAG_1_S = 0.25  # drag of a small open quadrotor
AUTOPILOT_STEP_S = 0.002
ON_BOARD_S = 0.001 + AUTOPILOT_STEP_S  # telemetry and setpoint on their way as well
USUAL_LINK_S = 0.001  # between agents on a local network
LATE_LINK_S = 0.1  # the latest link between agents that laws are made for
SPARE_S = (
    0.5 * TICK_S
)  # of the delay: packets and setpoints may wait for a whole tick, where half of one is the average


def links_borne_s(link_s: float) -> Sequence[float]:
    """The links that a law must be stable with: that of the scenario; of the usual one, which names no network, any."""
    return (LATE_LINK_S, USUAL_LINK_S, 0.5 * LATE_LINK_S) if link_s <= USUAL_LINK_S else (link_s,)


def flown_model(
    autopilot: AutopilotKind = AutopilotKind.PX4,
    link_s: float = USUAL_LINK_S,
    drag_1_s: float = USUAL_DRAG_1_S,
    on_board_s: float = ON_BOARD_S,
) -> LinearModel:
    """The model of a vehicle as it flies, behind links that take `link_s`. A packet waits half a tick on average, too."""
    loop = ATTITUDE_LOOPS[autopilot]
    both_1_s2, age_s = loop.tilt_gain_1_s * loop.rate_gain_1_s, link_s + 0.5 * TICK_S
    return LinearModel(
        attitude_lag_s=1.0 / loop.tilt_gain_1_s,
        delay_s=loop.delay_s + on_board_s + 0.5 * TICK_S,
        feedforward_delay_s=age_s,
        neighbour_delay_s=age_s,
        attitude_a_s2=1.0 / both_1_s2,
        attitude_b_s3=loop.motor_lag_s / both_1_s2,
        drag_1_s=drag_1_s,
    )


MODEL = LinearModel()


def settled_prcs(graph: Graph, leaders: Collection[int]) -> dict[int, int]:
    """PrC p_i at convergence of Algorithm 1: hops to the nearest leader + 1, or n without a path."""
    return dict.fromkeys(graph, len(graph)) | {i: distance + 1 for i, distance in hops(graph, leaders).items()}


def reached_from(graph: Graph, leaders: Collection[int]) -> set[int]:
    """Vehicles with a path to a leader. Lemma 1 requires that all vehicles have one."""
    return set(hops(graph, leaders))


def flown_graphs(at_start: Graph, in_slots: Graph, leaders: Collection[int]) -> Sequence[Graph]:
    """Those that a law must be stable with: at the start, and in the slots if they differ and are all in range there."""
    if in_slots == at_start or len(reached_from(in_slots, leaders)) < len(in_slots):
        return (at_start,)
    return (at_start, in_slots)


def hops(graph: Graph, leaders: Collection[int]) -> dict[int, int]:
    """Hops to the nearest leader, for each vehicle with a path to one."""
    found = dict.fromkeys(leaders, 0)
    waiting = deque(leaders)
    while waiting:
        i = waiting.popleft()
        for j in graph[i]:
            if j not in found:
                found[j] = found[i] + 1
                waiting.append(j)
    return found
