"""Scenarios and how they are flown, in real and in virtual time."""
