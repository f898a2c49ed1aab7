"""Replies, reports and progress that `companion fleet` prints: `companion/ground`."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "NO_REPLY": Explanation(
        "A vehicle is missing in the replies.",
        "Its agent did not answer in time: it does not run, or the endpoint does not lead to it.",
        "Check `systemctl status companion@N`, and name another endpoint with `--connect`.",
    ),
    "NO_REPORT": Explanation(
        "A vehicle is missing in the status.",
        "No status report arrived: the vehicle has no power or no radio, or its agent does not run. An agent that runs flies"
        " on without the ground.",
        "In flight: watch it, with its pilot ready to take over. Then `ping` its address, and look at"
        " `systemctl status companion@N` on its board. Name another endpoint with `--connect` where its address changed.",
    ),
    "NOT_SENT": Explanation(
        "A command was sent to no vehicle.",
        "It is for all vehicles or none, and some cannot begin; the text names them.",
        "Correct what their lines say, then give the command again, or name the vehicles with `--only`.",
    ),
    "FLEET_DIVIDED": Explanation(
        "Some vehicles began an action and others did not.",
        "A vehicle refused or lost the command after the checks on the ground had passed.",
        "Follow the next steps in the text.",
    ),
    "FLEET_FILE_DIFFERS": Explanation(
        "A vehicle is not ready.",
        "Its fleet file differs from the one of the ground computer.",
        "Copy the same fleet file to all of them and restart the agents.",
    ),
    "ACTION_FINISHED": Explanation(
        "A vehicle has finished the action.",
        "It is in the phase that the action leads to.",
        "None is needed.",
    ),
    "ACTION_FAILED": Explanation(
        "A vehicle left the way to the end of the action.",
        "The text has its phase and last event.",
        "Explain the code of that event; look at the agent's log.",
    ),
    "ACTION_TIMED_OUT": Explanation(
        "The wait ended before a vehicle had finished.",
        "The vehicle is slow, or no reports arrive. The action continues.",
        "Look at `companion fleet status`; wait longer with `--timeout`.",
    ),
}
