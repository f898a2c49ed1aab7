"""The one way in which a flight of the report can be of no use; by itself, so that the command line stays light to import."""


class NoFormationError(Exception):
    """A flight never came to the formation that is to be measured. str() is one line."""
