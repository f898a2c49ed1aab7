"""Peer packets that the agent refuses and counts in its status: `companion/core/consensus/peers.py`."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "PEER_STALE": Explanation(
        "A vehicle is not ready, or leaves another one out of its law.",
        "No packet of that peer has arrived for `peers.max_age_s`.",
        "Check its agent, its Zenoh endpoints in both vehicle files, and the radio link.",
    ),
    "PEER_OWN_ID": Explanation(
        "Counted in the status.",
        "A packet has this vehicle's own id: two vehicle files have the same `id`.",
        "Give every vehicle its own id. Do not fly before.",
    ),
    "PEER_NOT_IN_FLEET": Explanation(
        "Counted in the status.",
        "A vehicle that is not in the fleet file uses the fleet's name.",
        "Give the other fleet another `name`, or all vehicles the same fleet file.",
    ),
    "PEER_OTHER_FLEET_FILE": Explanation(
        "Counted in the status; the vehicles do not use each other.",
        "The fleet files differ: the formation hash covers all of their content.",
        "Copy the same fleet file to all vehicles and restart the agents.",
    ),
    "PEER_NOT_A_LEADER": Explanation(
        "Counted in the status.",
        "A vehicle claims to be leader that the fleet file does not permit to lead.",
        "Find out which program sends as that vehicle.",
    ),
    "PEER_EPOCH_TOO_HIGH": Explanation(
        "Counted in the status; the peer counts as a follower without a leader, and its position is used.",
        "Its leader epoch is more than 8 above the own one, and one more per second without a leader.",
        "Command `lead` to the whole fleet.",
    ),
    "PEER_NOT_FINITE": Explanation(
        "Counted in the status.",
        "A packet has a number that is not finite.",
        "Look at the other vehicle's status; report the defect.",
    ),
    "PEER_POSITION_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "A peer's position is more than 20 km from the origin.",
        "Check the origin and estimator of the other vehicle.",
    ),
    "PEER_POSITION_JUMPED": Explanation(
        "Counted in the status.",
        "A peer's position is farther from its last one than its speed permits.",
        "Check the estimator of the other vehicle.",
    ),
    "PEER_SPEED_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "A peer is faster than `peers.max_speed_m_s`.",
        "Check the estimator of the other vehicle, or raise the limit.",
    ),
    "PEER_ACCELERATION_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "A peer's acceleration is above 100 m/s².",
        "Look at the other vehicle's status; report the defect.",
    ),
    "PEER_ACCELERATION_LIMITED": Explanation(
        "Counted in the status; the packet is used with a smaller acceleration.",
        "A peer's acceleration, or that of its slot, is above what this fleet's tilt and thrust limits allow.",
        "Look at the other vehicle's status; report the defect.",
    ),
    "PEER_TIME_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "The age or the sending time of a packet is out of range.",
        "Restart the other agent.",
    ),
    "PEER_SLOT_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "A peer's slot is out of range or moves faster than `peers.max_speed_m_s`.",
        "Look at the formation of the other vehicle.",
    ),
    "PEER_POSITION_ERROR_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "A peer's position error is negative or above 10 km.",
        "Check the estimator of the other vehicle.",
    ),
    "PEER_PRC_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "A peer's PrC is out of range, or is 1 without the role of a leader.",
        "Report the defect, with both agents' logs.",
    ),
    "PEER_REFERENCE_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "Number or start time of a peer's reference is out of range.",
        "Report the defect, with both agents' logs.",
    ),
    "PEER_CHANGE_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "A formation that was passed on is out of range, or does not come from a leader.",
        "Command the formation again.",
    ),
    "PEER_BEACON_MISSING": Explanation(
        "Counted in the status.",
        "A leader's packet has no beacon of its own.",
        "Report the defect, with both agents' logs.",
    ),
    "PEER_BEACON_IMPLAUSIBLE": Explanation(
        "Counted in the status.",
        "A leader beacon names a vehicle that may not lead, a claim that is not its rank, or numbers out of range.",
        "Check that all vehicles have the same fleet file.",
    ),
    "PEER_ID_TWICE": Explanation(
        "Counted in the status; packets of one id are refused in turn.",
        "Two agents run with one vehicle id.",
        "Stop one of them. Do not fly before.",
    ),
    "PEER_OUT_OF_ORDER": Explanation(
        "Counted in the status.",
        "A packet arrived twice, overtook another, or is a recording.",
        "None for single cases. A growing count means a replay or a network loop.",
    ),
    "PEER_LATE": Explanation(
        "Counted in the status; the peer may become stale.",
        "The network delayed a packet by more than `peers.max_age_s`.",
        "Improve the radio link. After a suspend of the other computer restart its agent.",
    ),
    "PEER_NOT_AUTHENTICATED": Explanation(
        "Counted in the status; the datagram is not used.",
        "It was not made by the vehicle that it names for this one: a stranger, a vehicle without an identity, or the first"
        " second after a start, before the keys have been exchanged.",
        "Where the count keeps rising, find out who sends there. All vehicles of a fleet need identities, or none.",
    ),
    "PEER_KEY_MISMATCH": Explanation(
        "Counted in the status.",
        "A packet was published on the Zenoh key of another vehicle.",
        "Find the program that publishes there.",
    ),
}
