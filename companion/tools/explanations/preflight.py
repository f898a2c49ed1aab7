"""Vehicle audit, arming checks, separation and position error: `companion/core/safety`."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "AUTOPILOT_UNKNOWN": Explanation(
        "A vehicle is not ready.",
        "The autopilot has not reported its make yet.",
        "Wait a few seconds; then see NO_HEARTBEAT.",
    ),
    "PARAMETERS_UNREAD": Explanation(
        "A vehicle is not ready. The text names parameters.",
        "The autopilot has not answered the request for them yet.",
        "Wait some seconds. If it stays, check the link with `companion doctor`; an older firmware may not have"
        " the parameter.",
    ),
    "ARMING_CHECKS_UNKNOWN": Explanation(
        "A vehicle is not ready.",
        "SYS_STATUS with the arming checks has not arrived yet.",
        "Wait; if it stays, check the telemetry rates with `companion doctor`.",
    ),
    "ARMING_CHECKS_FAILED": Explanation(
        "A vehicle is not ready. The text has the autopilot's reason, where it gives one.",
        "The autopilot's own checks before arming fail: GPS, estimator, calibration, safety switch.",
        "Correct what the text names. PX4 explains its checks only to ground stations (`commander check`)."
        " ArduCopter needs about 40 s after its start.",
    ),
    "AUDIT_REFUSAL": Explanation(
        "A vehicle is not ready, or `form` is refused. The text names a parameter or condition.",
        "The vehicle must not fly in formation like this, for example because it would fall when the setpoints end.",
        "Run `companion doctor`; `--fix` sets what is safe to set.",
    ),
    "HOME_UNKNOWN": Explanation(
        "`return` is refused.",
        "The agent has not seen the vehicle on the ground, for example after a restart in the air.",
        "Command `land`, or let the pilot return it.",
    ),
    "RETURN_PATH_TOO_CLOSE": Explanation(
        "`return` is refused. The text names a vehicle and a distance.",
        "The straight path home comes nearer than `separation_m` to that vehicle or to its path home; autopilots"
        " do not avoid each other.",
        "Land the vehicles, let them return one after another, or first bring the formation back to its take-off"
        " positions.",
    ),
    "VEHICLE_TOO_CLOSE": Explanation(
        "`arm` or `takeoff` is refused, or landing gives a warning.",
        "Another vehicle is nearer than `separation_m` in the plane.",
        "Move the vehicles apart on the ground.",
    ),
    "ALTITUDES_DIFFER": Explanation(
        "`arm` or `takeoff` is refused.",
        "On the ground the vehicles report altitudes that differ by more than `ground_spread_m`.",
        "Wait until the altitude estimates settle. On level ground use `altitude_source: takeoff`.",
    ),
    "POSITION_ERROR_LARGE": Explanation(
        "`form` is refused, or gives a warning. The text has distance and sigmas.",
        "The slots are less than 3 (refusal) or 6 (warning) times the reported position error apart.",
        "Wait for better reception, use RTK or motion capture, or a larger spacing.",
    ),
    "POSITION_ERROR_UNKNOWN": Explanation(
        "`form` gives a warning.",
        "The estimator of the named vehicle reports no error.",
        "Check that ESTIMATOR_STATUS (PX4) or GPS_RAW_INT with h_acc (ArduCopter) arrives.",
    ),
}
