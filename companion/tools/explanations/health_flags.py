"""Health flags: conditions that are wrong just now. `companion/core/safety/failsafe.py` ranks what follows."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "POSITION_STALE": Explanation(
        "The newest position is older than 40 ms.",
        "The autopilot, the link or the computer delivers positions late. A serial line that is too slow, a rate that a ground"
        " station changed, and a computer that is overloaded are the usual reasons.",
        "Run `companion doctor`: it measures the rates. Use 921600 baud, remove other streams from the port, and check the CPU"
        " load. In flight the agent sends no setpoint; after 0.5 s it leaves the formation.",
    ),
    "ATTITUDE_STALE": Explanation(
        "The newest attitude is older than 0.1 s.",
        "ATTITUDE_QUATERNION does not arrive at 50 Hz, for the same reasons as POSITION_STALE.",
        "As for POSITION_STALE.",
    ),
    "MODE_STALE": Explanation(
        "The newest flight mode is older than 0.8 s.",
        "CURRENT_MODE (PX4) or HEARTBEAT (ArduCopter) does not arrive. Without it the agent cannot see a pilot who takes over.",
        "As for POSITION_STALE. PX4 needs version 1.15 or newer for CURRENT_MODE.",
    ),
    "FRAME_UNKNOWN": Explanation(
        "The origin of the autopilot's local frame is unknown, so positions cannot be mapped into the fleet frame.",
        "The autopilot has no GPS_GLOBAL_ORIGIN yet: its estimator has no global position.",
        "Wait for the GPS fix. Indoors, with one motion-capture system, set `origin: indoor` in the fleet file.",
    ),
    "ARMED_STALE": Explanation(
        "The newest armed state is older than 3 s.",
        "HEARTBEAT does not arrive.",
        "Check the link; `companion doctor` names what does not arrive.",
    ),
    "LANDED_STALE": Explanation(
        "The newest landed state is older than 3 s.",
        "EXTENDED_SYS_STATE does not arrive.",
        "Check the link; `companion doctor` names what does not arrive.",
    ),
    "LEADER_AWAITED": Explanation(
        "No leader beacon newer than `peers.leader_beacon_max_age_s`.",
        "The leader has died, or the network has lost its packets for a moment.",
        "None at once: the followers keep the formation, and a successor becomes leader. Where it happens often without"
        " a cause, improve the radio link or raise `peers.leader_beacon_max_age_s`.",
    ),
    "LEADER_LOST": Explanation(
        "No leader beacon, and no successor has become leader. The vehicle goes into its autopilot's hold.",
        "The leader died and no successor is configured, or this vehicle is cut off from the others.",
        "Name `successors` in the fleet file. Choose edges that stay connected without the leader. `land_after_s` makes a"
        " vehicle in hold land.",
    ),
    "OUTSIDE_FENCE": Explanation(
        "The position is outside the fence.",
        "The reference, a slot or a disturbance brought the vehicle outside `envelope.fence_min_enu_m` to `fence_max_enu_m`.",
        "Bring it back by `return`, `land` or the remote control. Correct the reference or the fence before the next flight.",
    ),
    "FRAME_CONTRADICTED": Explanation(
        "GPS_GLOBAL_ORIGIN and GLOBAL_POSITION_INT contradict each other by more than 2 m.",
        "The autopilot's origin changed and the agent has not received the new one, or two programs set it.",
        "Land. Restart the autopilot, and let only one program set the origin.",
    ),
    "POSITION_JUMPED": Explanation(
        "The autopilot's position jumped by more than 5 m, and no new origin explains it.",
        "The estimator reset its position, after a GPS fault for example.",
        "Land and look at the estimator in the autopilot's log (`companion logs`).",
    ),
    "FLEET_LINK_LOST": Explanation(
        "This vehicle has received other vehicles of the fleet, and now receives none.",
        "Its radio or the network has failed, or the other agents have ended.",
        "Check the link. A leader goes into hold after `leader_holds_after_s`; a follower holds by LEADER_LOST before that."
        " With `land_after_s` both land.",
    ),
    "DUPLICATE_ID": Explanation(
        "Packets of one vehicle id come from two agents. Vehicles refuse to prepare, arm, take off and form until 3 s after the"
        " last of them; those in formation go on.",
        "Two vehicle files have the same `id`, an agent was started twice, or a stranger sends under an id of the fleet."
        " `PEER_OWN_ID` and `PEER_ID_TWICE` among the rejected packets of the status name the id.",
        "Land, and end one of the agents, or keep the stranger out of the network.",
    ),
    "SEPARATION_VIOLATED": Explanation(
        "Another vehicle is nearer than `separation_m`.",
        "A vehicle that takes no part, a gust, or position errors brought them together.",
        "None at once: the separation filter moves the vehicles apart. Choose wider slots where it happens often.",
    ),
    "ESTIMATOR_BAD": Explanation(
        "The autopilot's estimator reports that its position must not be used, or an error above 5 m.",
        "GPS is lost or disturbed, or the compass and the IMU contradict it.",
        "Let the pilot take over or land. Look at the estimator in the autopilot's log (`companion logs`).",
    ),
    "TILT_EXCEEDED": Explanation(
        "The vehicle tilts by more than `envelope.max_tilt_deg` and 10 degrees.",
        "A collision, a failed motor, a gust, or gains of the autopilot that do not fit the airframe.",
        "Land and inspect the vehicle. Tune the attitude control of the autopilot before the next flight.",
    ),
    "TICK_LATE": Explanation(
        "The control loop began a tick more than 0.1 s late.",
        "The computer is overloaded, or was stopped for a moment.",
        "End other programs on it, and check its temperature and its memory. After 5 s the vehicle goes into hold.",
    ),
    "BATTERY_LOW": Explanation(
        "A vehicle leaves the formation by `low_battery_action`, or is not ready.",
        "The battery charge was below `leave_below_percent` for 3 s; before a flight, below what the checks demand.",
        "Change the battery. Set `leave_below_percent` well above the autopilot's own threshold.",
    ),
    "BATTERY_CRITICAL": Explanation(
        "A vehicle lands from formation or hold.",
        "The battery charge was below `land_below_percent` for 3 s.",
        "Change the battery. A command given during the landing ends it; nothing lands a second time for the same reason.",
    ),
}
