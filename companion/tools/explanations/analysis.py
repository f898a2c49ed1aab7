"""Findings of `companion analyze`: `companion/tools/analysis_report.py`."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "NO_PATH_TO_LEADER": Explanation(
        "The formation cannot converge.",
        "A vehicle has no path of neighbours to a leader.",
        "Add edges, or enlarge the range.",
    ),
    "FORMATION_UNSTABLE": Explanation(
        "The formation cannot converge.",
        "With attitude lag and delay the law is unstable on this graph.",
        "Lower the gains, raise `weight_ratio`, lower `exponent` or `feedforward`, or use `cooperative`.",
    ),
    "BADLY_DAMPED": Explanation(
        "The formation swings before it settles.",
        "The damping of a mode is below 0.3.",
        "Raise `velocity_1_s` against `position_1_s2`, or use `cooperative`.",
    ),
    "SMALL_DELAY_MARGIN": Explanation(
        "Little delay makes the formation unstable.",
        "The delay margin is below 0.15 s.",
        "Lower the gains, or shorten the delays of the network.",
    ),
    "FORMATION_CONVERGES": Explanation(
        "The formation converges, without findings.",
        "Every vehicle has a path to a leader, and all margins are sufficient.",
        "Nothing to do.",
    ),
    "SINGLE_VEHICLE": Explanation(
        "There is one vehicle and no formation.",
        "The fleet has one vehicle; it follows its reference.",
        "Nothing to do.",
    ),
    "SETTLES_SLOWLY": Explanation(
        "Errors are not below 10 cm after two minutes of prediction.",
        "The convergence rate is low for this graph and start.",
        "Add edges, use a leader nearer to the middle, or use `cooperative`.",
    ),
    "FLEET_TOO_DEEP": Explanation(
        "The last vehicles move noticeably later than the leader.",
        "Every hop passes a motion on one tick and one link later; together at least half the leader's settling time.",
        "Add edges or range, put the leader in the middle, or name a second leader.",
    ),
    "NEIGHBOURS_OUT_OF_RANGE": Explanation(
        "Neighbours are predicted to leave each other's range.",
        "The start errors are large for the range, or the reference moves fast.",
        "Start closer to the slots, slow the reference down, or give the edges explicitly.",
    ),
    "NEIGHBOURS_TOO_CLOSE": Explanation(
        "Two neighbours are predicted to come within 0.8 m.",
        "The spacing is small for the overshoot.",
        "Use more spacing or better damping.",
    ),
    "BETTER_LEADER": Explanation(
        "Another vehicle would be the better leader.",
        "With it lambda_min is at least 10 % larger.",
        "Make it the leader, if it may be.",
    ),
    "ERRORS_GROW": Explanation(
        "Swings grow along the chain.",
        "The string gain to the last vehicle is above 1.2.",
        "Add edges, name a second leader, or shorten the chain; keep spare distance at the rear. Use `cooperative` in place"
        " of another law.",
    ),
}
