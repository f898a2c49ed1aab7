"""The live page of a fleet: its server, its interface for programs, and the page itself."""
