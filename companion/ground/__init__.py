"""Ground station: monitors and commands the fleet over Zenoh. It computes no setpoint."""
