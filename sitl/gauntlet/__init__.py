"""Random flights of whole fleets in virtual time, and how close their vehicles truly come to each other."""
