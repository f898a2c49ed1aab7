"""The report on a flight: recordings of its vehicles to one page with figures and findings."""
