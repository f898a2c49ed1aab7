"""Stand-in autopilots: the common part; one package per make beside it."""
