"""Formation: guidance, slots, entry, changes and gaps."""
