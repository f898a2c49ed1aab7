"""The refusal of `companion monitor`."""


class MonitorError(Exception):
    """The monitor cannot run as requested. str() is one line with what to do."""
