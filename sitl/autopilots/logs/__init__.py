"""Flight logs of the stand-ins and their transfer over MAVLink."""
