"""Messages of targets, the ground and other versions that the agent refuses and counts in its status."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "TARGET_NOT_FINITE": Explanation(
        "Counted in the status.",
        "A target sample has a number that is not finite.",
        "Correct the publishing program.",
    ),
    "TARGET_POSITION_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "A target's position is out of range.",
        "Publish in metres of the fleet frame.",
    ),
    "TARGET_SPEED_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "A target's speed is out of range.",
        "Publish in m/s.",
    ),
    "TARGET_TIME_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "The sending time of a target is out of range.",
        "Use a monotonic clock in seconds.",
    ),
    "TARGET_NAME_TWICE": Explanation(
        "Counted in the status.",
        "Two programs publish a target of one name.",
        "Give each target its own name.",
    ),
    "TARGET_OUT_OF_ORDER": Explanation(
        "Counted in the status.",
        "A target sample arrived twice, overtook another, or is a recording.",
        "None for single cases.",
    ),
    "TARGET_LATE": Explanation(
        "Counted in the status.",
        "The network delayed a target sample too long.",
        "Improve the link of the publishing program.",
    ),
    "MESSAGE_EMPTY": Explanation(
        "Counted in the status.",
        "A message has no bytes.",
        "Find the program that publishes it.",
    ),
    "WIRE_VERSION_DIFFERS": Explanation(
        "Counted in the status; vehicles do not receive each other.",
        "The other program has another wire version.",
        "Install the same release on all vehicles and on the ground.",
    ),
    "PEER_MALFORMED": Explanation(
        "Counted in the status.",
        "A peer packet does not have the form of this version.",
        "Install the same release on all vehicles.",
    ),
    "TRAFFIC_MALFORMED": Explanation(
        "Counted in the status; the sample is not used.",
        "A traffic sample cannot be decoded, or a position, speed, age or error is out of range.",
        "Check the program that publishes the traffic; `companion/types/peers.py` has the ranges.",
    ),
    "TARGET_MALFORMED": Explanation(
        "Counted in the status.",
        "A target sample does not have the form of this version.",
        "Use `companion.ground.publishers`, or correct the publishing program.",
    ),
    "REPORT_MALFORMED": Explanation(
        "The ground does not show a vehicle's status or reply.",
        "A status report or a reply does not have the form of this version.",
        "Install the same release on vehicles and ground.",
    ),
}
