"""Telemetry that the agent refuses and counts in its status: `companion/mavlink`, `companion/core/estimation`."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "POSITION_RESET": Explanation(
        "The log reports a jump of the autopilot's position.",
        "The estimator reset its position. In flight the agent follows at 0.2 m/s.",
        "None at once. If it happens often, improve GPS reception or the estimator's settings.",
    ),
    "POSITION_OUT_OF_ORDER": Explanation(
        "Counted in the status.",
        "A position has an older time than the one before: packets overtook each other, or the autopilot restarted.",
        "None for single cases. Check the network between autopilot and agent if the count grows.",
    ),
    "POSITION_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "A position or velocity is not finite or out of range.",
        "Check the estimator of the autopilot, and the origin of the fleet file.",
    ),
    "ATTITUDE_INVALID": Explanation(
        "Counted in the status.",
        "ATTITUDE_QUATERNION is not finite or not a rotation.",
        "Check the link for damage (baud rate), and the autopilot.",
    ),
    "THRUST_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "ATTITUDE_TARGET has a thrust outside 0 to 1.",
        "For ArduCopter check `GUID_OPTIONS` 8.",
    ),
    "ORIGIN_IMPLAUSIBLE": Explanation(
        "Counted in the status; no position in the fleet frame.",
        "GPS_GLOBAL_ORIGIN is out of range.",
        "Restart the autopilot with GPS reception.",
    ),
    "GLOBAL_POSITION_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "GLOBAL_POSITION_INT is far from the fleet's origin: no fix, or the fleet file has the origin of another"
        " field.",
        "Wait for the fix; correct `origin` in the fleet file.",
    ),
    "PARAMETER_NOT_FINITE": Explanation(
        "Counted in the status.",
        "A parameter value of the autopilot is not finite.",
        "Set the parameter again by a ground station.",
    ),
    "AUTOPILOT_OTHER_MAKE": Explanation(
        "The agent ignores a HEARTBEAT.",
        "It is of another make than `autopilot` in the vehicle file, or than the first HEARTBEAT.",
        "Correct `autopilot`, or separate the two autopilots that share a system id.",
    ),
    "TELEMETRY_OVERLOAD": Explanation(
        "Counted in the status; the oldest samples are dropped.",
        "The autopilot, or a program on its link, sends far more telemetry than requested; or the agent was stopped for a"
        " second.",
        "Find what sends on the autopilot's link, and what else uses the onboard computer.",
    ),
    "MAVLINK_UNREADABLE": Explanation(
        "Counted in the status.",
        "Bytes are no MAVLink packet: noise, a wrong baud rate, or another protocol.",
        "Check the baud rate and wiring.",
    ),
    "MAVLINK_UNSIGNED": Explanation(
        "No HEARTBEAT of the autopilot is accepted.",
        "The vehicle file has a signing key, and the packets are not signed.",
        "Give the autopilot the key (MAVProxy: `signing setup PASSPHRASE`), or remove `signing`. PX4 1.16 cannot sign.",
    ),
    "MAVLINK_WRONG_KEY": Explanation(
        "No HEARTBEAT of the autopilot is accepted.",
        "Its packets are signed with another key.",
        "Give both the same key.",
    ),
    "MAVLINK_OLD_SIGNATURE": Explanation(
        "No HEARTBEAT of the autopilot is accepted.",
        "Its signatures have older time stamps than this computer's clock.",
        "Correct the clock of the computer, or wait for the autopilot's GPS.",
    ),
    "SETPOINT_IMPOSSIBLE": Explanation(
        "Counted in the status; no setpoint in that tick.",
        "The commanded acceleration is not finite, or no attitude gives it: a measured angle of 90 degrees or more.",
        "Look into the log for what happened to the vehicle. The autopilot's failsafe acts.",
    ),
}
