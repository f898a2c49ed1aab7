"""The conditions of a comparison: what each changes in a scenario that has none of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from msgspec.structs import replace

from companion.config.reference import Figure8Reference, PointReference
from companion.types.commands import CommandName
from companion.types.flight import Role
from companion.types.values import Vector3
from sitl.compare.hops import longest_path
from sitl.flight.scenario import Scenario, TimelineStep
from sitl.vehicle.config import Airframe, Wind
from sitl.vehicle.lies import Lie

NOISE = "default"
PEER_DELAY_S, PEER_LOSS = 0.1, 0.1
GUST_SD_M_S = 1.0
ATTITUDE_LATE_S = 0.08
STEP_M = 4.0
EIGHT_M, EIGHT_S, EIGHT_RAMP_S = (16.0, 8.0), 40.0, 5.0
LIE_M = 1.0


@dataclass(frozen=True, slots=True)
class Condition:
    """A condition by name: what it is in a line, and the scenario with it.

    `by_agents`: a batch cannot fly it.
    """

    about: str
    of: Callable[[Scenario], Scenario]
    by_agents: bool = False


def unchanged(scenario: Scenario) -> Scenario:
    return scenario


def noise(scenario: Scenario) -> Scenario:
    return replace(scenario, stand_in=replace(scenario.stand_in, sensors=NOISE))


def late_and_lost(scenario: Scenario) -> Scenario:
    return replace(scenario, links=replace(scenario.links, peer_delay_s=PEER_DELAY_S, peer_loss=PEER_LOSS))


def gusts(scenario: Scenario) -> Scenario:
    """No steady wind: what removes that is no part of a law."""
    airframe = replace(scenario.stand_in.airframe, drag_n_per_m_s=Airframe().drag_n_per_m_s)
    return replace(scenario, stand_in=replace(scenario.stand_in, airframe=airframe, wind=Wind(gust_sd_m_s=GUST_SD_M_S)))


def slow_attitude(scenario: Scenario) -> Scenario:
    return replace(scenario, links=replace(scenario.links, setpoint_delay_s=ATTITUDE_LATE_S))


def longer_step(scenario: Scenario) -> Scenario:
    x, y, z = goal_of(scenario)
    return replace(scenario, reference=PointReference(point_enu_m=(x + STEP_M - 1.0, y, z)))


def moving(scenario: Scenario) -> Scenario:
    """From rest at the goal, so that the step remains."""
    width_m, height_m = EIGHT_M
    eight = Figure8Reference(
        centre_enu_m=goal_of(scenario), width_m=width_m, height_m=height_m, period_s=EIGHT_S, ramp_s=EIGHT_RAMP_S
    )
    return replace(scenario, reference=eight)


def leader_change(scenario: Scenario) -> Scenario:
    """On the figure 8; vehicle 2 leads from the middle of the flight on."""
    scenario = moving(scenario)
    members = tuple(
        replace(member, role=Role.FOLLOWER if member.id == 2 else member.role, may_lead=True)
        for member in scenario.fleet.vehicles
    )
    steps: list[TimelineStep] = []
    for step in scenario.timeline:
        if step.command is CommandName.FORM:
            half_s = step.for_s / 2.0
            lead = TimelineStep(command=CommandName.LEAD, leaders=(2,), for_s=half_s)
            steps += [replace(step, for_s=half_s), lead]
        else:
            steps.append(step)
    return replace(scenario, fleet=replace(scenario.fleet, vehicles=members), timeline=tuple(steps))


def lying(scenario: Scenario) -> Scenario:
    """The first follower on the longest path."""
    path = longest_path(scenario)
    liar = Lie(vehicle=path[min(1, len(path) - 1)], by_enu=(0.0, LIE_M, 0.0))
    return replace(scenario, links=replace(scenario.links, lies=(liar,)))


def goal_of(scenario: Scenario) -> Vector3:
    """Where the reference begins."""
    return scenario.reference.start_enu_m


CONDITIONS: dict[str, Condition] = {
    "ideal": Condition("the scenario as it is: of a graph a step of 1 m, no noise, no drag", unchanged),
    "noise": Condition("estimator errors of a good autopilot (sensors: default)", noise),
    "delay_loss": Condition(f"packets {PEER_DELAY_S:g} s late, {PEER_LOSS:.0%} lost", late_and_lost),
    "drag_gusts": Condition(f"drag, and gusts with a standard deviation of {GUST_SD_M_S:g} m/s", gusts),
    "slow_attitude": Condition(f"attitudes {ATTITUDE_LATE_S:g} s later", slow_attitude),
    "step": Condition(f"a step of {STEP_M:g} m, by which tilt and separation filter reach their limits", longer_step),
    "moving": Condition("a figure 8 of 16 x 8 m in 40 s instead of a point", moving),
    "leader_change": Condition(
        "the same figure 8, and vehicle 2 becomes its leader halfway", leader_change, by_agents=True
    ),
    "lying": Condition(f"the leader's follower publishes a position that is {LIE_M:g} m wrong", lying, by_agents=True),
}
