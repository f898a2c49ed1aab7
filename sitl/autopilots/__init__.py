"""Stand-in autopilots: the common part, and one folder for each autopilot type."""
