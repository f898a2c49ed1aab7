"""A phase machine with an autopilot that executes its requests at once."""

from collections.abc import Iterable, Sequence

from msgspec.structs import replace

from companion.core.command.phase import LEVEL_BEFORE_HAND_OVER_S, PhaseMachine
from companion.types.autopilot import (
    Arm,
    AutopilotKind,
    AutopilotMode,
    AutopilotRequest,
    Disarm,
    LandedState,
    SetMode,
    TakeOff,
    Telemetry,
    VehicleState,
)
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase

NEW = float("inf")  # state that is always newer than the request
GROUND = VehicleState(
    mode_time_s=NEW,
    heartbeat_time_s=NEW,
    autopilot=AutopilotKind.PX4,
    mode=AutopilotMode.OTHER,
    mode_name="POSCTL",
    landed=LandedState.ON_GROUND,
    altitude_amsl_m=488.0,
)
AIR = replace(GROUND, armed=True, landed=LandedState.IN_AIR, mode=AutopilotMode.HOLD, position_enu_m=(0.0, 0.0, 2.5))


def tick(
    machine: PhaseMachine, now_s: float, vehicle: VehicleState, telemetry: Sequence[Telemetry]
) -> tuple[AutopilotRequest, ...]:
    """Autopilot requests of one tick without commands."""
    machine.follow_truth(vehicle)
    return machine.advance(now_s, vehicle, telemetry)


class ImmediateAutopilot:
    """An autopilot that executes every request at once."""

    def __init__(self) -> None:
        self.state = GROUND
        self.asked: list[AutopilotRequest] = []

    def execute(self, requests: Iterable[AutopilotRequest]) -> None:
        for request in requests:
            self.asked.append(request)
            match request:
                case SetMode(mode):
                    self.state = replace(self.state, mode=mode, mode_name=mode)
                case Arm():
                    self.state = replace(self.state, armed=True)
                case Disarm():
                    self.state = replace(self.state, armed=False)
                case TakeOff():
                    self.state = replace(AIR, mode=AutopilotMode.HOLD)


def flown_to(phase: FlightPhase) -> tuple[PhaseMachine, ImmediateAutopilot, float]:
    """A machine that reached `phase` by the usual commands."""
    machine, autopilot, now_s = PhaseMachine(2.5), ImmediateAutopilot(), 0.0
    for name in (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF, CommandName.FORM):
        if machine.phase is phase:
            break
        assert machine.command(name, now_s, autopilot.state)[0]
        for _ in range(100):
            if machine.phase is phase:
                return machine, autopilot, now_s
            autopilot.execute(tick(machine, now_s, autopilot.state, ()))
            now_s += 0.02
    return machine, autopilot, now_s


def levelled(machine: PhaseMachine, autopilot: ImmediateAutopilot, now_s: float) -> float:
    """Let a hand-over from formation stream until its level phase ends; the time of the request that follows."""
    until_s = now_s + LEVEL_BEFORE_HAND_OVER_S
    while now_s < until_s:
        assert tick(machine, now_s, autopilot.state, ()) == ()
        assert machine.streams(autopilot.state) and machine.hands_over_level(now_s)
        now_s += 0.02
    autopilot.execute(tick(machine, now_s, autopilot.state, ()))
    return now_s
