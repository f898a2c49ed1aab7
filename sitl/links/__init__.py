"""What carries messages: sockets, MAVLink link ends, schedules, the simulated network."""
