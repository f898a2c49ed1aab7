"""Types and checks of the files: fleet, vehicle, slots, reference, and the part of a scenario that is analysed."""
