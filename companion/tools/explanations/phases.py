"""Flight phases and procedures: `companion/core/command/phase.py`."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "NO_HEARTBEAT": Explanation(
        "A command is refused, or the agent waits for its autopilot.",
        "No HEARTBEAT has arrived from the autopilot with the vehicle's system id.",
        "Check the endpoint `mavlink` of the vehicle file, the baud rate and the autopilot's system id (PX4"
        " `MAV_SYS_ID`, ArduPilot `SYSID_THISMAV`). `companion doctor` shows what arrives.",
    ),
    "ALREADY_DONE": Explanation(
        "A command is accepted and changes nothing.",
        "The vehicle is already in that phase or role, or on its way there.",
        "None is needed.",
    ),
    "WRONG_PHASE": Explanation(
        "A command is refused; the reply names the phases in which it is possible.",
        "The vehicle is in another flight phase, for example `hold` before `form` is missing, or the vehicle still"
        " observes.",
        "Look at `companion fleet status`, and give the commands in their order: arm, takeoff, form. After a"
        " pilot's take-over command `hold` or `land` first.",
    ),
    "NOT_ON_GROUND": Explanation(
        "`prepare`, `arm`, `takeoff` or `disarm` is refused.",
        "The autopilot reports that the vehicle is armed and not on the ground.",
        "Land first. If the vehicle is on the ground, check the landed state of the autopilot (EXTENDED_SYS_STATE).",
    ),
    "NOT_IN_AIR": Explanation(
        "`form`, `hold`, `land` or `return` is refused.",
        "The autopilot reports that the vehicle is on the ground or disarmed.",
        "Take off first.",
    ),
    "ALTITUDE_UNKNOWN": Explanation(
        "`takeoff` is refused.",
        "PX4 takes the take-off altitude above sea level, and the autopilot has not reported its origin.",
        "Wait for a GPS fix; `companion fleet doctor` shows when the origin is known.",
    ),
    "PHASE_CHANGED": Explanation(
        "The log or reply names the new flight phase.",
        "A command, a failsafe or the autopilot's state changed the phase; the text says which.",
        "None is needed.",
    ),
    "PROCEDURE_FAILED": Explanation(
        "A command was accepted, and the vehicle did not get there.",
        "The autopilot did not report the requested mode or armed state in time. The text has its own answer, such"
        " as a failed arming check.",
        "Read the text; on PX4 a ground station shows the reason of a denied arming. Correct it and give the"
        " command again.",
    ),
    "LANDING_CONTINUES": Explanation(
        "`abort` is accepted, and the vehicle continues to land.",
        "It is landing, or at the end of a return. Landing is the safest that is near.",
        "None is needed.",
    ),
    "FLOWN_BY_OTHERS": Explanation(
        "The agent leaves the vehicle alone.",
        "A pilot or a failsafe of the autopilot flies it, or it took off without the agent.",
        "Command `hold` to take it over, after agreeing with the pilot.",
    ),
    "AUTOPILOT_DISARMED": Explanation(
        "The agent goes to `observe` in a phase that needs an armed vehicle.",
        "The autopilot disarmed: a pilot, its own automatic disarming after about 10 s on the ground, or a failsafe.",
        "Give `arm` and `takeoff` with less time between them. Look into the autopilot's log if it disarmed in the"
        " air.",
    ),
    "MODE_CHANGED_BY_OTHERS": Explanation(
        "The agent goes to `observe` and sends nothing any more.",
        "The autopilot is in a mode that the agent did not command: a pilot or a failsafe of the autopilot set it.",
        "The pilot has the vehicle. Command `hold` or `land` to fly it by the agent again.",
    ),
}
