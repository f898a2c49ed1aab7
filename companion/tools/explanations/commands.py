"""Commands, operators and command arbitration: `companion/core/command/arbitration.py`,
`companion/link/fleet/zenoh_link.py`.
"""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "COMMAND_MALFORMED": Explanation(
        "A command is refused before it is checked further.",
        "Its bytes are no command of this wire version, or its operator name or number is not valid.",
        "Use `companion fleet` of the same release as the agents.",
    ),
    "COMMAND_KEY_MISMATCH": Explanation(
        "A command is refused before it is checked further.",
        "It was published under the Zenoh key of another operator than it names.",
        "Use `companion fleet` of the same release as the agents. Else find the program that publishes there.",
    ),
    "NOT_ADMITTED": Explanation(
        "Commands, targets or traffic of a participant are not used.",
        "A newer admission list has revoked it; its connection lasts until the agent restarts.",
        "If that was a mistake: `companion provision new` makes a new identity. Restart the agents on the ground then.",
    ),
    "COMMAND_LATE": Explanation(
        "A command is refused although it is valid.",
        "The agent's process was paused for more than 0.1 s, and the age of the waiting command is unknown.",
        "Give the command again. Find out what paused the process: load, a debugger, a suspended computer. `hold`,"
        " `land` and `abort` are never refused for this reason.",
    ),
    "COMMAND_OLD": Explanation(
        "A command is refused because of its number.",
        "The vehicle already had a command with this number or a higher one: the command is a repetition or a"
        " recording, or another operator gave one at the same time.",
        "Give the command again; `companion fleet` takes the next number from the vehicle's status.",
    ),
    "COMMAND_NUMBER_TOO_LARGE": Explanation(
        "A command is refused because its number is too large.",
        "The number is more than 10^13 above the last one, which no clock explains.",
        "Correct the clock of the ground computer, or the program that made the number.",
    ),
    "WRONG_SESSION": Explanation(
        "A command is refused because it is for an earlier start of the agent.",
        "The agent restarted after the ground had read its status.",
        "Give the command again. A restarted agent observes: check its phase first.",
    ),
    "OTHER_HOLDS_COMMAND": Explanation(
        "A command is refused with the name of another operator.",
        "That operator gave the vehicle its first command and holds command of it.",
        "Agree with that operator, then use `companion fleet take`. `abort` needs no command.",
    ),
    "COMMAND_TAKEN": Explanation(
        "The log or reply names the operator who holds command now.",
        "An operator gave the first command, or used `companion fleet take`.",
        "None is needed.",
    ),
    "ABORT_BY_OTHER": Explanation(
        "The log reports an abort by an operator who does not hold command.",
        "`abort` is open to every operator.",
        "Ask that operator for the reason. The holder of the command has not changed.",
    ),
    "ABORTED": Explanation(
        "A command is refused because of an abort.",
        "It arrived together with `abort`, which goes first.",
        "See what the vehicle does now, then give the command again if it is still wanted.",
    ),
}
