"""The formation companion: the agent that runs on each vehicle, and its ground tools."""

__version__ = "0.1.0"
