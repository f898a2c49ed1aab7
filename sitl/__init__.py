"""Stand-in vehicles that speak MAVLink, and the tools that fly whole fleets of them."""
