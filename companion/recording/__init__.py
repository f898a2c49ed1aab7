"""What an agent records of a flight, and how it is read again."""
