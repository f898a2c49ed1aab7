"""Ground side: watches the fleet over Zenoh. It never computes a control command."""
