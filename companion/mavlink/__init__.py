"""MAVLink without input or output: bytes <-> messages <-> the types of companion.types."""
