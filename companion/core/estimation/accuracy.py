"""How wrong the autopilot's position may be: as its estimator reports, and growing where it has lost what it aided itself with.

An autopilot goes on reporting positions for seconds to minutes after it has lost GPS or external vision, and they drift. That
its accuracy is unknown then makes it no better.
"""

from __future__ import annotations

from math import inf

from companion.types.autopilot import EstimatorSample, PositionAid, PositionError

MAX_ERROR_M = 10_000.0  # above it an accuracy is unknown: GPS receivers without a fix report 4295 km
ERROR_AGE_S = 5.0  # an error estimate older than this is not known any more
# One sigma of dead reckoning, after PX4 and ArduCopter that had lost external vision: 0.2 m after 1 s, 1.3 to 6.6 m after 10 s.
DRIFT_M_S, DRIFT_M_S2 = 0.1, 0.06
CLIMB_DRIFT_M_S = 0.1
LARGEST_ASSUMED_M = 1_000.0
NO_ERROR = PositionError(0.0, 0.0)
POSE_GAP_S = 0.2  # autopilots do not notice a gap in external vision that is no longer


class PositionAccuracy:
    """The position error to be assumed. `uses_gps`: positions come from GPS, so that its fix counts."""

    def __init__(self, uses_gps: bool) -> None:
        self._uses_gps = uses_gps
        self.restart()

    def restart(self) -> None:
        """Nothing was reported yet."""
        self._pose_s = inf  # when the newest pose was measured, where the autopilot has no position without one
        self._known: PositionError | None = None  # as last reported while all was well
        self._reported = NO_ERROR
        self._known_s = self._received_s = -inf
        self._had_fix = self._was_aided = self._lost = False
        self.holds_until_s = inf  # until then the error stays as it is without a new report

    def receive(self, sample: EstimatorSample) -> None:
        """A report of the estimator, or of the GPS receiver."""
        horizontal_m, vertical_m = sample.horizontal_error_m, sample.vertical_error_m
        known = 0.0 <= horizontal_m <= MAX_ERROR_M and 0.0 <= vertical_m <= MAX_ERROR_M
        self._had_fix = self._had_fix or (self._uses_gps and sample.aid is PositionAid.FIX)
        self._was_aided = self._was_aided or sample.aid is PositionAid.USED
        no_fix = self._had_fix and sample.aid is PositionAid.NO_FIX
        unaided = self._was_aided and sample.aid is PositionAid.NOT_USED
        self._lost = no_fix or unaided or (self._known is not None and not known)
        self._reported = PositionError(horizontal_m, vertical_m) if known else NO_ERROR
        if not self._lost:
            self._known, self._known_s = self._reported if known else None, sample.received_s
        self._received_s = sample.received_s
        self._hold()

    def receive_pose(self, measured_s: float) -> None:
        """A motion-capture pose that goes to the autopilot, which has no other position."""
        self._pose_s = measured_s
        self._hold()

    def _hold(self) -> None:
        self.holds_until_s = -inf if self._lost else min(self._received_s + ERROR_AGE_S, self._pose_s + POSE_GAP_S)

    def at(self, now_s: float) -> tuple[PositionError | None, bool]:
        """(error, one sigma; whether the position is not aided any more). None where the error was never known."""
        stale = self._known is not None and now_s - self._received_s > ERROR_AGE_S
        unaided = self._lost or stale
        if not unaided and now_s - self._pose_s <= POSE_GAP_S:
            return self._known, False
        since_s = self._known_s if unaided else self._pose_s
        base, reported, drifts_s = self._known or NO_ERROR, self._reported, max(0.0, now_s - since_s)
        horizontal_m = base.horizontal_m + DRIFT_M_S * drifts_s + 0.5 * DRIFT_M_S2 * drifts_s * drifts_s
        vertical_m = base.vertical_m + CLIMB_DRIFT_M_S * drifts_s
        assumed = PositionError(
            max(reported.horizontal_m, min(horizontal_m, LARGEST_ASSUMED_M)),
            max(reported.vertical_m, min(vertical_m, LARGEST_ASSUMED_M)),
        )
        return assumed, unaided
