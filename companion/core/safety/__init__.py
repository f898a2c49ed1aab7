"""Health, failsafes, output limits, and the checks before flight and against other vehicles."""
