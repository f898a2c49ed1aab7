"""Telemetry -> vehicle state in the fleet frame, hover thrust and wind."""
