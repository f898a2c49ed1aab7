"""The formation companion: the agent that runs on each vehicle, and its ground tools."""

__version__ = "0.1.0"
GROUND_INSTALL = "pip install '.[ground]' in the project's folder"  # it is in no package index
