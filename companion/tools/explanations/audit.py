"""Vehicle audit: `companion/core/safety/audit.py` and its table of parameters."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "TELEMETRY_SLOW": Explanation(
        "The doctor refuses a telemetry rate.",
        "The autopilot or the line sends fewer messages than the agent needs.",
        "Use a faster line (baud rate) or another port, or reduce other streams on it (MAV_x_RATE, SRx_*).",
    ),
    "POSITION_MISSING": Explanation(
        "The doctor reports no position.",
        "The autopilot's estimator has no position yet.",
        "Wait for the estimator; check GPS or motion capture.",
    ),
    "ORIGIN_MISSING": Explanation(
        "The doctor reports a position without an origin.",
        "The autopilot has not reported the origin of its local frame (GPS_GLOBAL_ORIGIN).",
        "Wait for the position fix. Without GPS send SET_GPS_GLOBAL_ORIGIN, or use `origin: indoor` in the fleet file.",
    ),
    "POSITION_OUTSIDE_FENCE": Explanation(
        "The doctor reports a position outside the fence.",
        "The fleet file has the origin or fence of another field, or the vehicle is outside.",
        "Correct `origin` or `envelope.fence_*` in the fleet file, or move the vehicle.",
    ),
    "BATTERY_UNKNOWN": Explanation(
        "The doctor warns that the battery is not reported.",
        "The autopilot does not know its remaining capacity.",
        "Calibrate the battery monitor. Without it there is no failsafe for a low battery.",
    ),
    "VEHICLE_ARMED": Explanation(
        "The doctor warns that the vehicle is armed.",
        "The vehicle is flown at present. `--fix` sets nothing.",
        "Land and disarm, then repeat.",
    ),
    "PARAMETER_MISSING": Explanation(
        "A parameter is not found.",
        "The firmware does not have it, or the link lost the answers.",
        "Update the firmware, or check the link for packet loss.",
    ),
    "ANGLE_BOOST_OFF": Explanation(
        "ATC_ANGLE_BOOST is 0.",
        "The vehicle sinks when it tilts.",
        "Set it to 1; `companion doctor --fix` does.",
    ),
    "AUTOPILOT_FENCE_OFF": Explanation(
        "The fence of the autopilot is off (GF_MAX_*, FENCE_ENABLE).",
        "Only the agent's fence limits the flight; it does not act in other modes.",
        "Set a fence a little wider than the fleet's (`envelope.fence_*`).",
    ),
    "FENCE_ACTION_UNSAFE": Explanation(
        "The autopilot's fence action is no action, or makes the vehicle fall.",
        "GF_ACTION or FENCE_ACTION.",
        "Choose hold, return or land; `companion doctor --fix` does.",
    ),
    "GROUND_LOSS_ACTION": Explanation(
        "The autopilot acts when the ground station is lost (NAV_DLL_ACT, FS_GCS_ENABLE).",
        "Each vehicle then leaves the formation separately.",
        "Set it to 0, or expect this. The agent has failsafes of its own.",
    ),
    "HOVER_THRUST_DIFFERS": Explanation(
        "The hover thrust of the vehicle file and of the autopilot differ by more than 10 %.",
        "One of the two values is of another vehicle or load.",
        "Hover the vehicle and correct the wrong value.",
    ),
    "RC_OVERRIDE_OFF": Explanation(
        "Bit 1 of COM_RC_OVERRIDE is not set.",
        "In OFFBOARD the sticks do not take over; only the mode switch does.",
        "Set the bit; `companion doctor --fix` does.",
    ),
    "SETPOINT_LOSS_ACTION_UNSAFE": Explanation(
        "COM_OBL_RC_ACT is not hold or land.",
        "When the setpoints end the vehicle drifts, sinks, flies home between the others, or falls.",
        "Set it to 5 (hold) or 4 (land); `companion doctor --fix` does. Formation is refused where it would sink, unless"
        " the vehicle file has `accept_uncontrolled_descent: true` because a pilot stands by.",
    ),
    "SETPOINT_TIMEOUT_UNSAFE": Explanation(
        "COM_OF_LOSS_T or GUID_TIMEOUT is out of range.",
        "Too long: the vehicle keeps its last setpoint. Too short: it may return to OFFBOARD without a command.",
        "Set it to 1 s; `companion doctor --fix` does.",
    ),
    "THRUST_IS_CLIMB_RATE": Explanation(
        "Bit 3 of GUID_OPTIONS is not set, or the parameter is missing.",
        "ArduCopter takes the thrust of setpoints as a climb rate.",
        "Set GUID_OPTIONS to 8 plus the other bits; `companion doctor --fix` does.",
    ),
}
