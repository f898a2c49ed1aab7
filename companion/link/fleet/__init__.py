"""The network of the fleet: Zenoh, its access control and identities, and peer states as datagrams."""
