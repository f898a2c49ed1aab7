"""Acceleration -> attitude and thrust setpoints."""
