"""Hand-overs and landings without a command: `companion/core/safety/safeguard.py`."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "SEPARATION_INTERVENES": Explanation(
        "A vehicle in formation leaves the path that its law commands.",
        "The safety filter keeps it away from another vehicle, which is too near or comes too near, from the fence or from an"
        " obstacle.",
        "If it happens in a formation at rest, increase the distance of the slots or check the reported position errors.",
    ),
    "AGENT_FAILED": Explanation(
        "A vehicle in formation goes into its autopilot's hold, and its agent ends with exit code 4.",
        "A defect: an exception in a tick or in a link. The agent sent a level attitude and requested the hold; systemd"
        " starts it again, and it observes.",
        "Land the vehicle. Report the lines of the log from `AGENT_FAILED` on.",
    ),
    "AGENT_STOPPING": Explanation(
        "A vehicle in formation goes into its autopilot's hold.",
        "The agent received SIGTERM or SIGINT.",
        "None is needed. Land the vehicle by a ground station or a restarted agent.",
    ),
    "HAND_OVER_FAILED": Explanation(
        "An agent ends and its autopilot has not confirmed the hold.",
        "The autopilot did not report the hold mode within 2 s.",
        "Let the pilot take over. The autopilot's own failsafe acts now that the setpoints have ended.",
    ),
    "NO_SETPOINT": Explanation(
        "The agent leaves the formation after 0.5 s without a setpoint.",
        "There was no new position to decide on.",
        "See POSITION_STALE.",
    ),
    "RECORDING_DROPS": Explanation(
        "The recording of a vehicle has gaps. Its flight is not affected.",
        "The disk is full, too slow, the folder cannot be written, or the network is flooded; the event has the reason.",
        "Free space or set a smaller `recording.keep_mb`; replace a slow card; find who floods. See docs/recording.md.",
    ),
    "RECORDING_RESUMED": Explanation(
        "All records of a vehicle are written again.",
        "The disk takes data again; the event has the number of records that were lost.",
        "None is needed.",
    ),
}
