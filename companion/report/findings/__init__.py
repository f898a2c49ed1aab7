"""What deserves attention in a flight: one module for each kind of finding."""
