"""Approach law of the target follower and of the formation heading: pull, braking and jerk limits towards a goal."""

from __future__ import annotations

from math import sqrt

SETTLE_S = 0.4  # time constant of the velocity
PULL_1_S = 1.0 / (4.0 * SETTLE_S)  # approach speed per distance: critically damped
JERK_1_S = 4.0  # change of acceleration per second, relative to the largest acceleration
APPROACH = 0.5  # share of the largest acceleration that is used for braking at the goal
LONGEST_S = 0.5  # of a pause; after a longer one the motion continues from where it was


def approach_speed(distance: float, braking: float) -> float:
    """Speed at which a goal at this distance (m or rad) is approached, to stop there with this deceleration.

    Near the goal the pull limits the speed; there it needs less than `braking`. 0 at or beyond the goal.
    """
    straight = braking / PULL_1_S**2
    if distance < straight:
        return PULL_1_S * max(distance, 0.0)
    return sqrt(braking * (2.0 * distance - straight))
