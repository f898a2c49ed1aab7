"""Commands: arbitration, dispatch, flight phases and autopilot procedures."""
