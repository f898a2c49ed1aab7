"""CPU and bytes of one agent's Zenoh link against the number of other vehicles, all at 50 Hz or most of them at 5 Hz."""
