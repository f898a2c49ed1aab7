"""The agent's and stand-ins' processes: `companion/link/tick.py`."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "LOOP_LATE": Explanation(
        "The log reports a control cycle that started late.",
        "Another process had the processor, or the cycle before took too long.",
        "Free the computer: stop other programs, or give the agent a higher priority"
        " (`deploy/companion@.service`). In a simulation use fewer vehicles or `sitl run`.",
    ),
}
