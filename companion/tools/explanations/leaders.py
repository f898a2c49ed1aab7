"""Leaders, reference trajectories and targets: `companion/core/election`, `companion/core/reference`."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "ROLE_CHANGED": Explanation(
        "A vehicle reports another role, with an epoch.",
        "A command, a claim, or a later leadership that it received.",
        "None is needed.",
    ),
    "NO_LEADER_NAMED": Explanation(
        "A leader command is refused.",
        "It names no vehicle.",
        "Name one or more leaders.",
    ),
    "NOT_A_LEADER": Explanation(
        "A leader command is refused.",
        "It names a vehicle that may not lead by the fleet file.",
        "Name one of the vehicles in the text, or set `may_lead: true` for the vehicle, give it a `reference`, and"
        " restart all agents with the new fleet file.",
    ),
    "EPOCH_TOO_OLD": Explanation(
        "A leader command is refused.",
        "Its epoch is the vehicle's, or up to 8 older: another change came first.",
        "Give the command again; `companion fleet` takes the next epoch.",
    ),
    "EPOCH_TOO_LARGE": Explanation(
        "A leader command is refused.",
        "Its epoch is more than 1000 ahead.",
        "Give the command again; `companion fleet` takes an epoch that all vehicles accept.",
    ),
    "REFERENCE_ACCEPTED": Explanation(
        "A reference command is accepted.",
        "The vehicle has the new reference and flies it from the time in the text.",
        "None is needed.",
    ),
    "REFERENCE_KNOWN": Explanation(
        "A reference command is accepted again.",
        "The vehicle already has this reference.",
        "None is needed.",
    ),
    "REFERENCE_CHANGED": Explanation(
        "The log names the reference that begins.",
        "Its start time has come and every vehicle that may lead has it.",
        "None is needed.",
    ),
    "REFERENCE_CANCELLED": Explanation(
        "A reference that was accepted does not begin.",
        "A flying vehicle that may lead does not have it; the text names it.",
        "Check that vehicle's link, then command the reference again.",
    ),
    "REFERENCE_DIFFERS": Explanation(
        "`lead` or `form` is refused.",
        "The vehicle has another reference than the leader.",
        "Give it the reference command of the leader, then try again.",
    ),
    "REFERENCE_INVALID": Explanation(
        "A reference is refused. The text says which limit it breaks.",
        "It leaves the fence with a vehicle of the formation, needs more tilt or speed than permitted, or its keys"
        " are not valid.",
        "Use the value in the text, a longer period or lower limits.",
    ),
    "REFERENCE_NOT_ALLOWED": Explanation(
        "A reference is refused.",
        "The vehicle may not lead and holds no reference.",
        "Give the command to vehicles with `may_lead: true`; `companion fleet` does that.",
    ),
    "REFERENCE_OFF_FLEET": Explanation(
        "`lead` is refused.",
        "The vehicle's reference is more than 30 m from where the fleet flies: the mission time or the reference"
        " differs. From less the new leader leads the fleet in.",
        "Let another vehicle lead, or give the reference command again.",
    ),
    "TARGET_RECEIVED": Explanation(
        "The log reports a target.",
        "Samples of the target arrive.",
        "None is needed.",
    ),
    "TARGET_LOST": Explanation(
        "The reference comes to rest.",
        "No sample of the target arrived for `max_age_s`.",
        "Check the program that publishes the target, its Zenoh endpoint and its target name.",
    ),
}
