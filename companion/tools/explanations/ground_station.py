"""Packets of a ground station that the agent does not pass on: `companion/mavlink/ground_station.py`,
`companion/link/ground_link.py`.
"""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "GROUND_STATION_OWN_ID": Explanation(
        "Counted in the status.",
        "The ground station uses the vehicle's own system id.",
        "Give the ground station another system id, usually 255.",
    ),
    "GROUND_STATION_SETPOINT": Explanation(
        "Counted in the status; joystick or fly-to of the ground station has no effect.",
        "Setpoints are the agent's alone.",
        "Change the flight mode first; the agent then observes.",
    ),
    "GROUND_STATION_IN_FLIGHT": Explanation(
        "Counted in the status; go-to, mission upload or parameter change of the ground station has no effect.",
        "From arming to landing only the sticks, changes of mode, reading, corrections of the position, camera and"
        " emergency stop pass. Go-to (DO_REPOSITION) would move an ArduCopter without a change of its mode.",
        "Change the flight mode first; the agent then observes and everything but setpoints passes.",
    ),
    "GROUND_STATION_RATE": Explanation(
        "Counted in the status.",
        "The ground station asks for another rate of a message that the agent needs.",
        "None is needed: the packets arrive at the agent's rate.",
    ),
    "GROUND_STATION_UNREADABLE": Explanation(
        "Counted in the status.",
        "A packet from the ground station is no MAVLink.",
        "Check what sends to that port.",
    ),
    "GROUND_STATION_ADDRESS": Explanation(
        "Counted in the status.",
        "A packet came to the ground station's port from another address than the one configured.",
        "Correct `ground_station` in the vehicle file, or find the sender.",
    ),
    "GROUND_STATION_OVERLOAD": Explanation(
        "Counted in the status; commands of the ground station are lost.",
        "It sends more than the autopilot's link has room for, or a command waited for more than 0.25 s.",
        "Use 921600 baud, and fewer requests by the ground station.",
    ),
}
