"""What a board gets: units, udev rule, journal limits, the Debian package and its proof by a boot."""
