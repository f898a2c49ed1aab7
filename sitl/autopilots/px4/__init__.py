"""The stand-in that behaves like PX4 v1.16."""
