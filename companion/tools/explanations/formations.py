"""Slots, formation changes and joining: `companion/core/formation`, `companion/core/safety/fleet_checks.py`."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "FORMATION_ACCEPTED": Explanation(
        "A formation command is accepted.",
        "The vehicle has the new formation and begins it at the time in the text, on the ground at once.",
        "None is needed.",
    ),
    "FORMATION_KNOWN": Explanation(
        "A formation command is accepted again.",
        "The vehicle already has this formation.",
        "None is needed.",
    ),
    "FORMATION_CHANGED": Explanation(
        "The log names the formation that begins.",
        "Its start time has come and every flying vehicle has it.",
        "None is needed.",
    ),
    "FORMATION_CANCELLED": Explanation(
        "A formation that was accepted does not begin.",
        "A flying vehicle does not have it, or an absent vehicle is back in formation; the text names the vehicle.",
        "Check that vehicle's link, then command the formation again.",
    ),
    "FORMATION_DIFFERS": Explanation(
        "`form` is refused.",
        "The vehicle has another formation than those that fly, or than the leader that will fly first.",
        "Command the same formation to all vehicles, or wait until the leader has passed it on.",
    ),
    "CHANGE_TOO_OLD": Explanation(
        "A formation or reference is refused because of its number.",
        "The vehicle has this number, or a higher one than a leader passes on.",
        "Give the command again; `companion fleet` takes the next number.",
    ),
    "CHANGE_TOO_NEW": Explanation(
        "A formation or reference is refused because of its number.",
        "The number is more than 1000 ahead.",
        "Give the command again; `companion fleet` takes a number that all vehicles accept.",
    ),
    "CHANGE_NOT_IN_TIME": Explanation(
        "A formation or reference is refused because of its start time.",
        "The start is past or too near for all vehicles to agree on it, or too far ahead in mission time: the command was"
        " slow, or the mission clock is stopped because no leader is in formation.",
        "Give the command again while the fleet is in formation, or on the ground.",
    ),
    "CHANGE_IN_PROGRESS": Explanation(
        "A formation or reference is refused because of another one.",
        "The vehicle is joining, the change before is not finished, or several changes are still being checked.",
        "Wait a few seconds and give the command again.",
    ),
    "CHANGE_TOO_LONG": Explanation(
        "A formation is refused because of its duration.",
        "The slots would move for longer or shorter than the limits in the text.",
        "Choose another slot speed, or other slots.",
    ),
    "SLOTS_INCOMPLETE": Explanation(
        "A formation is refused.",
        "Its slots are not those of exactly the vehicles of the fleet file.",
        "Give one slot for each vehicle.",
    ),
    "SLOT_TOO_CLOSE": Explanation(
        "A formation is refused. The text names two vehicles and a distance.",
        "Their slots are nearer to each other than `separation_m`.",
        "Choose a larger spacing.",
    ),
    "SLOT_TOO_FAST": Explanation(
        "A formation is refused.",
        "A slot would move faster than `slot_speed_m_s`.",
        "Give the change more time, or raise `slot_speed_m_s` in the fleet file.",
    ),
    "SLOTS_NOT_FOLLOWED": Explanation(
        "A formation is refused. The text names the vehicles and the pace of the reference that would do.",
        "The reference flown is too fast for the law at this spacing: the vehicles would lag behind their neighbours and come"
        " nearer than `separation_m`.",
        "Command a slower reference first, or slots farther apart. The law `cooperative` lags least.",
    ),
    "SLOT_OUTSIDE_AIRSPACE": Explanation(
        "A formation is refused. The text names vehicle, position and obstacle.",
        "With the reference of the next two minutes a slot, or the path to it, comes too near to an obstacle or to the"
        " polygon of the fence.",
        "Choose other slots, or another reference first. `obstacles`, `envelope.fence_corners_enu_m` and"
        " `envelope.clearance_m` in the fleet file say what is kept clear.",
    ),
    "SLOT_OUTSIDE_FENCE": Explanation(
        "A formation is refused. The text names vehicle, axis and position.",
        "With the reference of the next two minutes a slot would leave the fence.",
        "Choose smaller slots or another reference, or enlarge the fence in the fleet file.",
    ),
    "SLOT_TAKEN": Explanation(
        "`form` is refused in flight.",
        "Another vehicle flies in or near the slot.",
        "Wait, or command a formation in which every vehicle has a slot of its own.",
    ),
    "SLOT_TOO_FAR": Explanation(
        "`form` is refused in flight.",
        "The vehicle cannot reach its slot within the longest joining time at the permitted speed.",
        "Bring it nearer, by its pilot or a ground station.",
    ),
    "SLOT_REACHED": Explanation(
        "The log reports that a vehicle has joined.",
        "It is in its slot.",
        "None is needed.",
    ),
    "PATH_TOO_CLOSE": Explanation(
        "`form` is refused. The text names a vehicle and a distance.",
        "The straight way into the slot comes nearer than `separation_m` to a vehicle that does not form, or that is in"
        " formation already.",
        "Let that vehicle form as well, or land it. Form from another side.",
    ),
    "PATHS_CROSS": Explanation(
        "`form` or a formation is accepted with a warning. The text names two vehicles and a distance.",
        "Their straight ways come nearer than `separation_m`. Both make way: the separation filter makes them pass each other.",
        "None is needed. Slots that `companion fleet formation` assigns do not cross; on the ground give it again before"
        " `takeoff`.",
    ),
    "PEER_STILL_JOINING": Explanation(
        "`form` is refused in flight.",
        "Another vehicle is joining or moving to its slot.",
        "Wait until it is in its slot, then give `form` again.",
    ),
    "NO_FORMATION_TO_JOIN": Explanation(
        "`form` is refused, or an entry into formation ends.",
        "The vehicle receives no leader and no vehicle in formation, so it does not know where its slot is.",
        "Give `form` to all vehicles. Where vehicles receive only their neighbours, repeat it until all have accepted.",
    ),
    "VEHICLE_IN_THE_WAY": Explanation(
        "A formation or a reference is refused in flight. The text names two vehicles and a distance.",
        "A vehicle that holds, climbs, lands or returns is in the way of a vehicle in formation.",
        "Land it or let it form, or choose a formation or reference that goes around it.",
    ),
    "GAP_KEPT": Explanation(
        "The gap of a vehicle that left is not closed.",
        "The text gives the reason, for example that the vehicle may still be in its slot.",
        "None is needed. The gap closes when its slot is free.",
    ),
}
