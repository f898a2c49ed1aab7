"""Formation: slots, changes, joining and gap filling."""
