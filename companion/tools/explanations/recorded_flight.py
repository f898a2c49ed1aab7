"""Findings of `companion report` that no agent reports in flight: `companion/report/findings`."""

from __future__ import annotations

from companion.tools.explanations.explanation import Explanation

ENTRIES: dict[str, Explanation] = {
    "COMMANDS_SLOW": Explanation(
        "The setpoint leaves the agent late after the position that it was decided from.",
        "The computer is overloaded, or a stage of the decision takes too long.",
        "End other programs on it, and give the agent a higher priority (`deploy/companion@.service`). Compare the time to"
        " decide in the report.",
    ),
    "AGENT_RESTARTED": Explanation(
        "A vehicle has two starts of its agent in one flight.",
        "The process ended in the air: a defect, the watchdog, no memory, or a loss of power of the companion computer.",
        "Read `journalctl -u companion@N` from the end of the first start on, and check the power supply.",
    ),
    "RECORDING_GAP": Explanation(
        "Records are missing between two ticks.",
        "The card was too slow or full, so the recorder dropped records. The agent itself went on.",
        "Use a faster card, free space on it, and check it for errors. What happened in the gap is not judged.",
    ),
    "RECORDING_TRUNCATED": Explanation(
        "A file of a recording has no end.",
        "The computer lost power or the process was killed before the file was closed.",
        "Use what is there. Stop the agent before the power is cut.",
    ),
    "RECORDING_ENDS_IN_AIR": Explanation(
        "The last record of a vehicle was made in the air.",
        "The agent or its computer ended there, the card failed, or only a part of the recording is in the folder.",
        "Look for further files on the vehicle. Read `journalctl -u companion@N`, and check the power supply and the card.",
    ),
    "RECORDING_MISSING": Explanation(
        "A vehicle of the fleet file has no recording.",
        "Its files are not in the folder, it did not fly, or it does not record.",
        "Copy the recordings of all vehicles into one folder. Distances to a missing vehicle are not judged.",
    ),
    "RECORDING_UNREADABLE": Explanation(
        "A file in the folder cannot be read.",
        "It is damaged, or another program wrote it.",
        "Copy it again from the vehicle, and compare the sizes.",
    ),
    "CLOCK_NOT_ALIGNED": Explanation(
        "The times of one vehicle may not fit those of the others.",
        "No packets between this vehicle and the others are recorded, so only the dates of their computers are left.",
        "Check its link. Synchronize the clocks of the computers before a flight in which vehicles may lose each other.",
    ),
    "NOT_FLOWN": Explanation(
        "No vehicle left the ground.",
        "The recordings are of a test on the ground, or of another time than the flight.",
        "None is needed for a test on the ground. Else look for further files on the vehicles.",
    ),
    "AUTOPILOT_MESSAGE": Explanation(
        "The autopilot logged a warning or an error in the air.",
        "The text is the autopilot's.",
        "Look the text up in the documentation of PX4 or ArduPilot.",
    ),
    "AUTOPILOT_FAILSAFE": Explanation(
        "A failsafe of the autopilot acted in the air.",
        "Battery, radio control, data link, estimator, or missing setpoints; the text names it.",
        "Find the cause before the next flight: the agent does not control what the autopilot does then.",
    ),
    "VIBRATION_HIGH": Explanation(
        "The accelerometers of the autopilot vibrate.",
        "Propellers out of balance, a loose part, or a hard mount of the autopilot.",
        "Balance the propellers, and check screws and the mount. Vibration makes the estimated position wrong.",
    ),
    "GPS_POOR": Explanation(
        "The GPS receiver had few satellites or a large error in the air.",
        "Poor reception: buildings, trees, interference by the companion computer or its radio.",
        "Wait for a better fix, or move the antenna away from the computer. Fly with wider slots until then.",
    ),
    "LOG_NOT_ALIGNED": Explanation(
        "An autopilot's log is left out of the figures.",
        "No motion in the log matches that of a recorded vehicle: it is of another flight or vehicle, or too short.",
        "Choose the log of this flight: `companion logs --config FILE` lists the dates.",
    ),
    "LOG_UNREADABLE": Explanation(
        "An autopilot's log cannot be read.",
        "It is damaged, incomplete, or no ULog or DataFlash log.",
        "Download it again by `companion logs --config FILE --get ID`.",
    ),
}
