"""Health, failsafes, output limits, the separation filter, and the checks before flight."""
