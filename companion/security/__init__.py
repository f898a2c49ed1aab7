"""Identities of a fleet: authority, certificates, the admission list. No sockets, no Zenoh."""
